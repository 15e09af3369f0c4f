"""The servo board: peers, commands, silence, channels, and what ground stations ask it for."""

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mock import MockServos
from hexctl.errors import CommandRefusedError
from hexctl.robot.servos.servo_map import default_servo_map
from hexctl.simulators.board_messages import PARAMETER, answers
from hexctl.simulators.servo_board import (
    FORGET_AFTER_S,
    FREE_AFTER_S,
    MOST_PEERS,
    PROVE_S,
    Channels,
    OverrideStream,
    Peers,
    ServoBoard,
)
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import MemoryBoard, MemoryPort, fitting_map, memory_board
from tests.backends.mavlink.clients import Client
from tests.firmware.boards import BOARDS, Firmware, FirmwareBoard, firmware_board
from tests.robots import shipped


class BoardClient(Client):
    """A client of a board in memory.

    Attributes:
        board: the board.
        stance: pulses of the robot's stance.
    """

    def __init__(self, board: MemoryBoard | FirmwareBoard, name: str = "controller", **about: Any) -> None:
        super().__init__(board.port.peer(name), **about)
        self.board = board
        self.stance: FloatArray = board.servo_map.to_us(shipped().stance_angles_rad)

    def override(self, pulses: FloatArray, sequence: int | None = None) -> None:
        """Send an override once."""
        self.say(mavlink_messages.override(pulses, 1, 1), sequence=sequence)

    def fall_silent(self) -> None:
        """Say nothing until the board notices."""
        self.until(lambda: self.state() == mavlink_messages.CRITICAL)

    def shows(self, pulses: FloatArray) -> bool:
        """Whether the board drives these pulses."""
        return bool(np.allclose(self.outputs().pulses_us, pulses, atol=2.0))

    def released(self) -> bool:
        """Whether no channel is driven."""
        return not self.outputs().active.any()


