"""What becomes of a robot on a bus when the process that serves it is killed, or hangs."""

import json
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hexctl.backends.bus.bus_map import BusMap, bus_map_of
from hexctl.backends.bus.tools import scan_bus
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.i2c_socket import I2cSocket
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.client.stop_client import clear_stop, estop
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.errors import RobotFaultError
from hexctl.robot.loader import load_robot_file
from hexctl.server.keeper import KeeperSpec, main, take_over, wait_for_the_end
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JOINT_NAMES, FloatArray
from tests.backends.bus.boards import MemoryBus, a_map, bus_board, memory_bus
from tests.backends.mavlink.boards import board
from tests.backends.pwm.boards import i2c_servos_on, memory_board, pca9685_board, servos_on
from tests.backends.pwm.i2c import byte_of
from tests.backends.standing import until
from tests.robots import edited_file, put, with_ids
from tests.server.processes import Served, program, served, wait_until

#: What a keeper says when all joints followed.
SAT = "sat down, and its torque is off"

WALK = ("hexctl", "run", "--backend", "zenoh", "--duration", "60", "--no-record")

#: Horns mounted so that sitting fits into the travel of the servos.
FITTING = {"model": "sts3215", "femur": {"offset_deg": -10}, "tibia": {"offset_deg": 40}}


@pytest.mark.parametrize(
    ("written", "how"),
    [
        (b"...", ("gone", False)),
        (b"..s", ("gone", True)),
        (b"s.", ("gone", False)),
        (b"", None),
        (b"..q", None),
        (b"sq", None),
    ],
)
def test_a_pipe_that_closes_without_goodbye_means_a_server_has_gone(
    written: bytes, how: tuple[str, bool] | None
) -> None:
    end, begin = os.pipe()
    os.write(begin, written)
    os.close(begin)
    assert wait_for_the_end(end) == how
    os.close(end)


@pytest.mark.parametrize(("ticks", "stopped"), [(b".", False), (b".s", True)])
def test_ticks_that_end_are_a_server_that_hangs(ticks: bytes, stopped: bool) -> None:
    end, begin = os.pipe()
    os.write(begin, ticks)
    assert wait_for_the_end(end, silent_s=0.05) == ("hangs", stopped)
    os.close(begin)
    os.close(end)


def test_a_robot_file_that_is_edited_meanwhile_does_not_keep_it_from_the_servos(tmp_path: Path) -> None:
    file = edited_file(tmp_path, put("servos", with_ids(FITTING)), base="phantomx")
    spec = KeeperSpec(backend="feetech", robot=str(file), port="/dev/null", sits=True)
    before = spec.servos().robot
    file.write_text("servos: {", encoding="utf-8")
    assert spec.servos().robot == before
    assert replace(spec, sits=False).servos().robot == before, "of a robot that was stopped"


