"""MAVLink client: conformance over UDP and a pseudo-terminal, states, link faults, registry entry."""

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from hexctl.backends.base import LegServos
from hexctl.backends.mavlink import mavlink_client, mavlink_messages
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.backends.mavlink.mavlink_messages import quaternion_of_euler
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.cli.main import exit_code
from hexctl.control.guard import Guard
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.loader import load_robot_file
from hexctl.simulators import board_messages
from hexctl.testing.servo_conformance import LegServosConformance, check_state, move
from hexctl.types import JointTargets, RobotState
from tests.backends.mavlink.boards import (
    BoardProcess,
    ScriptedBoard,
    board,
    eventually,
    fast_clock,
    fitting_file,
    fitting_map,
    free_port,
)
from tests.robots import shipped

pytestmark = pytest.mark.realtime


class OverBoard(LegServosConformance):
    """The suite against one board that all its tests share, one after the other.

    Attributes:
        pty: whether it speaks over a pseudo-terminal.
    """

    pty = False
    running: BoardProcess
    file: Path

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _board(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        cls.file = fitting_file(tmp_path_factory.mktemp("robot"))
        with board("--backend", "mock", "--robot", str(cls.file), pty=cls.pty) as running:
            cls.running = running
            yield

    def make(self) -> LegServos:
        return MavlinkServos(
            shipped(),
            servo_map=load_robot_file(self.file).servo_map,
            port=self.running.port,
            clock=fast_clock(),
        )


class TestOverUdp(OverBoard):
    pass


class TestOverPseudoTerminal(OverBoard):
    pty = True


@pytest.mark.parametrize("pty", [False, True], ids=["udp", "pty"])
def test_a_simulated_robot_measures_and_knows_its_pose(pty: bool, tmp_path: Path) -> None:
    """The few of the suite that physics could spoil, on a clock that is the wall's."""
    file = fitting_file(tmp_path)
    with board("--robot", str(file), pty=pty) as running:
        servos = MavlinkServos(shipped(), servo_map=load_robot_file(file).servo_map, port=running.port)
        with servos:
            check_state(servos.read(), servos)
            suite = LegServosConformance()
            suite.test_a_small_change_is_reached_within_a_second(servos)
            move(servos, servos.robot.stance_angles_rad, ticks=50)
            state = servos.read()
            check_state(state, servos)
            assert state.measured
            assert state.base_position_world is not None
            assert state.base_position_world[2] == pytest.approx(servos.robot.standing_height_m, abs=0.01)
        report = running.end()
        assert report["overrides"] >= 150
        assert report["refused"] == report["malformed"] == 0


nan, inf = math.nan, math.inf


def servos_at(
    board: ScriptedBoard, folder: Path, *, key: bytes | None = None, servos: dict[str, Any] | None = None
) -> MavlinkServos:
    servo_map = load_robot_file(fitting_file(folder, servos)).servo_map
    board.pulses_us = servo_map.to_us(shipped().stance_angles_rad)
    return MavlinkServos(shipped(), servo_map=servo_map, port=board.port, signing_key=key)


def test_after_a_pause_the_first_command_counts(tmp_path: Path) -> None:
    """The board holds the pose then, and must not take what is new for what comes late."""
    file = fitting_file(tmp_path)
    with board("--backend", "mock", "--robot", str(file)) as running:
        robot = shipped()
        with MavlinkServos(robot, servo_map=load_robot_file(file).servo_map, port=running.port) as servos:
            for _ in range(2):
                servos.clock.tick()
                servos.write(JointTargets(robot.stance_angles_rad, servos.clock.now_s))
                time.sleep(0.6)
        report = running.end()
    assert (report["overrides"], report["not_yet"]) == (2, 0)
    assert report["expired"] >= 1


def next_state(servos: MavlinkServos) -> RobotState:
    servos.clock.tick()
    return servos.read()


def state_after(servos: MavlinkServos, board: ScriptedBoard, *said: Any) -> RobotState:
    """The state once the board has said something for a few periods."""
    board.extra = list(said)
    before = servos.counters.received + servos.counters.refused
    eventually(lambda: servos.counters.received + servos.counters.refused > before + 3 * (2 + len(said)))
    return next_state(servos)


def attitude(roll: float, pitch: float, yaw: float) -> Any:
    return common.MAVLink_attitude_message(0, roll, pitch, yaw, 0, 0, 0)


def orientation(*components: float) -> Any:
    return common.MAVLink_attitude_quaternion_message(0, *components, 0, 0, 0)


def position(x: float, y: float, z: float) -> Any:
    return common.MAVLink_local_position_ned_message(0, x, y, z, 0, 0, 0)


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


def test_a_servo_that_is_not_driven_and_not_measured_counts_as_told_last(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        board.active = 0
        with servos_at(board, tmp_path) as servos:
            board.pulses_us = np.zeros(18)
            stance = shipped().stance_angles_rad
            np.testing.assert_allclose(next_state(servos).joint_positions_rad, stance)
            servos.write(JointTargets(stance + 0.1, servos.clock.now_s))
            np.testing.assert_allclose(next_state(servos).joint_positions_rad, stance + 0.1)


def test_the_pose_comes_from_ned(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, attitude(0, 0, -0.5), position(1, -2, -0.12))
        assert state.base_position_world is not None
        assert state.base_quaternion_world is not None
        np.testing.assert_allclose(state.base_position_world, [1, 2, 0.12], atol=1e-6)
        np.testing.assert_allclose(
            state.base_quaternion_world, [math.cos(0.25), 0, 0, math.sin(0.25)], atol=1e-6
        )
        turned = state_after(servos, board, orientation(*quaternion_of_euler(0, 0, 0.5)), position(1, -2, 0))
        assert turned.base_quaternion_world is not None
        assert turned.base_quaternion_world[3] == pytest.approx(-math.sin(0.25), abs=1e-6)


def test_an_inertial_sensor_alone_tells_how_the_body_leans(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, attitude(0.5, 0, 0))
        assert state.base_position_world is None
        assert state.base_quaternion_world is not None
        np.testing.assert_allclose(
            state.base_quaternion_world, [math.cos(0.25), math.sin(0.25), 0, 0], atol=1e-6
        )
        board.extra = []
        eventually(lambda: next_state(servos).base_quaternion_world is None)


def test_a_position_alone_is_no_orientation(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, position(1, -2, -0.12))
        assert state.base_quaternion_world is None
        assert state.base_position_world is not None
        np.testing.assert_allclose(state.base_position_world, [1, 2, 0.12], atol=1e-6)


def test_odometry_is_a_pose_by_itself(tmp_path: Path) -> None:
    def odometry(frame: int) -> Any:
        unknown = [nan] * 21
        return common.MAVLink_odometry_message(
            0, frame, 8, 1, 2, 3, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, unknown, unknown
        )

    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert state_after(servos, board, odometry(21)).base_position_world is None
        assert servos.counters.refused > 0
        state = state_after(servos, board, odometry(common.MAV_FRAME_LOCAL_FRD))
        assert state.base_position_world is not None
        np.testing.assert_allclose(state.base_position_world, [1, -2, -3])


def test_a_pose_that_stops_coming_is_none(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert (
            state_after(servos, board, attitude(0, 0, 0), position(0, 0, 0)).base_position_world is not None
        )
        board.extra = []
        eventually(lambda: next_state(servos).base_position_world is None)
        assert servos.read().healthy


@pytest.mark.parametrize(
    "said",
    [
        attitude(nan, 0, 0),
        attitude(0, inf, 0),
        orientation(nan, 0, 0, 0),
        orientation(0, 0, 0, 0),
        orientation(30, 0, 0, 0),
    ],
    ids=["nan", "inf", "quaternion-nan", "quaternion-zero", "quaternion-long"],
)
def test_an_orientation_that_is_none_is_no_pose(said: Any, tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, said, position(0, 0, 0))
        assert state.base_quaternion_world is None
        assert servos.counters.refused > 0
        assert np.isfinite(state.joint_positions_rad).all()


def test_a_position_that_is_not_finite_is_no_pose(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        state = state_after(servos, board, attitude(0, 0, 0), position(0, nan, 0))
        assert state.base_position_world is None


@pytest.mark.parametrize("pulse", [nan, inf, -inf, 0.0, -1500.0, 1e30])
def test_pulses_that_no_servo_has_are_no_state_and_stop_the_robot(pulse: float, tmp_path: Path) -> None:
    with ScriptedBoard() as board, Guard(servos_at(board, tmp_path)) as guard:
        guard.clock.tick()
        guard.read()
        board.pulses_us = np.full(18, pulse)
        eventually(lambda: not tick_stopped(guard))
        assert guard.stopped == "state"


def tick_stopped(guard: Guard) -> bool:
    """Let a tick pass and return whether the guard still lets the robot move."""
    guard.clock.tick()
    guard.read()
    return guard.stopped is None


def test_a_low_battery_is_reported_with_its_threshold(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path, servos={"low_battery_v": 10.0}) as servos:
        fine = state_after(servos, board, battery(3700, 3700, 3700, share=40))
        assert (fine.healthy, fine.battery_share) == (True, 0.4)
        assert fine.battery_v == pytest.approx(11.1)
        low = state_after(servos, board, battery(9600))
        assert (low.healthy, low.battery_v, low.low_battery_v) == (True, pytest.approx(9.6), 10.0)


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
        assert (state.healthy, state.fault) == (False, "the board says: servo 3 overload")
        board.extra = []
        eventually(lambda: next_state(servos).healthy)
        board.state = mavlink_messages.EMERGENCY
        eventually(lambda: not next_state(servos).healthy)
        assert "MAV_STATE 6" in str(servos.read().fault)


def test_pulse_limits_clip_last_and_are_counted(tmp_path: Path) -> None:
    narrow = {"leg1_coxa": {"min_us": 1400, "max_us": 1600}}
    with ScriptedBoard() as board, servos_at(board, tmp_path, servos=narrow) as servos:
        wanted = shipped().stance_angles_rad.copy()
        wanted[0] = 0.5
        sent = servos.write(JointTargets(wanted, servos.clock.now_s))
        assert sent.joint_positions_rad[0] == pytest.approx(math.radians(9))
        np.testing.assert_allclose(sent.joint_positions_rad[1:], wanted[1:])
        assert servos.counters.clipped == 1
        eventually(board.overrides)
        assert board.overrides()[-1][0] == 1600


def test_letting_go(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        assert servos.disable_torque()
        eventually(board.overrides)
        assert board.overrides()[-1] == [0] * 8 + [65534] * 10


def test_closing_says_goodbye_and_moves_nothing(tmp_path: Path) -> None:
    with ScriptedBoard() as board:
        with servos_at(board, tmp_path):
            pass
        eventually(lambda: any(frame.kind == "HEARTBEAT" for frame in board.heard))
        eventually(lambda: board.heard[-1].message.system_status == mavlink_messages.POWEROFF)
        assert board.overrides() == []
        assert board.heard[-1].message.type == common.MAV_TYPE_ONBOARD_CONTROLLER


def test_losses_and_noise_are_counted(tmp_path: Path) -> None:
    with ScriptedBoard() as board, servos_at(board, tmp_path) as servos:
        board._sequence += 5
        eventually(lambda: servos.counters.lost >= 5)
        board.say_bytes(b"noise")
        eventually(lambda: servos.counters.malformed >= 1)
        assert next_state(servos).healthy


class TestConnecting:
    @pytest.fixture(autouse=True)
    def _impatient(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(mavlink_client, "CONNECT_TIMEOUT_S", 0.5)

    def connecting(self, folder: Path, port: str) -> str:
        """Message with which connecting fails."""
        servos = MavlinkServos(shipped(), servo_map=fitting_map(folder), port=port)
        with pytest.raises(RobotFaultError) as refused:
            servos.connect()
        servos.close()
        assert "\n" not in str(refused.value)
        return str(refused.value)

    def test_no_board(self, tmp_path: Path) -> None:
        message = self.connecting(tmp_path, f"udpout:127.0.0.1:{free_port()}")
        assert "no heartbeat" in message
        assert "baud rate" in message

    def test_no_such_device(self, tmp_path: Path) -> None:
        assert "/dev/no-such-port" in self.connecting(tmp_path, "/dev/no-such-port")

    def test_a_port_in_use(self, tmp_path: Path) -> None:
        with ScriptedBoard() as board:
            assert "cannot be opened" in self.connecting(tmp_path, board.port.replace("udpout", "udpin"))

    def test_a_drone_with_six_rotors(self, tmp_path: Path) -> None:
        with ScriptedBoard() as board:
            board.kind = 13
            assert "type 13" in self.connecting(tmp_path, board.port)

    def test_a_board_that_says_nothing_of_its_servos(self, tmp_path: Path) -> None:
        with ScriptedBoard() as board:
            board.silent = True
            assert "ACTUATOR_OUTPUT_STATUS" in self.connecting(tmp_path, board.port)

    def test_a_board_that_wants_another_key(self, tmp_path: Path) -> None:
        with ScriptedBoard(signing_key=bytes(32)) as board:
            message = self.connecting(tmp_path, board.port)
        assert "signing key" in message
        assert " 0 runs" not in message

    def test_a_port_that_is_none(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="connect: got 'COM3'"):
            MavlinkServos(shipped(), servo_map=fitting_map(tmp_path), port="COM3")


def test_a_signed_link_works_both_ways(tmp_path: Path) -> None:
    key = bytes(range(32))
    with ScriptedBoard(signing_key=key) as board, servos_at(board, tmp_path, key=key) as servos:
        assert next_state(servos).healthy
        servos.write(JointTargets(shipped().stance_angles_rad, servos.clock.now_s))
        eventually(board.overrides)


def test_a_board_on_another_address_is_not_ours(tmp_path: Path) -> None:
    """At a port where others come to, the first board that beats stays the one."""
    with ScriptedBoard() as other:
        servo_map = fitting_map(tmp_path)
        servos = MavlinkServos(shipped(), servo_map=servo_map, port=f"udpin:127.0.0.1:{free_port()}")
        other.pulses_us = servo_map.to_us(shipped().stance_angles_rad)
        intruder = ScriptedBoard()
        _, host, number = servos._port_text.split(":")
        other._client = intruder._client = (host, int(number))
        with servos, intruder:
            ours = servos._peer.address
            eventually(lambda: servos.counters.foreign > 5)
            assert servos._peer.address == ours
            state = next_state(servos)
            np.testing.assert_allclose(state.joint_positions_rad, shipped().stance_angles_rad, atol=1e-6)
            time.sleep(0)


def made(**options: object) -> MavlinkServos:
    servos = make_servos("mavlink", BackendOptions(robot=shipped(), **options))  # type: ignore[arg-type]
    assert isinstance(servos, MavlinkServos)
    return servos


def test_it_looks_for_a_board_on_this_computer_unless_told_otherwise() -> None:
    assert made()._port_text == "udpout:127.0.0.1:14550"
    assert made(connect="/dev/ttyACM0:57600")._address.number == 57600


def test_the_servo_map_comes_from_the_robot_file(tmp_path: Path) -> None:
    path = fitting_file(tmp_path, {"leg1_coxa": {"sign": -1}})
    assert made(robot_file=load_robot_file(path)).servo_map.signs[0] == -1


def test_the_key_comes_from_the_folder_of_keys(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"mavlink\.key: cannot be read .*; allowed: a file of 32 random"):
        made(credentials=tmp_path)
    key = tmp_path / "mavlink.key"
    key.touch(mode=0o600)
    key.write_text("too short")
    with pytest.raises(InputError, match=r"mavlink\.key: got 9 bytes; allowed: 32 bytes, or 64 hexadecimal"):
        made(credentials=tmp_path)
    for content in (bytes(range(32)), bytes(range(32)).hex().encode() + b"\n"):
        key.write_bytes(content)
        assert made(credentials=tmp_path)._signing_key == bytes(range(32))


def test_the_command_makes_a_key_that_is_read_and_never_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    assert exit_code(["keys", "mavlink", str(folder)]) == 0
    content = (folder / "mavlink.key").read_bytes()
    assert (folder / "mavlink.key").stat().st_mode & 0o077 == 0
    assert made(credentials=folder)._signing_key == bytes.fromhex(content.decode())
    assert exit_code(["keys", "mavlink", str(folder)]) == 2
    assert (folder / "mavlink.key").read_bytes() == content


def test_an_unsigned_port_that_others_reach_must_be_asked_for(tmp_path: Path) -> None:
    far = "udpout:192.168.1.9:14550"
    with pytest.raises(InputError, match=r"anybody on the network could move the servos"):
        made(connect=far)
    assert made(connect=far, insecure=True)._port_text == far
    (tmp_path / "mavlink.key").touch(mode=0o600)
    (tmp_path / "mavlink.key").write_bytes(bytes(32))
    assert made(connect=far, credentials=tmp_path)._port_text == far
