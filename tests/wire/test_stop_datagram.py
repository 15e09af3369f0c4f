"""Datagrams of a stop: what was signed comes back as it was, and nothing else is taken."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import MessageError
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, Kind, StopDatagram, mark_of

SECRET = bytes(range(32))

ANSWER = StopDatagram(
    kind=Kind.STATE,
    nonce=b"nonce   ",
    epoch=b"epoch           ",
    request=b"request ",
    stop_id=bytes.fromhex("0011223344556677"),
    reason="fault: low battery 9.5 V",
    robot="ant",
    stopped=True,
    at_rest=True,
    on_disk=True,
)


@given(
    kind=st.sampled_from(Kind),
    nonce=st.binary(min_size=8, max_size=8),
    epoch=st.binary(min_size=16, max_size=16),
    flags=st.tuples(st.booleans(), st.booleans(), st.booleans(), st.booleans()),
    reason=st.text("a ä€🙂", max_size=13),
    secret=st.sampled_from([b"", SECRET]),
)
def test_what_is_signed_comes_back_as_it_was(kind: Kind, flags: Any, secret: bytes, **values: Any) -> None:
    stopped, at_rest, on_disk, echoed = flags
    told = {"stopped": stopped, "at_rest": at_rest, "on_disk": on_disk, "echoed": echoed}
    sent = StopDatagram(kind=kind, **told, **values)
    data = sent.packed(secret)
    assert len(data) == DATAGRAM_BYTES == 160
    assert StopDatagram.unpacked(data, secret) == sent


def test_long_texts_are_cut_at_a_character() -> None:
    long = StopDatagram(kind=Kind.STATE, nonce=bytes(8), reason="\u00e4" * 60, robot="x" * 99)
    back = StopDatagram.unpacked(long.packed(SECRET), SECRET)
    assert back.reason == "\u00e4" * 25 + "\u2026"
    assert back.robot == "x" * 24


def test_half_a_character_in_what_a_driver_says_is_no_reason_not_to_answer() -> None:
    sent = StopDatagram(kind=Kind.STATE, nonce=bytes(8), reason="fault: \ud800")
    assert StopDatagram.unpacked(sent.packed(SECRET), SECRET).reason == "fault: ?"


def test_no_byte_can_be_changed() -> None:
    for place in range(DATAGRAM_BYTES):
        data = bytearray(ANSWER.packed(SECRET))
        data[place] ^= 1 + place % 255
        with pytest.raises(MessageError):
            StopDatagram.unpacked(bytes(data), SECRET)


def test_another_secret_is_refused_and_does_not_even_have_the_mark() -> None:
    assert mark_of(b"") != mark_of(SECRET)
    for secret in (b"", bytes(32), SECRET[:-1]):
        with pytest.raises(MessageError):
            StopDatagram.unpacked(ANSWER.packed(secret), SECRET)


def test_the_layout_is_that_of_the_documentation() -> None:
    """The example of docs/reference/zenoh.md."""
    data = ANSWER.packed(SECRET)
    assert data[:8] == mark_of(SECRET)
    assert data[8:10] == bytes([3, 7])
    assert data[10:26] == ANSWER.epoch
    assert data[26:34] == ANSWER.nonce
    assert data[34:42] == ANSWER.request
    assert data[42:50] == ANSWER.stop_id
    assert data[50:104].rstrip(b"\0").decode() == ANSWER.reason
    assert data[104:128].rstrip(b"\0").decode() == ANSWER.robot
