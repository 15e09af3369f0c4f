"""Servos on a bus as a controller sees them: they conform, and what goes wrong is named."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servo_bus import Report
from hexctl.backends.bus.servos import BusServos, parse_bus_port
from hexctl.control.guard import Guard
from hexctl.errors import InputError, RobotFaultError
from hexctl.simulators.register_servos import BusServo
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import JointTargets, RobotState
from hexctl.waiting import wait_for
from tests.backends.bus.boards import a_map, bus_board, servos_on
from tests.robots import shipped

pytestmark = pytest.mark.realtime


class TestFeetech(LegServosConformance):
    #: A count is 0.0015 rad.
    @pytest.fixture(autouse=True)
    def board(self) -> Iterator[None]:
        with bus_board(a_map()) as self.running:
            yield

    def make(self) -> LegServos:
        return servos_on(self.running, a_map())


def _until(
    servos: LegServos, condition: Callable[[RobotState], Any], seconds: float = 5.0, *, write: bool = True
) -> RobotState:
    """State of the first tick in which a condition holds, while the stance is commanded, or nothing is."""
    for _ in range(round(seconds / 0.02)):
        servos.clock.tick()
        state = servos.read()
        if condition(state):
            return state
        if write:
            servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
    raise AssertionError(state)


def test_nothing_is_switched_before_the_first_targets_and_the_robot_then_stays_where_it_is() -> None:
    bus_map = a_map()
    with bus_board(bus_map) as board:
        board._robot._positions_rad += 0.05  # type: ignore[attr-defined]  # moved by hand
        with servos_on(board, bus_map) as servos:
            here = servos.read().joint_positions_rad
            assert here == pytest.approx(servos.robot.stance_angles_rad + 0.05, abs=2e-3)
            time.sleep(0.2)
            assert not board._servos[0].holds
            servos.write(JointTargets(here, servos.clock.now_s))
            _until(servos, lambda _: board._servos[0].holds)
            assert servos.disable_torque()
            time.sleep(0.2)
            assert not any(servo.holds for servo in board._servos)
            servos.write(JointTargets(here, servos.clock.now_s))
            time.sleep(0.2)
        assert all(servo.holds for servo in board._servos), "after closing the robot holds its pose"
        with servos_on(board, bus_map) as servos:
            time.sleep(0.2)
            assert all(servo.holds for servo in board._servos), "and is not dropped by the next program"


def _walks(servos: LegServos, seconds: float, angle_rad: float = 0.0) -> None:
    for _ in range(round(seconds / 0.02)):
        servos.clock.tick()
        servos.write(JointTargets(servos.robot.stance_angles_rad + angle_rad, servos.clock.now_s))


def test_a_watchdog_that_has_expired_is_renewed() -> None:
    """X servos refuse goals then: after a program that was killed, and after a bus that was held up."""
    bus_map = a_map("dynamixel", "xl430-w250")
    with bus_board(bus_map) as board:
        for expires in (True, False):
            with servos_on(board, bus_map) as servos:
                if expires:
                    _walks(servos, 0.5)
            for servo in board._servos:
                assert isinstance(servo, BusServo)
                servo.memory[98] = 255 if expires else servo.memory[98]  # as if nothing had ended it
        with servos_on(board, bus_map) as servos:
            _walks(servos, 0.8, 0.1)
            reached = servos.read().joint_positions_rad
            assert reached == pytest.approx(servos.robot.stance_angles_rad + 0.1, abs=5e-3)
            assert servos._thread is not None
            with servos._thread._lock:  # the thread of the bus is held up
                time.sleep(0.6)
            _walks(servos, 0.8)
            assert servos.read().joint_positions_rad == pytest.approx(
                servos.robot.stance_angles_rad, abs=5e-3
            )


def test_a_servo_that_loses_its_torque_is_named_and_not_switched_on_by_itself() -> None:
    with bus_board(a_map()) as board, servos_on(board, a_map()) as servos:
        _walks(servos, 0.5)
        servo = board._servos[7]
        assert isinstance(servo, BusServo)
        servo.memory[40] = 0
        state = _until(servos, lambda state: state.warnings)
        assert state.warnings == ("no torque: leg 3 femur (id 8)",)
        _walks(servos, 0.3)
        assert not board._servos[7].holds


def test_where_no_servo_answers_none_is_asked_for_its_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each question that stays without an answer is waited for, and the next positions come as much later."""
    with bus_board(a_map()) as board, servos_on(board, a_map()) as servos:
        _walks(servos, 0.3)
        thread, polls, asked = servos._thread, 0, 0
        assert thread is not None

        def poll(_: Callable[[], bool]) -> list[Report]:
            nonlocal polls
            polls += 1
            return []

        def torque(*_: object, **__: object) -> bool:
            nonlocal asked
            asked += 1
            return True

        monkeypatch.setattr(thread._device, "torque", torque)
        wait_for(lambda: asked, 5.0, "servos are asked")
        monkeypatch.setattr(thread._device, "poll", poll)
        wait_for(lambda: polls, 5.0, "polls without reports")
        before, since = asked, polls
        wait_for(lambda: polls > since + 3, 5.0, "more of them")
        assert asked == before