@pytest.mark.parametrize(
    ("end", "our_parent", "fault", "code", "said"),
    [
        (None, True, "", 0, ""),
        (("gone", False), True, "", 0, "serve gone: the robot sits: True\n"),
        (("gone", True), True, "", 0, "serve gone: the robot sits: False\n"),
        (("hangs", False), True, "", 0, "serve hangs: the robot sits: True\n"),
        (("hangs", False), False, "", 0, "serve hangs: the robot sits: True\n"),
        (("gone", False), True, "no port", 3, "serve gone, and the keeper failed: no port\n"),
    ],
)
def test_it_says_what_became_of_the_robot_and_kills_only_a_server_that_hangs(
    end: tuple[str, bool] | None,
    our_parent: bool,
    fault: str,
    code: int,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def take_over(spec: KeeperSpec) -> str:
        if fault:
            raise RobotFaultError(fault)
        return f"sits: {spec.sits}"

    killed: list[int] = []
    for name, stand_in in (
        ("take_over", take_over),
        ("wait_for_the_end", lambda _: end),
        ("signal.signal", lambda *_: None),
        ("os.kill", lambda server, _: killed.append(server)),
    ):
        monkeypatch.setattr(f"hexctl.server.keeper.{name}", stand_in)
    server = os.getppid() if our_parent else 1_000_000
    words = {"server": server, "backend": "feetech", "robot": "phantomx", "port": "/dev/null", "sits": True}
    assert main(json.dumps(words)) == code
    assert capsys.readouterr().err == (f"hexctl: {said}" if said else "")
    assert killed == [server] * (our_parent and end is not None and end[0] == "hangs")


def _goals(folder: Path, device: str) -> FloatArray:
    """Joint angles at which the servos are, (18,), once none of them turns."""
    file = load_robot_file(folder / "robot.yaml")
    found = scan_bus(device, "feetech", 1_000_000, ids=range(1, 19))
    counts = np.array([each.position for each in found], dtype=float)
    return bus_map_of(file.content.servos, "feetech").angles_rad(counts)


@contextmanager
def walking(folder: Path) -> Iterator[tuple[Served, str]]:
    """A robot on a simulated bus that walks, and the port of the bus."""
    file = edited_file(folder, put("servos", with_ids(FITTING)), base="phantomx").rename(
        folder / "robot.yaml"
    )
    robot = ("--robot", str(file))
    with (
        board("--bus", "feetech", "--backend", "mock", *robot) as bus,
        served(folder, *robot, "--port", bus.port, backend="feetech") as server,
        ExitStack() as stack,
    ):
        arguments = (*WALK, "--connect", server.endpoint, *robot)
        walk = stack.enter_context(program(folder, "walk", *arguments))

        def walks() -> bool:
            nonlocal walk
            if walk.process.poll() is not None:  # a busy machine has kept its commands waiting
                walk = stack.enter_context(program(folder, "walk", *arguments))
            return bool(server.status()["commands"]["accepted"] > 20)

        wait_until(walks, "commands")
        yield server, bus.port


@pytest.mark.realtime
def test_a_robot_whose_server_ends_in_mid_motion_sits_down(tmp_path: Path) -> None:
    with walking(tmp_path) as (server, port):
        server.signal(signal.SIGKILL)
        wait_until(lambda: f"serve gone: the robot {SAT}" in server.said(), "the keeper")
        end = sitting_angles_rad(load_robot_file(tmp_path / "robot.yaml").robot)
        assert _goals(tmp_path, port) == pytest.approx(end, abs=0.01)


@pytest.mark.realtime
@pytest.mark.parametrize("cleared", [False, True])
def test_a_stopped_robot_whose_server_ends_holds(tmp_path: Path, cleared: bool) -> None:
    """Somebody may be touching it, also after the stop is cleared and before the next command."""
    with walking(tmp_path) as (server, port):
        estop(connect=server.endpoint)
        if cleared:
            clear_stop(connect=server.endpoint)
        server.signal(signal.SIGKILL)
        wait_until(lambda: "serve gone: the robot holds" in server.said(), "the keeper")
        sitting = sitting_angles_rad(load_robot_file(tmp_path / "robot.yaml").robot)
        assert np.abs(_goals(tmp_path, port) - sitting).max() > 0.1


@pytest.mark.realtime
def test_hobby_servos_on_an_i2c_bus_are_let_down_when_the_server_hangs(tmp_path: Path) -> None:
    file = edited_file(tmp_path, put("servos", {"tibia": {"offset_deg": 40}}), base="ant")
    robot = ("--robot", str(file))
    with board("--bus", "pca9685", "--backend", "mock", *robot) as boards:
        with (
            served(tmp_path, *robot, "--port", boards.port, backend="pca9685") as server,
            program(tmp_path, "walk", *WALK, "--connect", server.endpoint, *robot),
        ):
            assert "warning: pca9685 has no watchdog" in server.said()
            # Legs get their pulses one after the other, which takes a second.
            wait_until(lambda: server.status()["commands"]["accepted"] > 100, "commands")
            server.signal(signal.SIGSTOP)
            wait_until(lambda: f"serve hangs: the robot {SAT}" in server.said(), "the keeper")
        bus = I2cSocket(boards.port)
        off = [byte_of(bus, 0x40 + n // 16, 0x09 + 4 * (n % 16)) for n in range(18)]
        bus.close()
        assert boards.end()["refused"] == 0
    assert off == [0x10] * 18


@pytest.mark.realtime
def test_a_server_that_ends_as_it_should_ends_its_keeper(tmp_path: Path) -> None:
    with board("--bus", "feetech", "--backend", "mock", "--robot", "phantomx") as bus:
        options = ("--robot", "phantomx", "--port", bus.port)
        with served(tmp_path, *options, backend="feetech") as server:
            server.signal(signal.SIGINT)
            assert server.wait() == 0
            assert "the robot" not in server.said()
        assert len(scan_bus(bus.port, "feetech", 1_000_000, ids=range(4))) == 3, "the port is free again"


def test_servos_without_torque_are_left_alone() -> None:
    with pca9685_board() as boards:
        assert take_over(keeper("pca9685", "ant", boards.path)) == "had no torque"
        assert not boards.pulses_us().any()
    with bus_board(a_map()) as bus:
        assert take_over(keeper("feetech", "phantomx", bus.path)) == "had no torque"
        assert not any(servo.holds for servo in bus._servos)


def keeper(backend: str, robot: object, port: str, *, sits: bool = True) -> KeeperSpec:
    return KeeperSpec(backend=backend, robot=str(robot), port=port, sits=sits)


@contextmanager
def found_by_it(
    bus_map: BusMap, *faults: str, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[MemoryBus, list[BusServo]]]:
    """A bus in memory, on whose time a keeper in this process is, and its servos, which have torque."""
    with memory_bus(bus_map, *faults) as bus:
        time = SimpleNamespace(monotonic=bus.time.now, sleep=bus.time.sleep)
        monkeypatch.setattr("hexctl.server.keeper.time", time)
        servos = [servo for servo in bus.board._servos if isinstance(servo, BusServo)]
        for servo in servos:
            servo.write(servo._table.torque.address, b"\1")
        yield bus, servos


@pytest.mark.parametrize(
    ("driver", "model", "fault"),
    [
        ("dynamixel", "xl430-w250", None),
        ("feetech", "sts3215", "hot:2:femur:69"),
    ],
)
def test_it_lets_down_what_it_finds(
    driver: str, model: str, fault: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An expired watchdog, a hot servo, and one servo that has lost its torque do not keep it from that."""
    content = {**FITTING, "model": model}
    file = edited_file(tmp_path, put("servos", with_ids(content)), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, driver)
    faults = [fault] if fault else []
    with found_by_it(bus_map, *faults, monkeypatch=monkeypatch) as (bus, servos):
        servos[7].write(servos[7]._table.torque.address, b"\0")
        for servo in servos if driver == "dynamixel" else ():
            servo.memory[98] = 255
        done = take_over(keeper(driver, file, bus.path))
        assert done == SAT
        assert not any(servo.holds for servo in servos)
        end = sitting_angles_rad(load_robot_file(file).robot)
        np.testing.assert_allclose(bus.robot._positions_rad[8:], end[8:], atol=0.02)
        sent = np.array([one.joint_positions_rad for one in bus.robot.sent])[:, 8:]
        fastest_rad_s = np.abs(np.diff(sent, axis=0)).max() / bus.robot.clock.period_s
        assert fastest_rad_s < 3 * np.ptp(sent, axis=0).max() / SITTING_S, "softly"


@pytest.mark.parametrize(
    ("tripped", "done"),
    [
        (tuple(range(6)), "sat down without {}, which did not follow, and its torque is off"),
        (tuple(range(7)), "did not sit down: {} do not follow; it holds"),
    ],
)
def test_joints_that_do_not_follow_keep_it_from_sitting_only_where_they_are_many(
    tripped: tuple[int, ...], done: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Servos that have tripped stay limp until they restart; the others sit, and are limp afterwards."""
    file = edited_file(tmp_path, put("servos", with_ids({**FITTING, "model": "xl430-w250"})), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, "dynamixel")
    with found_by_it(bus_map, monkeypatch=monkeypatch) as (bus, servos):
        for joint in tripped:
            servos[joint].trip()
        # Farther from where they sit.
        bus.robot._positions_rad += np.isin(np.arange(18), tripped) * np.tile([0.6, -0.6, 0.6], 6)
        said = take_over(keeper("dynamixel", file, bus.path))
        names = ", ".join(JOINT_NAMES[joint].replace("_", " ") for joint in tripped)
        assert said == done.format(names)
        assert sum(servo.holds for servo in servos) == (0 if len(tripped) == 6 else 18 - len(tripped))


@pytest.mark.parametrize("sits", [True, False])
def test_hobby_servos_of_a_board_that_was_reset_are_not_powered_again(sits: bool) -> None:
    with pca9685_board() as boards:
        with i2c_servos_on(boards) as servos:
            until(servos, lambda _: servos.powered.all())
        boards.chips[0x41].reset()
        before = boards.pulses_us()
        assert 0 < np.count_nonzero(before) < 18
        done = take_over(keeper("pca9685", "ant", boards.path, sits=sits))
        if sits:
            assert done == "had lost the pulses of some servos, and its torque is off"
            assert not boards.pulses_us().any()
        else:
            assert done == "holds, where its servos still have pulses"
            assert boards.pulses_us() == pytest.approx(before)


def test_a_robot_that_holds_is_not_told_anew_where_to_be() -> None:
    """Its joints hang a little below their goals; told to be where they are, they would sag further."""
    bus_map = a_map()
    robot = MockServos("phantomx")
    with bus_board(bus_map, servos=robot) as bus:
        for servo in bus._servos:
            assert isinstance(servo, BusServo)
            servo.write(servo._table.torque.address, b"\1")
        goals = bus._family.goals(0.0)
        robot._positions_rad -= 0.05
        assert take_over(keeper("feetech", "phantomx", bus.path, sits=False)) == "holds"
        assert bus._family.goals(0.0) == pytest.approx(goals)
        assert all(servo.holds for servo in bus._servos)


@pytest.mark.parametrize(
    ("driver", "faults", "silent_s", "done"),
    [
        ("ssc32", (), 2.0, SAT),
        ("maestro", ("no-timeout",), 2.0, SAT),
        ("maestro", (), 0.2, SAT),
        ("maestro", (), 0.5, "had no torque"),
    ],
)
def test_it_lets_down_hobby_servos_whose_board_keeps_their_pulses(
    driver: str,
    faults: tuple[str, ...],
    silent_s: float,
    done: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A Maestro in its serial timeout has let them go already."""
    file = edited_file(tmp_path, put("servos", {"tibia": {"offset_deg": 40}}))
    pwm_map = pwm_map_of(load_robot_file(file).content.servos, driver)
    with memory_board(pwm_map, *faults) as running:
        time = SimpleNamespace(monotonic=running.time.now, sleep=running.time.sleep)
        monkeypatch.setattr("hexctl.server.keeper.time", time)
        with servos_on(running) as servos:
            until(servos, lambda _: servos.powered.all())
        running.time.sleep(silent_s)
        assert done in take_over(keeper(driver, str(file), running.path))
        assert not running.board.pulses_us().any()
