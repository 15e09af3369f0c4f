"""Frames as bytes: exact to the byte, found among garbage, signed; nothing that comes breaks the codec."""

import random
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import codec as codec_module
from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.errors import InputError

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


def hand_made_override(sequence: int) -> bytes:
    """The frame of the example in docs/reference/mavlink.md, put together without pymavlink."""
    first, last = list(range(1500, 1508)), list(range(1508, 1518))
    payload = struct.pack("<8HBB10H", *first, 1, 1, *last)
    header = struct.pack("<BBBBBB", len(payload), 0, 0, sequence, 255, 191) + OVERRIDE_ID.to_bytes(
        3, "little"
    )
    checksum = crc_mcrf4xx(header + payload + bytes([OVERRIDE_CRC_EXTRA]))
    return b"\xfd" + header + payload + struct.pack("<H", checksum)


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
    header = struct.pack("<BBBBBB", len(payload), 0, 0, draw.randrange(256), 9, 9) + kind.to_bytes(
        3, "little"
    )
    checksum = crc_mcrf4xx(header + payload + bytes([common.mavlink_map[kind].crc_extra]))
    return b"\xfd" + header + payload + struct.pack("<H", checksum)


def test_mavlink_1_is_not_understood() -> None:
    frame = mavlink_messages.override(PULSES, 1, 1).pack(common.MAVLink(None, 255, 191), force_mavlink1=True)
    codec = Codec(1, 1)
    assert codec.decode(frame, whole=True) == []
    assert codec.malformed == 1


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

    def test_a_key_of_another_length_is_refused(self) -> None:
        with pytest.raises(InputError, match="got 5 bytes; allowed: 32"):
            Codec(1, 1, signing_key=b"short")