def test_a_servo_that_has_let_go_gets_no_goals_until_the_torque_was_off() -> None:
    """Some switch their torque on with a goal, and would jump to it."""
    with bus_board(a_map()) as board, servos_on(board, a_map()) as servos:
        _walks(servos, 0.3)
        servo = board._servos[7]
        assert isinstance(servo, BusServo)
        servo.memory[40] = 0
        _until(servos, lambda state: state.warnings)
        before = bytes(servo.memory[42:44])
        for tick in range(30):
            servos.clock.tick()
            servos.read()
            moved = servos.robot.stance_angles_rad + 0.004 * tick
            servos.write(JointTargets(moved, servos.clock.now_s))
        assert bytes(servo.memory[42:44]) == before
        other = board._servos[8]
        assert isinstance(other, BusServo)
        assert other.holds
        servos.disable_torque()
        _until(servos, lambda state: not state.warnings)
        _walks(servos, 0.3)
        wait_for(lambda: servo.holds, 5.0, "the servo does not hold again")


def test_torque_that_was_to_be_off_is_off_after_closing() -> None:
    with bus_board(a_map()) as board:
        for _ in range(5):
            with servos_on(board, a_map()) as servos:
                _walks(servos, 0.2)
                servos.disable_torque()
            # The last packet may still be on the line.
            wait_for(lambda: not any(servo.holds for servo in board._servos), 5.0, "servos still hold")


def test_torque_off_is_sent_until_every_servo_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """No servo answers the packet for all, so that one that is lost is noticed by reading."""
    with bus_board(a_map()) as board, servos_on(board, a_map()) as servos:
        _walks(servos, 0.3)
        obey = board._family._sync_write  # type: ignore[attr-defined]
        lost: list[bytes] = []

        def lossy(parameters: bytes) -> None:
            if parameters[0] == 40 and len(lost) < 2:
                lost.append(parameters)
            else:
                obey(parameters)

        monkeypatch.setattr(board._family, "_sync_write", lossy)
        servos.disable_torque()
        _until(servos, lambda _: not any(servo.holds for servo in board._servos), write=False)
        assert len(lost) == 2


def test_servos_that_hold_at_connect_are_led_to_the_first_targets() -> None:
    bus_map, seen = a_map(), []
    with bus_board(bus_map) as board:
        with servos_on(board, bus_map) as servos:
            _walks(servos, 0.5)
        with servos_on(board, bus_map) as servos:
            assert servos._thread is not None
            before = bus_map.raw(servos.read().joint_positions_rad)
            write = servos._thread._device.write_goals
            servos._thread._device.write_goals = lambda counts: (seen.append(counts.copy()), write(counts))[1]  # type: ignore
            _walks(servos, 0.3, 0.5)
        speeds = np.degrees(servos.robot.joint_max_speed_rad_s) * bus_map.per_deg
        assert (np.abs(seen[0] - before) <= 0.03 * speeds + 1).all()
        assert np.abs(seen[-1] - before).max() > 0.03 * speeds.max()