@pytest.fixture(params=BOARDS)
def client(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[BoardClient]:
    with request.param(fitting_map(tmp_path), release_after_s=1.5) as board:
        client = BoardClient(board)
        client.hail()
        yield client


def test_who_comes_is_told_at_once_who_is_there(client: BoardClient) -> None:
    client.until(lambda: any(frame.kind == "NAMED_VALUE_INT" for frame in client.heard))
    kinds = [frame.kind for frame in client.heard]
    assert kinds[:2] == ["HEARTBEAT", "NAMED_VALUE_INT"]
    beat = client.newest("HEARTBEAT")
    assert (beat.type, beat.system_status) == (common.MAV_TYPE_GENERIC, mavlink_messages.STANDBY)
    named = [frame.message for frame in client.heard if frame.kind == "NAMED_VALUE_INT"]
    assert (mavlink_messages.name_of(named[0]), named[0].value) == ("measured", 0)


def test_an_override_moves_and_silence_holds(client: BoardClient) -> None:
    moved = client.stance + 30
    client.drive(moved, times=60)
    states = {frame.message.system_status for frame in client.heard if frame.kind == "HEARTBEAT"}
    assert mavlink_messages.ACTIVE in states
    client.fall_silent()
    assert client.shows(moved)
    assert client.outputs().active.all()
    client.drive(client.stance, times=40)
    client.until(lambda: client.shows(client.stance))
    report = client.board.end()
    assert report["expired"] >= 1
    assert (report["overrides"] + report["not_yet"], report["refused"], report["released"]) == (100, 0, 0)
    assert report["not_yet"] >= 2


def test_overrides_that_come_late_all_together_move_nothing(client: BoardClient) -> None:
    """What a controller sent before it noticed that its link had begun to delay everything."""
    client.drive(client.stance, times=20)
    client.fall_silent()
    for _ in range(10):
        client.override(client.stance + 30)
    client.listen(0.1)
    assert client.shows(client.stance)
    assert client.board.end()["not_yet"] == 10


def test_a_release_counts_at_once_after_a_silence(client: BoardClient) -> None:
    client.drive(client.stance)
    client.fall_silent()
    client.say(mavlink_messages.release(1, 1))
    client.until(client.released)
    assert client.board.end()["not_yet"] == 0


def test_a_controller_that_shows_that_it_is_there_moves_at_once_after_a_silence(client: BoardClient) -> None:
    client.drive(client.stance)
    client.fall_silent()
    newest_ms = client.outputs().board_ms
    client.say(mavlink_messages.controller_heartbeat(board_ms=newest_ms - 5000))
    client.override(client.stance + 20)
    client.listen(0.1)
    assert client.shows(client.stance)
    client.say(mavlink_messages.controller_heartbeat(board_ms=client.outputs().board_ms))
    client.override(client.stance + 20)
    client.until(lambda: not client.shows(client.stance))
    assert client.board.end()["not_yet"] == 1


def test_what_a_controller_sent_long_ago_moves_nothing_although_it_was_forgotten(client: BoardClient) -> None:
    client.drive(client.stance)
    client.listen(FORGET_AFTER_S + 0.2)
    for _ in range(5):
        client.override(client.stance + 30)
    client.listen(0.1)
    assert not client.shows(client.stance + 30)
    assert client.board.end()["not_yet"] == 5


def test_a_stream_is_steady_once_it_has_come_for_long_enough_without_a_silence() -> None:
    stream = OverrideStream()
    steady = []
    for at_s in (0.0, 0.15, 0.29, 0.31, 0.52, 0.7, 0.85):  # 0.21 s of silence before 0.52
        stream.note(at_s)
        steady.append(stream.steady)
    assert steady == [False, False, False, True, False, False, True]


def test_without_a_controller_the_servos_are_let_go(client: BoardClient) -> None:
    client.drive(client.stance)
    with BoardClient(client.board, "watcher", system=254) as watcher:
        watcher.hail()
        watcher.until(lambda: not watcher.released(), hailing=True)
        watcher.until(watcher.released, hailing=True)
    assert client.board.end()["released"] == 1


def test_heartbeats_of_who_commanded_keep_the_pose_held(client: BoardClient) -> None:
    client.drive(client.stance)
    for _ in range(25):
        client.hail()
        client.listen(0.1)
    assert client.outputs().active.all()
    assert client.board.end()["released"] == 0


def test_letting_go_on_command_and_driving_again(client: BoardClient) -> None:
    client.drive(client.stance)
    client.say(mavlink_messages.release(1, 1))
    client.until(client.released)
    client.drive(client.stance + 20, times=10)
    client.until(lambda: client.shows(client.stance + 20))
    assert client.board.end()["released"] == 1


def test_messages_for_other_systems_are_ignored_and_target_0_is_a_broadcast(client: BoardClient) -> None:
    for to in ((2, 1), (1, 2)):
        client.drive(client.stance + 100, to=to)
        assert client.shows(client.stance)
        assert client.released()
    client.drive(client.stance + 20, to=(0, 0))
    client.until(lambda: client.shows(client.stance + 20))


def test_a_void_override_moves_nothing_and_is_counted(client: BoardClient) -> None:
    client.drive([*[1500] * 17, 99])
    assert client.shows(client.stance)
    report = client.board.end()
    assert (report["refused"], report["overrides"]) == (5, 0)


def test_losses_and_disorder_are_counted_and_old_overrides_not_obeyed(client: BoardClient) -> None:
    client.override(client.stance, sequence=10)
    client.override(client.stance, sequence=14)
    client.override(client.stance + 50, sequence=12)
    client.override(client.stance, sequence=14)
    client.override(client.stance, sequence=15)
    client.listen(0.1)
    assert client.shows(client.stance)
    report = client.board.end()
    # 1..9 after the heartbeat's 0, then 11 and 13.
    assert (report["lost"], report["out_of_order"], report["overrides"]) == (11, 2, 3)


def test_a_controller_that_vanished_is_replaced_after_a_while(client: BoardClient) -> None:
    client.drive(client.stance)
    with BoardClient(client.board, "second", system=254) as second:
        second.drive(client.stance + 20)
        second.until(lambda: any(frame.kind == "STATUSTEXT" for frame in second.heard))
        assert mavlink_messages.name_of(second.newest("STATUSTEXT")) == "another controller holds the servos"
        assert second.shows(client.stance)

        def obeyed() -> bool:
            second.drive(client.stance + 20)
            return second.shows(client.stance + 20)

        second.until(obeyed)


def test_who_says_goodbye_makes_room_at_once(client: BoardClient) -> None:
    client.drive(client.stance)
    client.hail(mavlink_messages.POWEROFF)
    with BoardClient(client.board, "second", system=254) as second:
        second.drive(client.stance + 20)
        second.until(lambda: second.shows(client.stance + 20))
    assert client.board.end()["of_others"] == 0


@pytest.mark.parametrize("run", BOARDS)
def test_a_board_with_a_key_obeys_signed_frames_only(run: Any, tmp_path: Path) -> None:
    key = bytes(range(32))
    with run(fitting_map(tmp_path), signing_key=key) as board:
        unsigned = BoardClient(board, "unsigned")
        unsigned.drive(unsigned.stance + 50)
        assert unsigned.heard == []
        signed = BoardClient(board, key=key)
        signed.drive(signed.stance + 20)
        signed.until(lambda: signed.shows(signed.stance + 20))
        report = board.end()
    # On a stream, they are one run of bytes.
    assert (report["malformed"], report["of_others"]) == (1 if run is firmware_board else 5, 0)


def test_in_a_flood_of_senders_who_commands_or_receives_keeps_its_place_and_others_wait() -> None:
    peers = Peers()
    peers.commander, _ = peers.hear("commander", 255, 191, 0.0)
    present, new = peers.hear("present", 255, 191, 0.0)
    assert present is not None
    assert new
    present.present_at_s = 0.0
    for number in range(10 * MOST_PEERS):
        peers.hear(f"flood {number}", 9, 9, 0.001 * number)
    assert peers.addresses() == ["commander", "present", *(f"flood {each}" for each in range(MOST_PEERS - 2))]
    assert peers.hear("late", 255, 191, 0.9 * PROVE_S) == (None, False)
    late, new = peers.hear("late", 255, 191, 1.1 * PROVE_S)
    assert late is not None
    assert new
    assert peers.hear("commander", 255, 191, 2.4) == (peers.commander, False)
    assert peers.hear("present", 255, 191, 2.4) == (present, False)
    assert not peers.may_command(late, 2.4)
    for number in range(MOST_PEERS):
        peers.hear(f"flood {number}", 9, 9, FREE_AFTER_S + 0.1)
    assert peers.addresses()[0] == "commander"
    assert "present" not in peers.addresses()
    assert peers.may_command(late, 2.4 + FREE_AFTER_S + 0.1)


def test_a_board_that_returns_from_a_standstill_executes_nothing_that_waited(tmp_path: Path) -> None:
    port = MemoryPort(FakeTime())
    board = ServoBoard(MockServos(shipped(), clock=port.time.clock()), fitting_map(tmp_path), port)
    controller = Client(port.peer())
    stance = fitting_map(tmp_path).to_us(shipped().stance_angles_rad)
    with board._guard as guard:
        guard.clock.tick()
        controller.say(mavlink_messages.override(stance, 1, 1))
        board._serve(0.0)
        board._tick()
        before_rad = guard.accepted_rad().copy()
        for _ in range(10):
            controller.say(mavlink_messages.override(stance + 30, 1, 1))
        port.time.work(1.0)
        board._serve(0.0)
        assert (guard.accepted_rad() == before_rad).all()
        assert (board.counts["not_yet"], board.counts["expired"]) == (10, 1)


# Channels: what overrides drive, leave, release and refuse.

ALL, FIRST = [1600] * 18, list(range(1500, 1518))
RELEASE, IGNORE = [0] * 8 + [65534] * 10, [65535] * 18
ONE_EACH = [0, *[65535] * 16, 65534]


def channels(*overrides: list[int]) -> Channels:
    made = Channels(default_servo_map())
    for override in overrides:
        made.take(override)
    return made


@pytest.mark.parametrize(
    ("overrides", "pulses", "active"),
    [
        ((), None, [False] * 18),
        ((FIRST,), FIRST, [True] * 18),
        ((ALL, RELEASE), ALL, [False] * 18),
        ((ALL, IGNORE), ALL, [True] * 18),
        ((IGNORE,), None, [False] * 18),
        # MAVLink cuts trailing zeros off, and what was cut off was not meant.
        ((ALL, [1700] * 8 + [0] * 10), [1700] * 8 + [1600] * 10, [True] * 18),
        ((ALL, ONE_EACH), ALL, [False, *[True] * 16, False]),
        (([100, 5000, *[1500] * 16],), [500, 2500, *[1500] * 16], [True] * 18),
    ],
)
def test_overrides_drive_leave_and_release_channels(
    overrides: tuple[list[int], ...], pulses: list[int] | None, active: list[bool]
) -> None:
    made = channels(*overrides)
    assert made.active.tolist() == active
    if pulses is not None:
        assert made.pulses_us.tolist() == pulses
    assert made.clipped == (overrides[:1] == ([100, 5000, *[1500] * 16],))


def test_a_pulse_that_no_servo_has_makes_the_whole_override_void() -> None:
    made = channels(ALL)
    for channel, pulse in ((0, 1), (7, 99), (8, 5001), (17, 60_000), (17, 65533), (0, 65534), (7, 65534)):
        wild = [1700] * 18
        wild[channel] = pulse
        with pytest.raises(CommandRefusedError):
            made.take(wild)
        assert made.pulses_us.tolist() == ALL


def test_only_an_override_that_leaves_no_channel_driven_is_a_release() -> None:
    assert channels(ALL).released_by(RELEASE)
    assert channels().released_by(IGNORE)
    assert not channels(ALL).released_by(IGNORE)
    assert not channels(ALL).released_by([0, *[65535] * 17])
    assert not channels().released_by(ALL)


#: What QGroundControl and mavsdk ask a new system for, and the answer that ends their waiting.
REQUESTS = {
    "PARAM_REQUEST_LIST": (common.MAVLink_param_request_list_message(1, 1), "PARAM_VALUE"),
    "PARAM_REQUEST_READ": (common.MAVLink_param_request_read_message(1, 1, PARAMETER, -1), "PARAM_VALUE"),
    "by index": (common.MAVLink_param_request_read_message(1, 1, b"", 0), "PARAM_VALUE"),
    "no index": (common.MAVLink_param_request_read_message(1, 1, b"", 7), "PARAM_ERROR"),
    "no name": (common.MAVLink_param_request_read_message(1, 1, b"SYS_AUTOSTART", -1), "PARAM_ERROR"),
    "no text": (common.MAVLink_param_request_read_message(1, 1, b"\xff\xfe", -1), "PARAM_ERROR"),
    "PARAM_SET": (common.MAVLink_param_set_message(1, 1, PARAMETER, 99.0, 9), "PARAM_VALUE"),
    "set none": (common.MAVLink_param_set_message(1, 1, b"SYS_AUTOSTART", 1.0, 9), "PARAM_ERROR"),
    "MISSION_REQUEST_LIST": (common.MAVLink_mission_request_list_message(1, 1, 1), "MISSION_COUNT"),
    "MISSION_COUNT": (common.MAVLink_mission_count_message(1, 1, 5, 0), "MISSION_ACK"),
    "MISSION_REQUEST_INT": (common.MAVLink_mission_request_int_message(1, 1, 0, 0), "MISSION_ACK"),
    "MISSION_REQUEST": (common.MAVLink_mission_request_message(1, 1, 0, 0), "MISSION_ACK"),
    "MISSION_CLEAR_ALL": (common.MAVLink_mission_clear_all_message(1, 1, 0), "MISSION_ACK"),
    "COMMAND_LONG": (common.MAVLink_command_long_message(1, 1, 400, 0, *[1.0] * 7), "COMMAND_ACK"),
    "COMMAND_INT": (
        common.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, *[1.0] * 4, 1, 1, 1.0),
        "COMMAND_ACK",
    ),
    "FILE_TRANSFER_PROTOCOL": (
        common.MAVLink_file_transfer_protocol_message(
            0, 1, 1, bytes([0xFF, 0xFF, 5, 3, 1, *[0] * 7, ord("/")]).ljust(251, b"\0")
        ),
        "FILE_TRANSFER_PROTOCOL",
    ),
}


