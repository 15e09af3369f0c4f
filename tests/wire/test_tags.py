"""Attachments: their bytes, and that nothing else passes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import MessageError
from hexctl.wire.tags import CommandTag, StateTag

COMMAND = CommandTag(
    sequence=7, stamp_ns=1_500_000_000, time_to_live_ms=200, lease_id=bytes(range(16)), lease_sequence=3
)
#: The example of docs/protocol.md.
COMMAND_BYTES = bytes.fromhex(
    "48584363010700000000000000002f685900000000c8000000000102030405060708090a0b0c0d0e0f03000000"
)
STATE = StateTag(
    sequence=9,
    stamp_ns=2_000_000_000,
    age_us=1500,
    command_sequence=7,
    measured=True,
    healthy=False,
    contacts=0b101101,
    fault="low battery",
    stopped=None,
)
STATE_BYTES = bytes.fromhex(
    "485843730109000000000000000094357700000000dc0500000700000000000000052d0b6c6f77206261747465727900"
)

texts = st.none() | st.text(min_size=1, max_size=30)
u32, u64 = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
i64 = st.integers(-(2**63), 2**63 - 1)


def test_the_bytes_of_a_commands_tag() -> None:
    assert COMMAND.packed() == COMMAND_BYTES
    assert CommandTag.unpacked(COMMAND_BYTES) == COMMAND


def test_the_bytes_of_a_states_tag() -> None:
    assert STATE.packed() == STATE_BYTES
    assert StateTag.unpacked(STATE_BYTES) == STATE


@given(u64, i64, u32, st.binary(min_size=16, max_size=16), u32)
def test_a_commands_tag_comes_back_as_it_was(
    sequence: int, stamp_ns: int, ttl_ms: int, lease_id: bytes, lease_sequence: int
) -> None:
    tag = CommandTag(
        sequence=sequence,
        stamp_ns=stamp_ns,
        time_to_live_ms=ttl_ms,
        lease_id=lease_id,
        lease_sequence=lease_sequence,
    )
    assert CommandTag.unpacked(tag.packed()) == tag


@given(u64, i64, u32, u64, st.booleans(), st.booleans(), st.none() | st.integers(0, 63), texts, texts)
def test_a_states_tag_comes_back_as_it_was(
    sequence: int,
    stamp_ns: int,
    age_us: int,
    command_sequence: int,
    measured: bool,
    healthy: bool,
    contacts: int | None,
    fault: str | None,
    stopped: str | None,
) -> None:
    tag = StateTag(
        sequence=sequence,
        stamp_ns=stamp_ns,
        age_us=age_us,
        command_sequence=command_sequence,
        measured=measured,
        healthy=healthy,
        contacts=contacts,
        fault=fault,
        stopped=stopped,
    )
    assert StateTag.unpacked(tag.packed()) == tag


def test_a_text_that_is_too_long_is_cut_between_characters() -> None:
    tag = StateTag(
        sequence=1,
        stamp_ns=0,
        age_us=0,
        command_sequence=0,
        measured=True,
        healthy=True,
        contacts=None,
        fault="ä" * 200,
    )
    assert StateTag.unpacked(tag.packed()).fault == "ä" * 60


@pytest.mark.parametrize("kind", [CommandTag, StateTag])
@given(data=st.binary(max_size=200))
def test_other_bytes_are_refused(kind: type[CommandTag] | type[StateTag], data: bytes) -> None:
    with pytest.raises(MessageError, match="allowed"):
        kind.unpacked(data)


@pytest.mark.parametrize("good", [COMMAND_BYTES, STATE_BYTES])
def test_every_cut_and_every_other_version_is_refused(good: bytes) -> None:
    kind = CommandTag if good is COMMAND_BYTES else StateTag
    for end in range(len(good)):
        with pytest.raises(MessageError):
            kind.unpacked(good[:end])
    with pytest.raises(MessageError):
        kind.unpacked(good + b"\x00")
    with pytest.raises(MessageError, match="version 2"):
        kind.unpacked(good[:4] + b"\x02" + good[5:])