def test_goals_that_were_held_up_come_in_steps() -> None:
    bus_map, seen = a_map(), []
    with bus_board(bus_map) as board, servos_on(board, bus_map) as servos:
        _walks(servos, 0.3)
        assert servos._thread is not None
        write = servos._thread._device.write_goals
        servos._thread._device.write_goals = lambda counts: (seen.append(counts.copy()), write(counts))[1]  # type: ignore
        _walks(servos, 1.0, 0.5)
        steps = np.abs(np.diff(np.array(seen), axis=0)).max(axis=0)
        speeds = np.degrees(servos.robot.joint_max_speed_rad_s) * bus_map.per_deg
        assert (steps <= 0.03 * speeds + 1e-6).all()
        goal = bus_map.raw(servos.robot.stance_angles_rad + 0.5)
        assert seen[-1] == pytest.approx(np.clip(goal, bus_map.least, bus_map.most))


def test_a_servo_that_falls_silent_is_named_and_the_others_walk_on() -> None:
    with bus_board(a_map(), "mute:5:femur@1") as board, servos_on(board, a_map()) as servos:
        state = _until(servos, lambda state: state.warnings)
        assert state.warnings == ("mute: leg 5 femur (id 14)",)
        assert state.healthy
        assert state.servos is not None
        assert state.servos.ages_s[13] > 0.4
        assert np.delete(state.servos.ages_s, 13).max() < 0.4
        assert np.isfinite(state.joint_positions_rad).all()
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [13]


