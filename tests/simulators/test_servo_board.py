"""The servo board: peers, commands, silence, channels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import mavlink_messages
from hexctl.errors import CommandRefusedError
from hexctl.robot.servos.servo_map import default_servo_map
from hexctl.simulators.servo_board import (
    FORGET_AFTER_S,
    FREE_AFTER_S,
    MOST_PEERS,
    Channels,
    OverrideStream,
    Peers,
)
from hexctl.types import FloatArray
from tests.backends.mavlink.boards import MemoryBoard, fitting_map, memory_board
from tests.backends.mavlink.clients import Client
from tests.robots import shipped

LOOSE_US = 2.0


@pytest.fixture
def running(tmp_path: Path) -> Iterator[MemoryBoard]:
    with memory_board(fitting_map(tmp_path), release_after_s=1.5) as made:
        yield made


@pytest.fixture
def client(running: MemoryBoard) -> Client:
    made = Client(running.port.peer())
    made.hail()
    return made


@pytest.fixture
def stance(running: MemoryBoard) -> FloatArray:
    return running.servo_map.to_us(shipped().stance_angles_rad)


def shows(client: Client, pulses: FloatArray) -> bool:
    return bool(np.allclose(client.outputs().pulses_us, pulses, atol=LOOSE_US))


def test_who_comes_is_told_at_once_who_is_there(client: Client) -> None:
    client.until(lambda: any(frame.kind == "NAMED_VALUE_INT" for frame in client.heard))
    kinds = [frame.kind for frame in client.heard]
    assert kinds[:2] == ["HEARTBEAT", "NAMED_VALUE_INT"]
    beat = client.newest("HEARTBEAT")
    assert (beat.type, beat.system_status) == (common.MAV_TYPE_GENERIC, mavlink_messages.STANDBY)
    assert mavlink_messages.name_of(client.newest("NAMED_VALUE_INT")) == "measured"
    assert client.newest("NAMED_VALUE_INT").value == 0


def test_an_override_moves_and_silence_holds(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    moved = stance + 30
    client.drive(moved, times=60)
    states = {frame.message.system_status for frame in client.heard if frame.kind == "HEARTBEAT"}
    assert mavlink_messages.ACTIVE in states
    client.until(lambda: client.state() == mavlink_messages.CRITICAL)
    assert shows(client, moved)
    assert client.outputs().active.all()
    client.drive(stance, times=40)
    client.until(lambda: shows(client, stance))
    report = running.end()
    assert report["expired"] >= 1
    assert (report["overrides"] + report["not_yet"], report["refused"], report["released"]) == (100, 0, 0)
    assert report["not_yet"] >= 2


def test_overrides_that_come_late_all_together_move_nothing(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    """What a controller sent before it noticed that its link had begun to delay everything."""
    client.drive(stance, times=20)
    client.until(lambda: client.state() == mavlink_messages.CRITICAL)
    for _ in range(10):
        client.say(mavlink_messages.override(stance + 30, 1, 1))
    client.listen(0.1)
    assert shows(client, stance)
    assert running.end()["not_yet"] == 10


def test_a_release_counts_at_once_after_a_silence(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    client.until(lambda: client.state() == mavlink_messages.CRITICAL)
    client.say(mavlink_messages.release(1, 1))
    client.until(lambda: released(client))
    assert running.end()["not_yet"] == 0


def test_a_controller_that_shows_that_it_is_there_moves_at_once_after_a_silence(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    client.until(lambda: client.state() == mavlink_messages.CRITICAL)
    newest_ms = client.outputs().board_ms
    client.say(mavlink_messages.controller_heartbeat(board_ms=newest_ms - 5000))
    client.say(mavlink_messages.override(stance + 20, 1, 1))
    client.listen(0.1)
    assert shows(client, stance)
    client.say(mavlink_messages.controller_heartbeat(board_ms=client.outputs().board_ms))
    client.say(mavlink_messages.override(stance + 20, 1, 1))
    client.until(lambda: not shows(client, stance))
    assert running.end()["not_yet"] == 1


def test_what_a_controller_sent_long_ago_moves_nothing_although_it_was_forgotten(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    client.listen(FORGET_AFTER_S + 0.2)
    for _ in range(5):
        client.say(mavlink_messages.override(stance + 30, 1, 1))
    client.listen(0.1)
    assert not shows(client, stance + 30)
    assert running.end()["not_yet"] == 5


def test_a_stream_is_steady_once_it_has_come_for_long_enough_without_a_silence() -> None:
    stream = OverrideStream()
    steady = []
    for at_s in (0.0, 0.15, 0.29, 0.31, 0.52, 0.7, 0.85):  # 0.21 s of silence before 0.52
        stream.note(at_s)
        steady.append(stream.steady)
    assert steady == [False, False, False, True, False, False, True]


def test_without_a_controller_the_servos_are_let_go(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    with Client(running.port.peer("watcher"), system=254) as watcher:
        watcher.hail()
        watcher.until(lambda: not released(watcher), hailing=True)
        watcher.until(lambda: released(watcher), hailing=True)
    assert running.end()["released"] == 1


def released(client: Client) -> bool:
    return not client.outputs().active.any()


def test_heartbeats_of_who_commanded_keep_the_pose_held(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    for _ in range(25):
        client.hail()
        client.listen(0.1)
    assert client.outputs().active.all()
    assert running.end()["released"] == 0


def test_letting_go_on_command_and_driving_again(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    client.say(mavlink_messages.release(1, 1))
    client.until(lambda: released(client))
    client.drive(stance + 20, times=10)
    client.until(lambda: shows(client, stance + 20))
    assert running.end()["released"] == 1


@pytest.mark.parametrize("to", [(2, 1), (1, 2)], ids=["system", "component"])
def test_what_is_for_others_moves_nothing(client: Client, stance: FloatArray, to: tuple[int, int]) -> None:
    client.drive(stance + 100, to=to)
    assert shows(client, stance)
    assert released(client)


def test_target_0_is_a_broadcast(client: Client, stance: FloatArray) -> None:
    client.drive(stance + 20, to=(0, 0))
    client.until(lambda: shows(client, stance + 20))


def test_a_void_override_moves_nothing_and_is_counted(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive([*[1500] * 17, 99])
    assert shows(client, stance)
    report = running.end()
    assert (report["refused"], report["overrides"]) == (5, 0)


def test_losses_and_disorder_are_counted_and_old_overrides_not_obeyed(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.say(mavlink_messages.override(stance, 1, 1), sequence=10)
    client.say(mavlink_messages.override(stance, 1, 1), sequence=14)
    client.say(mavlink_messages.override(stance + 50, 1, 1), sequence=12)
    client.say(mavlink_messages.override(stance, 1, 1), sequence=14)
    client.say(mavlink_messages.override(stance, 1, 1), sequence=15)
    client.listen(0.1)
    assert shows(client, stance)
    report = running.end()
    # 1..9 after the heartbeat's 0, then 11 and 13.
    assert (report["lost"], report["out_of_order"], report["overrides"]) == (11, 2, 3)


def test_a_controller_that_vanished_is_replaced_after_a_while(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    with Client(running.port.peer("second")) as second:
        second.drive(stance + 20)
        second.until(lambda: any(frame.kind == "STATUSTEXT" for frame in second.heard))
        assert mavlink_messages.name_of(second.newest("STATUSTEXT")) == "another controller holds the servos"
        assert shows(second, stance)
        second.until(lambda: driven(second, stance + 20))


def driven(client: Client, pulses: FloatArray) -> bool:
    client.drive(pulses)
    return shows(client, pulses)


def test_who_says_goodbye_makes_room_at_once(
    running: MemoryBoard, client: Client, stance: FloatArray
) -> None:
    client.drive(stance)
    client.hail(mavlink_messages.POWEROFF)
    with Client(running.port.peer("second")) as second:
        second.drive(stance + 20)
        second.until(lambda: shows(second, stance + 20))
    assert running.end()["of_others"] == 0


def test_a_board_with_a_key_obeys_signed_frames_only(tmp_path: Path, stance: FloatArray) -> None:
    key = bytes(range(32))
    with memory_board(fitting_map(tmp_path), signing_key=key) as running:
        unsigned = Client(running.port.peer("unsigned"))
        unsigned.drive(stance + 50)
        assert unsigned.heard == []
        signed = Client(running.port.peer(), key=key)
        signed.drive(stance + 20)
        signed.until(lambda: shows(signed, stance + 20))
        report = running.end()
    assert (report["malformed"], report["of_others"]) == (5, 0)


def test_a_flood_of_senders_does_not_keep_out_who_commands() -> None:
    peers = Peers()
    commander, new = peers.hear("commander", 255, 191, 0.0)
    assert new
    peers.commander = commander
    for number in range(10 * MOST_PEERS):
        peers.hear(f"flood {number}", 9, 9, 0.001 * number)
    assert len(peers.addresses()) == MOST_PEERS
    assert peers.hear("commander", 255, 191, 1.0) == (commander, False)
    late, _ = peers.hear("late", 255, 191, 1.0)
    assert not peers.may_command(late, 1.0)
    assert peers.may_command(late, 1.0 + FREE_AFTER_S + 0.1)


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


@pytest.mark.parametrize(
    ("channel", "pulse"), [(0, 1), (7, 99), (8, 5001), (17, 60_000), (17, 65533), (0, 65534), (7, 65534)]
)
def test_a_pulse_that_no_servo_has_makes_the_whole_override_void(channel: int, pulse: int) -> None:
    made = channels(ALL)
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