#: What answers say: the parameter never changes, and there are no missions and no files.
SAID: dict[str, dict[str, Any]] = {
    "PARAM_VALUE": {"param_id": "CHANNELS", "param_value": 18.0, "param_count": 1},
    "PARAM_ERROR": {"error": common.MAV_PARAM_ERROR_DOES_NOT_EXIST},
    "MISSION_COUNT": {"count": 0, "mission_type": 1},
    "MISSION_ACK": {"type": common.MAV_MISSION_UNSUPPORTED},
    "FILE_TRANSFER_PROTOCOL": {"payload": [0, 0, 5, 129, 1, 3, *[0] * 6, 7, *[0] * 238]},
}


Answered = Callable[[Any], list[Any]]


@pytest.fixture(params=BOARDS)
def answered(request: pytest.FixtureRequest) -> Answered:
    """Function that returns answers to a request of system 255, component 190, each as it arrives there."""
    return _answered if request.param is memory_board else _answered_by_firmware


def _answered(request: Any) -> list[Any]:
    station, board = Codec(255, 190), Codec(1, 1)
    (asked,) = board.decode(station.encode(request, 0), whole=True)
    sent = answers(asked.kind, asked.message, asked.system, asked.component)
    return [station.decode(board.encode(message, 0), whole=True)[0].message for message in sent]


