"""Frames as bytes, exact to the byte and signed, ports, sequence numbers, and frames of reference."""

import random
import re
import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import codec as codec_module
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.backends.mavlink.mavlink_messages import euler_of_quaternion, flipped_quaternion
from hexctl.backends.mavlink.mavlink_transport import (
    FORGET_AFTER_S,
    MOST_ADDRESSES,
    MavlinkLink,
    SequenceCount,
    open_port,
    parse_port,
)
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.rotations import quaternion_of_euler
from tests.backends.fake_time import FakeTime
from tests.backends.mavlink.boards import MemoryPort

FIRMWARE = Path(__file__).resolve().parents[3] / "docs" / "reference" / "mavlink.md"
KEY = bytes(range(32))
PULSES = np.arange(1500.0, 1518.0)

#: CRC_EXTRA of RC_CHANNELS_OVERRIDE, read in MAVLink's common.xml rather than asked of pymavlink.
OVERRIDE_ID, OVERRIDE_CRC_EXTRA = 70, 124


def crc_mcrf4xx(data: bytes) -> int:
    """The checksum of MAVLink, written from its description: CRC-16/MCRF4XX, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def hand_made(kind: int, crc_extra: int, payload: bytes, *sent_by: int) -> bytes:
    """A frame put together without pymavlink; it is sent with a sequence number by a system's component."""
    header = struct.pack("<BBBBBB", len(payload), 0, 0, *sent_by) + kind.to_bytes(3, "little")
    checksum = crc_mcrf4xx(header + payload + bytes([crc_extra]))
    return b"\xfd" + header + payload + struct.pack("<H", checksum)


def hand_made_override(sequence: int) -> bytes:
    """The frame of the example in docs/reference/mavlink.md."""
    payload = struct.pack("<8HBB10H", *range(1500, 1508), 1, 1, *range(1508, 1518))
    return hand_made(OVERRIDE_ID, OVERRIDE_CRC_EXTRA, payload, sequence, 255, 191)


def override_frame(sequence: int = 7, key: bytes | None = None) -> bytes:
    return Codec(255, 191, signing_key=key).encode(mavlink_messages.override(PULSES, 1, 1), sequence)


def test_the_override_of_the_docs_is_exact_to_the_byte() -> None:
    (block,) = re.findall(r"```hex\n(.*?)```", FIRMWARE.read_text(encoding="utf-8"), flags=re.DOTALL)
    written = bytes.fromhex(re.sub(r"\s", "", block))
    assert written == hand_made_override(7) == override_frame(7)
    assert len(written) == 50


def garbage() -> st.SearchStrategy[bytes]:
    """Bytes that may look like the beginning of a frame but are too few to swallow two."""
    return st.binary(max_size=40) | st.just(b"\xfd\x26\x00\x00") | st.just(b"\xfd" * 5)


@given(st.lists(garbage(), min_size=1, max_size=5), st.integers(1, 60))
def test_good_frames_are_found_among_garbage_however_the_bytes_are_cut(
    between: list[bytes], cut: int
) -> None:
    data = b"".join(noise + override_frame(number) for number, noise in enumerate(between))
    # What a false beginning waits for is more than one frame long at most.
    data += bytes(300)
    codec = Codec(1, 1)
    frames: list[Frame] = []
    for start in range(0, len(data), cut):
        frames += codec.decode(data[start : start + cut], whole=False)
    assert [frame.sequence for frame in frames] == list(range(len(between)))
    assert codec.malformed >= sum(bool(noise) for noise in between)


def test_thousands_of_hostile_datagrams_neither_break_it_nor_make_an_override() -> None:
    draw = random.Random(7)
    good, codec = override_frame(), Codec(1, 1)
    kinds = sorted(common.mavlink_map)
    for number in range(4_000):
        if number % 4 == 0:
            data = draw.randbytes(draw.randrange(300))
        elif number % 4 == 1:
            data = good[: draw.randrange(50)] + draw.randbytes(draw.randrange(20))
        elif number % 4 == 2:
            changed = bytearray(good)
            changed[draw.randrange(50)] ^= 1 << draw.randrange(8)
            data = bytes(changed)
        else:
            data = valid_frame(draw, draw.choice(kinds))
        for frame in codec.decode(data, whole=True):
            assert frame.kind != "RC_CHANNELS_OVERRIDE"
    assert codec.malformed > 2_800


