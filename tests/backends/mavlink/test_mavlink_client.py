"""MAVLink client: conformance, states, faults of link and board, registry entry."""

import math
import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from hexctl.backends.base import LegServos
from hexctl.backends.board_lock import BoardLock
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.mavlink import mavlink_client, mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.backends.mavlink.mavlink_transport import PortAddress, StreamPort, UdpPort, open_port
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.cli.main import exit_code
from hexctl.control.guard import Guard
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.rotations import quaternion_of_euler
from hexctl.simulators import board_messages
from hexctl.testing.servo_conformance import LegServosConformance, check_state, move
from hexctl.types import JointTargets, RobotState
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import (
    MemoryPort,
    OnMemory,
    ScriptedBoard,
    board,
    fitting_file,
    fitting_map,
    memory_board,
    servos_on,
)
from tests.backends.mavlink.test_codec import frame_of_mavlink_1, override_frame, valid_frame
from tests.backends.standing import command, next_state, stand, until
from tests.firmware.boards import BOARDS
from tests.robots import shipped

nan, inf = math.nan, math.inf


@pytest.mark.parametrize("run", BOARDS)
class TestOverMemory(LegServosConformance):
    @pytest.fixture(autouse=True)
    def board(self, run: Any, tmp_path: Path) -> Iterator[None]:
        with run(fitting_map(tmp_path)) as self.running:
            yield

    def make(self) -> LegServos:
        return servos_on(self.running.port, self.running.servo_map)


# States that a board tells.


def servos_at(
    board: ScriptedBoard, folder: Path, *, key: bytes | None = None, servos: dict[str, Any] | None = None
) -> OnMemory:
    servo_map = load_robot_file(fitting_file(folder, servos)).servo_map
    board.pulses_us = servo_map.to_us(shipped().stance_angles_rad)
    return servos_on(board.port, servo_map, key=key)


def state_after(servos: MavlinkServos, board: ScriptedBoard, *said: Any) -> RobotState:
    """The state once the board has said something for a few periods."""
    board.extra = list(said)
    board.port.time.sleep(0.05)
    return next_state(servos)


def attitude(roll: float, pitch: float, yaw: float) -> Any:
    return common.MAVLink_attitude_message(0, roll, pitch, yaw, 0, 0, 0)


def orientation(*components: float) -> Any:
    return common.MAVLink_attitude_quaternion_message(0, *components, 0, 0, 0)


def position(x: float, y: float, z: float, at_ms: int = 0) -> Any:
    return common.MAVLink_local_position_ned_message(at_ms, x, y, z, 0, 0, 0)


def odometry(frame: int) -> Any:
    unknown = [nan] * 21
    return common.MAVLink_odometry_message(
        0, frame, 8, 1, 2, 3, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, unknown, unknown
    )


def battery(*cells_mv: int, share: int = -1) -> Any:
    cells = [*cells_mv, *[65535] * (10 - len(cells_mv))]
    return common.MAVLink_battery_status_message(0, 0, 0, 0, cells, -1, -1, -1, share)