def _answered_by_firmware(request: Any) -> list[Any]:
    station, board = Codec(255, 190), Firmware([1500] * 18)
    board.begin(0.0)
    board.run(0.021, station.encode(mavlink_messages.controller_heartbeat(), 0))
    sent = board.run(0.022, station.encode(request, 1))
    return [station.decode(frame, whole=True)[0].message for frame in sent]


@pytest.mark.parametrize("name", REQUESTS)
def test_every_request_has_one_answer_for_who_asked_and_none_for_another_system(
    name: str, answered: Answered
) -> None:
    request, kind = copy.copy(REQUESTS[name][0]), REQUESTS[name][1]
    (answer,) = answered(request)
    assert answer.get_type() == kind
    assert answer.to_dict().items() >= SAID.get(kind, {}).items()
    if kind != "PARAM_VALUE":
        assert (answer.target_system, answer.target_component) == (255, 190)
    request.target_system = 2
    assert answered(request) == []


@pytest.mark.parametrize("long", [True, False])
def test_the_version_is_told_and_every_other_command_refused(long: bool, answered: Answered) -> None:
    def ask(command: int, parameter: float) -> list[Any]:
        if long:
            return answered(common.MAVLink_command_long_message(1, 1, command, 0, parameter, *[0.0] * 6))
        rest = [parameter, 0.0, 0.0, 0.0, 0, 0, 0.0]
        return answered(common.MAVLink_command_int_message(1, 1, 0, command, 0, 0, *rest))

    for command, parameter in ((520, 1.0), (512, 148.0)):
        told, version = ask(command, parameter)
        assert told.result == common.MAV_RESULT_ACCEPTED
        assert version.get_type() == "AUTOPILOT_VERSION"
    for command, parameter in ((512, 30.0), (400, 1.0), (512, float("nan"))):
        assert ask(command, parameter)[0].result == common.MAV_RESULT_UNSUPPORTED


def test_other_messages_have_no_answer(answered: Answered) -> None:
    files = common.MAVLink_file_transfer_protocol_message(0, 1, 1, bytes([1, 0, 5, 129]).ljust(251, b"\0"))
    for message in (
        files,  # itself an answer
        common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        common.MAVLink_ping_message(1, 2, 1, 1),
    ):
        assert answered(message) == []