def valid_frame(draw: random.Random, kind: int) -> bytes:
    """A frame of a kind with a right checksum and a payload of random length and content; no override."""
    kind = 0 if kind == OVERRIDE_ID else kind
    payload = draw.randbytes(draw.randrange(1, 256))
    crc_extra = common.mavlink_map[kind].crc_extra
    return hand_made(kind, crc_extra, payload, draw.randrange(256), 9, 9)


def frame_of_mavlink_1(message: Any) -> bytes:
    frame: bytes = message.pack(common.MAVLink(None, 1, 1), force_mavlink1=True)
    return frame


def test_mavlink_1_is_not_understood_and_its_heartbeats_are_counted() -> None:
    codec, heartbeat = Codec(1, 1), mavlink_messages.controller_heartbeat()
    assert codec.decode(frame_of_mavlink_1(mavlink_messages.override(PULSES, 1, 1)), whole=True) == []
    assert (codec.malformed, codec.of_mavlink_1) == (1, 0)
    assert codec.decode(b"noise" + 3 * frame_of_mavlink_1(heartbeat) + override_frame(), whole=False)
    assert codec.of_mavlink_1 == 3


class TestSigning:
    def test_a_signed_frame_is_taken_once_and_an_unsigned_one_never(self) -> None:
        codec, frame = Codec(1, 1, signing_key=KEY), override_frame(key=KEY)
        assert len(frame) == 63
        assert len(codec.decode(frame, whole=True)) == 1
        assert codec.decode(frame, whole=True) == []
        assert codec.decode(override_frame(), whole=True) == []
        assert codec.malformed == 2

    def test_another_key_is_refused_and_locks_no_owner_out(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """pymavlink as it comes takes over the time of a forged frame: the owner is then out."""
        codec, owner = Codec(1, 1, signing_key=KEY), Codec(255, 191, signing_key=KEY)
        message = mavlink_messages.override(PULSES, 1, 1)
        assert codec.decode(owner.encode(message, 0), whole=True)
        with monkeypatch.context() as patch:
            now = codec_module._stamp_now()
            patch.setattr(codec_module, "_stamp_now", lambda: now + 10**10)
            forged = Codec(255, 191, signing_key=bytes(32)).encode(message, 1)
        assert codec.decode(forged, whole=True) == []
        assert codec.decode(owner.encode(message, 2), whole=True)

    def test_a_recording_older_than_a_minute_is_refused_by_a_restarted_receiver(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        recorded = override_frame(key=KEY)
        now = codec_module._stamp_now()
        later = now + (codec_module.NEW_STREAM_SLACK_S + 1) * codec_module.STAMPS_PER_S
        monkeypatch.setattr(codec_module, "_stamp_now", lambda: later)
        assert Codec(1, 1, signing_key=KEY).decode(recorded, whole=True) == []

    def test_a_clock_that_is_put_back_locks_out_nobody_whose_last_stamp_is_kept(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        now, file, message = codec_module._stamp_now(), tmp_path / "new" / "stamp", PULSES

        def frame(hours: float, stamp_file: Path | None) -> bytes:
            stamp = now + int(3600 * hours * codec_module.STAMPS_PER_S)
            monkeypatch.setattr(codec_module, "_stamp_now", lambda: stamp)
            controller = Codec(255, 191, signing_key=KEY, stamp_file=stamp_file)
            sent = controller.encode(mavlink_messages.override(message, 1, 1), 0)
            controller.keep_stamp()
            return sent

        board = Codec(1, 1, signing_key=KEY)
        assert board.decode(frame(1, file), whole=True)
        assert not board.decode(frame(0, None), whole=True)
        assert board.decode(frame(0, file), whole=True)
        assert board.decode(frame(2, file), whole=True)
        for damaged in ("", "noise", "9" * 30):
            file.write_text(damaged)
            assert board.decode(frame(3 + len(damaged), file), whole=True)

    def test_a_key_of_another_length_is_refused(self) -> None:
        with pytest.raises(InputError, match="got 5 bytes; allowed: 32"):
            Codec(1, 1, signing_key=b"short")


# Ports and links.


@pytest.mark.parametrize(
    ("text", "kind", "place", "number", "local"),
    [
        ("udpout:127.0.0.1:14550", "udpout", "127.0.0.1", 14550, True),
        ("udpin:192.168.1.2:14550", "udpin", "192.168.1.2", 14550, False),
        ("udpin:localhost:1", "udpin", "localhost", 1, True),
        ("udpout:robot.local:65535", "udpout", "robot.local", 65535, False),
        ("udpout:[::1]:14550", "udpout", "::1", 14550, True),
        ("/dev/ttyACM0", "serial", "/dev/ttyACM0", 115200, True),
        ("/dev/ttyACM0:57600", "serial", "/dev/ttyACM0", 57600, True),
        ("serial:/dev/pts/3", "serial", "/dev/pts/3", 115200, True),
        ("/dev/by-path/pci-0:2:1.0-port0", "serial", "/dev/by-path/pci-0:2:1.0-port0", 115200, True),
        ("/dev/serial/by-path/pci-0:2:1.0:9600", "serial", "/dev/serial/by-path/pci-0:2:1.0", 9600, True),
    ],
)
def test_ports(text: str, kind: str, place: str, number: int, local: bool) -> None:
    address = parse_port(text)
    assert (address.kind, address.place, address.number, address.local) == (kind, place, number, local)


@pytest.mark.parametrize(
    "text",
    [
        *("", "udp", "udpin:14550", "udpin:host:0", "udpin:host:65536", "tcp:1.2.3.4:5", "ttyACM0", "COM3"),
        *("/dev/ttyACM0:fast", "/dev/ttyACM0:1199", "/dev/tty\nX", "udpout:a b:1", "udpout:127.0.0.1:14550x"),
    ],
)
def test_a_text_that_is_no_port_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="port: "):
        parse_port(text)


@pytest.mark.parametrize(
    ("numbers", "lost", "out_of_order", "dropped"),
    [
        ([3, 4, 8, 9], 3, 0, []),
        ([1, 2, 4, 3, 5], 0, 1, [3]),  # late: not used, and not lost
        ([1, 2, 2, 3], 0, 1, [2]),  # twice: used once
    ],
)
def test_frames_that_are_lost_late_or_repeated_are_counted(
    numbers: list[int], lost: int, out_of_order: int, dropped: list[int]
) -> None:
    count = SequenceCount()
    accepted = [count.in_order(number, 0.001 * index) for index, number in enumerate(numbers)]
    assert (count.lost, count.out_of_order) == (lost, out_of_order)
    assert [place for place, taken in enumerate(accepted) if not taken] == dropped


def test_a_sender_that_restarts_after_a_silence_is_received_immediately() -> None:
    count = SequenceCount()
    count.in_order(200, 0.0)
    assert count.in_order(0, 1 + FORGET_AFTER_S)
    assert count.lost == 0


def test_a_flood_of_addresses_does_not_renumber_an_active_peer() -> None:
    port = MemoryPort(FakeTime())
    controller, first = port.peer("controller"), port.peer("0")
    link, heartbeat = MavlinkLink(port, Codec(1, 1)), mavlink_messages.controller_heartbeat()
    for flooder in range(3 * MOST_ADDRESSES):
        link.send(heartbeat, "controller")
        link.send(heartbeat, str(flooder))
    numbers = [frame[4] for frame, _ in controller.receive(0.0)]
    assert numbers == [number % 256 for number in range(3 * MOST_ADDRESSES)]
    link.send(heartbeat, "0")
    assert [frame[4] for frame, _ in first.receive(0.0)] == [0, 0], "forgotten long ago"


def test_ports_that_cannot_be_opened_are_faults() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as used:
        used.bind(("127.0.0.1", 0))
        for text in (f"udpin:127.0.0.1:{used.getsockname()[1]}", "/dev/no-such-port"):
            with pytest.raises(RobotFaultError, match=text):
                open_port(parse_port(text), text=text)


#: Axes of NED or FRD written in ours: x stays, y and z turn over.
AXES = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)


@given(roll=angles, pitch=pitches, yaw=angles)
def test_an_orientation_is_the_same_rotation_in_other_axes(roll: float, pitch: float, yaw: float) -> None:
    from scipy.spatial.transform import Rotation

    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    quaternion = flipped_quaternion(quaternion_of_euler(roll, pitch, yaw))
    ours = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    np.testing.assert_allclose(ours, AXES @ ned @ AXES.T, atol=1e-9)
    back = euler_of_quaternion(quaternion_of_euler(roll, pitch, yaw))
    np.testing.assert_allclose(back, (roll, pitch, yaw), atol=1e-6)