def test_joint_positions_are_an_echo_until_the_board_says_that_it_measures(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = next_state(servos)
        assert not state.measured
        np.testing.assert_allclose(state.joint_positions_rad, shipped().stance_angles_rad, atol=1e-6)
        assert state.base_position_world is None
        assert state_after(servos, board, board_messages.measured(True, 0.0)).measured
        assert not state_after(servos, board, board_messages.measured(False, 0.0)).measured


def test_every_state_arrives_although_sequence_numbers_begin_again(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        for _ in range(75):
            assert next_state(servos).age_s <= PERIOD_S
        assert board.sequence > 256
        assert (servos.counters.lost, servos.counters.out_of_order) == (0, 0)


def test_a_servo_that_is_not_driven_and_not_measured_counts_as_told_last(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        board.active = 0
        with servos_at(board, tmp_path) as servos:
            board.pulses_us = np.zeros(18)
            stance = shipped().stance_angles_rad
            np.testing.assert_allclose(next_state(servos).joint_positions_rad, stance)
            command(servos, 0.1)
            np.testing.assert_allclose(next_state(servos).joint_positions_rad, stance + 0.1)


HALF = math.cos(0.25), math.sin(0.25)


@pytest.mark.parametrize(
    ("said", "position_world", "quaternion_world"),
    [
        ([attitude(0, 0, -0.5), position(1, -2, -0.12)], (1, 2, 0.12), (HALF[0], 0, 0, HALF[1])),
        (
            [orientation(*quaternion_of_euler(0, 0, 0.5)), position(1, -2, 0)],
            (1, 2, 0),
            (HALF[0], 0, 0, -HALF[1]),
        ),
        ([attitude(0.5, 0, 0)], None, (*HALF, 0, 0)),
        ([position(1, -2, -0.12)], (1, 2, 0.12), None),
        ([odometry(21)], None, None),
        ([odometry(common.MAV_FRAME_LOCAL_FRD)], (1, -2, -3), (1, 0, 0, 0)),
        ([attitude(nan, 0, 0)], None, None),
        ([attitude(0, inf, 0)], None, None),
        ([orientation(nan, 0, 0, 0)], None, None),
        ([orientation(0, 0, 0, 0)], None, None),
        ([orientation(30, 0, 0, 0)], None, None),
        ([position(0, nan, 0)], None, None),
    ],
)
def test_a_pose_comes_from_ned_and_is_none_while_nothing_sensible_comes(
    said: list[Any],
    position_world: tuple[float, ...] | None,
    quaternion_world: tuple[float, ...] | None,
    tmp_path: Path,
) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, *said)
        for seen, expected in (
            (state.base_position_world, position_world),
            (state.base_quaternion_world, quaternion_world),
        ):
            if expected is None:
                assert seen is None
            else:
                assert seen == pytest.approx(np.array(expected), abs=1e-6)
        assert (servos.counters.refused > 0) == (position_world is quaternion_world is None)
        assert np.isfinite(state.joint_positions_rad).all()
        board.extra = []
        board.port.time.sleep(0.5)
        later = next_state(servos)
        assert later.base_position_world is None
        assert later.base_quaternion_world is None
        assert later.healthy


def test_foot_contacts_come_by_leg_and_only_while_they_are_fresh(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert next_state(servos).foot_contacts is None
        touching = np.array([False, True, False, False, True, True])
        seen = state_after(servos, board, board_messages.contacts(touching, 0.0)).foot_contacts
        np.testing.assert_array_equal(seen, touching)
        board.extra = []
        board.port.time.sleep(0.5)
        assert next_state(servos).foot_contacts is None
        wild = common.MAVLink_named_value_int_message(0, b"contacts", 64)
        assert state_after(servos, board, wild).foot_contacts is None
        assert servos.counters.refused > 0


def test_a_position_with_an_old_stamp_is_not_used_unless_the_board_has_started_again(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        slow = (200, 1.0, True)  # a clock 0.5 % slow
        for wait_s, late_s, known in (
            (1, 0.0, True),
            (1, 0.3, True),
            (1, 0.9, False),
            slow,
            (1, 900.0, True),
        ):
            board.port.time.sleep(wait_s)
            for _ in range(3):
                board.say(position(1, 2, 3, round(1000 * (board.port.time.now_s - late_s))))
                board.port.time.sleep(0.02)
            assert (next_state(servos).base_position_world is not None) is known, late_s
        assert servos.counters.late == 3


@pytest.mark.parametrize("pulse", [nan, inf, -inf, 0.0, -1500.0, 1e30])
def test_pulses_that_no_servo_has_are_no_state_and_stop_the_robot(pulse: float, tmp_path: Path) -> None:
    with ScriptedBoard() as board, Guard(servos_at(board, tmp_path)) as guard:
        next_state(guard)
        board.pulses_us = np.full(18, pulse)
        for _ in range(50):
            next_state(guard)
        assert guard.stopped == "state"


@pytest.mark.parametrize(("further_mv", "volts"), [((3700, 3600), 44.3), ((65535, 0), 37.0)])
def test_cells_beyond_the_tenth_count_if_they_are_known(further_mv: tuple[int, int], volts: float) -> None:
    cells = [3700] * 10
    message = common.MAVLink_battery_status_message(
        0, 0, 0, 0, cells, -1, -1, -1, 50, voltages_ext=[*further_mv, 0, 0]
    )
    assert mavlink_messages.battery_of(message).voltage_v == pytest.approx(volts)


def test_a_low_battery_is_reported_with_its_threshold(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path, servos={"low_battery_v": 10.0}) as servos:
        fine = state_after(servos, board, battery(3700, 3700, 3700, share=40))
        assert (fine.healthy, fine.battery_share) == (True, 0.4)
        assert fine.battery_v == pytest.approx(11.1)
        low = state_after(servos, board, battery(9600))
        assert (low.healthy, low.low_battery_v) == (True, 10.0)
        assert low.battery_v == pytest.approx(11.1), "a single message may be wrong"
        until(servos, lambda state: state.battery_v == pytest.approx(9.6), write=False)


def test_the_battery_of_sys_status_counts_where_there_is_no_other(tmp_path: Path) -> None:
    def status(millivolts: int) -> Any:
        return common.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, 55, 0, 0, 0, 0, 0, 0)

    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert state_after(servos, board, status(65535)).battery_v is None
        assert state_after(servos, board, status(7400)).battery_v == pytest.approx(7.4)
        assert state_after(servos, board, status(7400), battery(8000)).battery_v == pytest.approx(8.0)


def test_an_error_text_and_an_emergency_are_faults(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert state_after(servos, board, board_messages.text(4, "a warning")).healthy
        state = state_after(servos, board, board_messages.text(2, "servo 3\x07 overload"))
        assert (state.healthy, state.fault) == (False, "the board reports: servo 3 overload")
        board.extra = []
        until(servos, lambda state: state.healthy, write=False)
        board.state = mavlink_messages.EMERGENCY
        assert "MAV_STATE 6" in str(until(servos, lambda state: not state.healthy, write=False).fault)


def test_pulse_limits_clip_last_and_are_counted(tmp_path: Path) -> None:
    narrow = {"leg1_coxa": {"min_us": 1400, "max_us": 1600}}
    with ScriptedBoard() as board, servos_at(board, tmp_path, servos=narrow) as servos:
        wanted = shipped().stance_angles_rad.copy()
        wanted[0] = 0.5
        sent = servos.write(JointTargets(wanted, servos.clock.now_s))
        assert sent.joint_positions_rad[0] == pytest.approx(math.radians(9))
        np.testing.assert_allclose(sent.joint_positions_rad[1:], wanted[1:])
        assert servos.counters.clipped == 1
        until(servos, lambda _: board.overrides(), write=False)
        assert board.overrides()[-1][0] == 1600


def test_torque_off_releases_and_closing_says_goodbye_and_moves_nothing(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        with servos_at(board, tmp_path) as servos:
            assert servos.disable_torque()
            board.port.time.sleep(0.05)
            assert board.overrides() == [[0] * 8 + [65534] * 10]
        board.port.time.sleep(0.05)
        assert board.heard[-1].message.system_status == mavlink_messages.POWEROFF
        assert board.heard[-1].message.type == common.MAV_TYPE_ONBOARD_CONTROLLER
        assert len(board.overrides()) == 1


def test_a_board_on_another_address_is_not_ours(tmp_path: Path) -> None:
    """At a port where others come to, the first board that beats stays the one."""
    with ScriptedBoard(port=MemoryPort(FakeTime(), "ours")) as board, servos_at(board, tmp_path) as servos:
        intruder = ScriptedBoard(port=MemoryPort(board.port.time, "intruder"))
        intruder.port.others["controller"] = board.port.others["controller"]
        with intruder:
            until(servos, lambda _: servos.counters.foreign > 5, write=False)
            assert servos._peer.address == "ours"
            state = next_state(servos)
        np.testing.assert_allclose(state.joint_positions_rad, shipped().stance_angles_rad, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": 13}, "type 13"),
        ({"silent": True}, "ACTUATOR_OUTPUT_STATUS"),
        ({"key": bytes(32)}, "signing key"),
        ({"own_key": bytes(32)}, "clock"),
        ({"port": MemoryPort(FakeTime())}, "no heartbeat"),
    ],
    ids=["a drone with six rotors", "no servo positions", "another key", "or another clock", "no board"],
)
def test_a_board_that_cannot_be_is_refused_at_connect(
    change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with ScriptedBoard(signing_key=change.get("key")) as board:
        for name in change.keys() & {"kind", "silent"}:
            setattr(board, name, change[name])
        port = MemoryPort(board.port.time) if "port" in change else board.port
        servos = servos_on(port, fitting_map(tmp_path), key=change.get("own_key"))
        with pytest.raises(RobotFaultError, match=said):
            servos.connect()
        servos.close()


def test_a_board_of_mavlink_1_is_named(tmp_path: Path) -> None:
    servos = servos_on(MemoryPort(FakeTime()), fitting_map(tmp_path))
    servos.memory_port.put(frame_of_mavlink_1(mavlink_messages.controller_heartbeat()), None)
    with pytest.raises(RobotFaultError, match="MAVLink 1"):
        servos.connect()


@pytest.mark.parametrize("end", ["receive", "send", "beat"])
def test_a_port_that_fails_is_a_fault(end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise OSError("the cable has gone")

    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        stand(servos, 3)
        if end == "receive":
            servos.memory_port.gone = True
        else:
            monkeypatch.setattr(servos.memory_port, "send", fails)
        writes, ticks = (True, 1) if end == "send" else (False, 60)  # within it a heartbeat is due
        with pytest.raises(RobotFaultError, match="has gone"):
            until(servos, lambda _: False, write=writes, ticks=ticks)


# Faults of a link to the simulated board.


@pytest.mark.parametrize("run", BOARDS)
def test_after_a_pause_the_first_command_counts(run: Any, tmp_path: Path) -> None:
    """The board holds the pose then, and must not take what is new for what comes late."""
    with run(fitting_map(tmp_path)) as running:
        with servos_on(running.port, running.servo_map) as servos:
            for _ in range(2):
                stand(servos, 1)
                running.time.sleep(0.6)
        report = running.end()
    assert (report["overrides"], report["not_yet"]) == (2, 0)
    assert report["expired"] >= 1


def test_a_second_controller_is_refused_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of another computer: on this one a lock refuses it before."""
    monkeypatch.setattr(mavlink_client, "lock_port", lambda *_, **__: BoardLock("", ()))
    with memory_board(fitting_map(tmp_path)) as running:
        first, second = (
            Guard(servos_on(running.port, running.servo_map, name=name)) for name in ("first", "second")
        )
        with first, second:
            stand(first, 10)
            for _ in range(100):
                stand(first, 1)
                next_state(second)
                if second.stopped is not None:
                    break
                command(second, 0.3)
            assert second.stopped == "fault: the board reports: another controller holds the servos"
            stand(first, 10)
            reached = first.read().joint_positions_rad
            np.testing.assert_allclose(reached, shipped().stance_angles_rad, atol=0.03)
        with Guard(servos_on(running.port, running.servo_map, name="third")) as third:
            stand(third, 10)
            assert third.stopped is None
        assert running.end()["of_others"] > 0


@pytest.mark.parametrize("run", BOARDS)
@pytest.mark.parametrize("walks", [False, True])
def test_a_crowd_takes_no_state_from_a_controller_that_is_there(
    walks: bool, run: Any, tmp_path: Path
) -> None:
    """200 systems, each with a heartbeat five times in a second."""
    crowd = [Codec(number, 9).encode(mavlink_messages.controller_heartbeat(), 0) for number in range(1, 201)]
    with (
        run(fitting_map(tmp_path)) as running,
        Guard(servos_on(running.port, running.servo_map)) as guard,
    ):
        for tick in range(150):
            for number in range(20):
                each = (20 * tick + number) % 200
                running.port.put(crowd[each], f"crowd {each}")
            state = next_state(guard)
            assert state.age_s <= 1.5 * PERIOD_S
            if walks:
                command(guard)
        assert guard.stopped is None
        counters = guard.unwrapped.counters  # type: ignore[attr-defined]
        assert (counters.lost, counters.out_of_order, counters.refused) == (0, 0, 0)
        assert counters.received > 150
        assert running.end()["crowded_out"] > 1000


@pytest.mark.parametrize("run", BOARDS)
def test_a_flooded_board_moves_nothing_and_goes_on(run: Any, tmp_path: Path) -> None:
    draw, good = random.Random(11), override_frame()
    elsewhere = Codec(255, 191).encode(mavlink_messages.override(np.full(18, 900.0), 77, 1), 0)
    with (
        run(fitting_map(tmp_path)) as running,
        Guard(servos_on(running.port, running.servo_map)) as guard,
    ):
        stand(guard, 20)
        before = guard.read().joint_positions_rad
        for count in range(3_000):
            changed = bytearray(good)
            changed[draw.randrange(50)] ^= 1 << draw.randrange(8)
            data = (
                draw.randbytes(draw.randrange(1, 200)),
                bytes(changed),
                good[: draw.randrange(1, 50)],
                valid_frame(draw, draw.choice([1, 4, 76, 77, 253, 375])),
                elsewhere,
            )[count % 5]
            running.port.put(data, "hostile")
            if count % 100 == 0:
                stand(guard, 1)
        stand(guard, 20)
        assert guard.stopped is None
        np.testing.assert_allclose(guard.read().joint_positions_rad, before, atol=1e-3)
        report = running.end()
        assert report["malformed"] > 100
        assert report["refused"] == 0
        assert report["overrides"] > 60


# Over UDP and pseudo-terminals, on the wall clock.


@pytest.mark.realtime
@pytest.mark.parametrize("pty", [False, True], ids=["udp", "pty"])
def test_a_simulated_robot_measures_and_stops_its_controller_when_it_goes(pty: bool, tmp_path: Path) -> None:
    """A board that hangs is silent; a pseudo-terminal goes with its process, as a device with its plug."""
    file = fitting_file(tmp_path)
    with board("--robot", str(file), pty=pty) as running:
        servos = MavlinkServos(shipped(), servo_map=load_robot_file(file).servo_map, port=running.port)
        with Guard(servos, expiry_s=1.0) as guard:
            check_state(guard.read(), guard)
            LegServosConformance().test_a_small_change_is_reached_within_a_second(guard)
            move(guard, guard.robot.stance_angles_rad, ticks=50)
            state = guard.read()
            assert state.measured
            assert state.base_position_world is not None
            assert state.base_position_world[2] == pytest.approx(guard.robot.standing_height_m, abs=0.01)
            running.process.send_signal(signal.SIGSTOP)
            until(guard, lambda _: guard.stopped is not None, write=False)
            assert guard.stopped == "state"
            assert guard.read().age_s > 1.0
            running.process.send_signal(signal.SIGCONT)
            until(guard, lambda state: state.age_s < 0.1, write=False)
            guard.clear()
            stand(guard, 5)
            assert guard.stopped is None
            if pty:
                running.process.kill()
                with pytest.raises(RobotFaultError, match="/dev/pts"):
                    stand(guard, 500)
                return
        report = running.end()
        assert report["overrides"] >= 150
        assert report["refused"] == report["malformed"] == 0


# The entry of the registry.


def made(**options: object) -> MavlinkServos:
    servos = make_servos("mavlink", BackendOptions(robot=shipped(), **options))  # type: ignore[arg-type]
    assert isinstance(servos, MavlinkServos)
    return servos


def test_port_and_servo_map_are_those_of_the_options(tmp_path: Path) -> None:
    assert made()._port == "udpout:127.0.0.1:14550"
    assert made(port="/dev/ttyACM0:57600")._address.number == 57600
    path = fitting_file(tmp_path, {"leg1_coxa": {"sign": -1}})
    assert made(robot_file=load_robot_file(path)).servo_map.signs[0] == -1
    with pytest.raises(InputError, match="port: got 'COM3'"):
        made(port="COM3")


def test_the_command_makes_a_key_that_is_read_and_never_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    with pytest.raises(InputError, match=r"mavlink\.key"):
        made(credentials=folder)
    assert exit_code(["keys", "mavlink", str(folder)]) == 0
    key = folder / "mavlink.key"
    content = key.read_bytes()
    assert key.stat().st_mode & 0o077 == 0
    assert made(credentials=folder)._signing_key == bytes.fromhex(content.decode())
    assert exit_code(["keys", "mavlink", str(folder)]) == 2
    assert key.read_bytes() == content
    key.write_text("00" * 9)
    with pytest.raises(InputError, match=r"mavlink\.key: has 9 bytes"):
        made(credentials=folder)


def test_an_unsigned_port_that_others_reach_must_be_asked_for(tmp_path: Path) -> None:
    far = "udpout:192.168.1.9:14550"
    with pytest.raises(InputError, match="insecure"):
        made(port=far)
    assert made(port=far, insecure=True)._port == far
    (tmp_path / "mavlink.key").touch(mode=0o600)
    (tmp_path / "mavlink.key").write_text("00" * 32)
    assert made(port=far, credentials=tmp_path)._port == far


def test_a_full_serial_port_drops_complete_frames_and_never_waits() -> None:
    """A frame that was cut off goes on once there is room: without its end, the next one is lost too."""
    far, near = os.pipe()
    port = StreamPort(near, lambda: os.close(near))
    assert not os.get_blocking(near), "a write would wait without end"
    sent = 0
    while not port.dropped:
        port.send(bytes([sent]) * 10_000, None)
        sent += 1
    got = os.read(far, 1_000_000)
    assert len(got) % 10_000, "the last one was cut off"
    port.send(b"z" * 10_000, None)
    port.close()
    got += os.read(far, 1_000_000)
    kept = [*range(sent - 1), ord("z")]
    assert got == b"".join(bytes([number]) * 10_000 for number in kept)
    assert port.dropped == 1
    with pytest.raises(OSError, match="closed"):
        StreamPort(far, lambda: os.close(far)).receive(0.0)
    os.close(far)


def test_datagrams_are_answered_to_their_sender_and_one_that_nobody_hears_is_a_lost_one() -> None:
    bound = UdpPort(PortAddress("udpin", "127.0.0.1", 0))
    number = bound._socket.getsockname()[1]
    with pytest.raises(RobotFaultError, match="the port mine cannot be opened"):
        open_port(PortAddress("udpin", "127.0.0.1", number), text="mine")
    peers = [UdpPort(PortAddress("udpout", "127.0.0.1", number)) for _ in range(2)]
    for peer in peers:
        peer.send(b"here", None)
    (first, to), (second, other) = bound.receive(1.0)
    assert (first, second) == (b"here", b"here")
    assert to != other
    bound.send(b"you", to)
    assert [peer.receive(0.0) for peer in peers] == [[(b"you", None)], []]
    assert bound.receive(0.0) == []
    bound.close()
    for _ in range(4):
        peers[0].send(b"still there?", None)
        assert peers[0].receive(0.0) == []
    assert [peer.dropped for peer in peers] in ([0, 0], [2, 0], [4, 0])
    for peer in peers:
        peer.close()