def test_a_servo_whose_positions_jump_is_stale_and_named_and_not_mute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its last believed position was taken for one of now as long as it answered."""
    with bus_board(a_map()) as board, servos_on(board, a_map()) as servos:
        _walks(servos, 0.3)
        thread, polls = servos._thread, 0
        assert thread is not None
        poll = thread._device.poll

        def jumping(until: Callable[[], bool]) -> list[Report]:
            nonlocal polls
            polls += 1
            wild = 500.0 * (1 + polls % 2)
            reports = poll(until)
            return [replace(each, position=wild) if each.place == 13 else each for each in reports]

        monkeypatch.setattr(thread._device, "poll", jumping)
        state = _until(servos, lambda state: any("jump" in each for each in state.warnings))
        assert state.warnings == ("answers, but its positions jump: leg 5 femur (id 14)",)
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [13]


def test_servos_of_two_legs_may_be_missing_at_connect_and_not_more() -> None:
    with bus_board(a_map(), "mute:5:femur", "mute:5:coxa") as board, servos_on(board, a_map()) as servos:
        assert servos.read().joint_positions_rad.shape == (18,)
    mute = [f"mute:{leg}:{joint}" for leg in (1, 2, 3) for joint in ("coxa", "femur", "tibia")]
    with bus_board(a_map(), *mute) as board, pytest.raises(RobotFaultError, match=r"leg 1 coxa \(id 1\), "):
        servos_on(board, a_map()).connect()


def test_a_hot_servo_is_named() -> None:
    with bus_board(a_map(), "hot:2:femur:72") as board, servos_on(board, a_map()) as servos:
        state = _until(servos, lambda state: state.warnings)
        assert "hot: leg 2 femur (id 5)" in state.warnings


def test_garbled_answers_stop_nothing() -> None:
    with bus_board(a_map(), "garble:0.05") as board, Guard(servos_on(board, a_map()), expiry_s=1.0) as guard:
        for _ in range(150):
            guard.clock.tick()
            state = guard.read()
            assert state.joint_positions_rad == pytest.approx(guard.robot.stance_angles_rad, abs=0.02)
            guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
        assert guard.stopped is None
        assert guard.link_counts["missed"] > 0


def test_a_port_that_goes_stops_the_robot_and_is_found_again() -> None:
    with (
        bus_board(a_map(), "unplug@1", "replug@3.5") as board,
        Guard(servos_on(board, a_map()), expiry_s=1.0) as guard,
    ):
        stopped_at, ticks = None, 0
        while guard.stopped is None and ticks < 400:
            ticks += 1
            guard.clock.tick()
            guard.read()
            if guard.stopped is None:
                guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
            else:
                stopped_at = guard.stopped
        assert stopped_at == (
            f"fault: no servo answers on {board.path} any more; is the cable in, have they power, or is this "
            "computer too busy?"
        )
        for _ in range(400):
            guard.clock.tick()
            if guard.read().age_s < 0.1:
                break
        guard.clear()
        guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
        assert guard.read().healthy


def test_a_device_that_goes_is_a_fault_until_it_is_back(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    with bus_board(a_map()) as board:
        device.symlink_to(board.path)
        servos = BusServos(shipped("phantomx"), bus_map=a_map(), port=str(device))
        guard = Guard(servos, expiry_s=1.0)
        guard.connect()
        guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
        assert guard.read().healthy
    device.unlink()
    with guard:
        _ticks(guard, lambda: guard.stopped is not None)
        _ticks(guard, lambda: not guard.peek().healthy)
        assert "the port" in str(guard.peek().fault)
        with bus_board(a_map()) as board:
            device.symlink_to(board.path)
            _ticks(guard, lambda: guard.peek().healthy)
            guard.clear()
            assert not board._servos[0].holds, "nothing is switched on by itself"
            guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
            _ticks(guard, lambda: board._servos[0].holds)
        assert guard.link_counts["reopened"] == 1


def _ticks(guard: Guard, condition: Callable[[], bool]) -> None:
    """Tick until a condition holds."""
    for _ in range(400):
        guard.clock.tick()
        guard.read()
        if condition():
            return
    raise AssertionError("not within 8 s")


def test_another_model_than_the_robot_file_says_is_refused() -> None:
    with (
        bus_board(a_map("dynamixel", "xl430-w250")) as board,
        pytest.raises(RobotFaultError, match=r"leg 1 coxa \(id 1\) reports model number 1060, not 1200"),
    ):
        servos_on(board, a_map("dynamixel", "xl330-m288")).connect()


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (1060, "it is of the model xl430-w250: `model: xl430-w250` in the robot file"),
        (0, "check `model` in the robot file; or do the servos need another driver?"),
        (4711, "check `model` in the robot file; or do the servos need another driver?"),
    ],
)
def test_the_model_that_a_servo_is_of_is_named(number: int, advice: str) -> None:
    bus_map = a_map("dynamixel", "xl330-m288")
    with bus_board(bus_map) as board:
        servo = board._servos[0]
        assert isinstance(servo, BusServo)
        servo.memory[0:2] = number.to_bytes(2, "little")
        with pytest.raises(RobotFaultError) as refused:
            servos_on(board, bus_map).connect()
    assert str(refused.value) == (
        f"leg 1 coxa (id 1) reports model number {number}, not 1200 (xl330-m288); {advice}"
    )


def test_nothing_answers_at_another_protocol() -> None:
    with bus_board(a_map()) as board, pytest.raises(RobotFaultError, match="no servo answers on /dev/pts/"):
        servos_on(board, a_map("dynamixel", "xl430-w250")).connect()


def test_targets_beyond_the_limits_of_a_servo_end_there() -> None:
    bus_map = a_map()
    with bus_board(bus_map) as board, servos_on(board, bus_map) as servos:
        far = servos.robot.stance_angles_rad.copy()
        far[1] = 10.0
        sent = servos.write(JointTargets(far, servos.clock.now_s)).joint_positions_rad
        assert bus_map.raw(sent)[1] == pytest.approx(bus_map.least[1])
        assert np.delete(sent, 1) == pytest.approx(np.delete(far, 1))


@pytest.mark.parametrize(
    ("text", "baud", "expected"),
    [
        ("/dev/ttyUSB0", None, ("/dev/ttyUSB0", 1_000_000)),
        ("/dev/ttyUSB0", 57_600, ("/dev/ttyUSB0", 57_600)),
        ("/dev/ttyUSB0:115200", 57_600, ("/dev/ttyUSB0", 115_200)),
        ("/dev/serial/by-path/pci-0:2:1.0-port0", 57_600, ("/dev/serial/by-path/pci-0:2:1.0-port0", 57_600)),
        ("/dev/serial/by-path/pci-0:2:1.0-port0:9600", None, ("/dev/serial/by-path/pci-0:2:1.0-port0", 9600)),
    ],
)
def test_a_port_has_a_baud(text: str, baud: int | None, expected: tuple[str, int]) -> None:
    assert parse_bus_port(text, baud) == expected


@pytest.mark.parametrize("text", [None, "", ":9600", "/dev/x:fast", "/dev/x:1"])
def test_a_port_that_is_none_is_refused(text: str | None) -> None:
    with pytest.raises(InputError, match=r"connect: got .*; allowed: "):
        parse_bus_port(text)
