"""Faults of simulated boards, by their words."""

import pytest

from hexctl.errors import InputError
from hexctl.simulators.board_faults import BoardFault, DueFaults, parse_fault

KINDS = {"mute": "", "trip": "AMPERES", "garble": "SHARE", "nack": "[:SHARE]"}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("mute", BoardFault(kind="mute")),
        ("mute@1.5", BoardFault(kind="mute", at_s=1.5)),
        ("trip:12@3", BoardFault(kind="trip", at_s=3, value=12)),
        ("nack", BoardFault(kind="nack")),
        ("nack:0.5", BoardFault(kind="nack", value=0.5)),
    ],
)
def test_a_fault_has_a_word_a_number_and_a_time(text: str, fault: BoardFault) -> None:
    assert parse_fault(text, KINDS) == fault


@pytest.mark.parametrize(
    "text", ["", "echo", "mute:3", "trip", "trip:x", "garble", "garble:1.1", "nack:2", "mute@x", "mute@-1"]
)
def test_what_is_no_fault_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"fault: got .*; allowed: "):
        parse_fault(text, KINDS)


def test_the_words_are_named_with_their_numbers() -> None:
    with pytest.raises(InputError, match=r"allowed: mute, trip:AMPERES, garble:SHARE, nack\[:SHARE\], each"):
        parse_fault("x", KINDS)


def test_faults_begin_in_their_order_and_once() -> None:
    faults = DueFaults(tuple(parse_fault(text, KINDS) for text in ("mute@3", "nack", "trip:1@2")))
    assert [fault.kind for fault in faults.begun(0.0)] == ["nack"]
    assert faults.begun(1.9) == []
    assert [fault.kind for fault in faults.begun(5.0)] == ["trip", "mute"]
    assert faults.begun(9.0) == []
