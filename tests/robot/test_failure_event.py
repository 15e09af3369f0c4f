"""Failures to come, as text and as values."""

import pytest

from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.failure_event import FailureEvent, parse_failure_event, parse_healing


@pytest.mark.parametrize(
    ("text", "failure"),
    [
        ("5:locked@8", Failure(leg=5, kind="locked")),
        ("1:limp@0", Failure(leg=1, kind="limp")),
        ("1:limp:femur@0.5", Failure(leg=1, kind="limp", joint="femur")),
        ("2:weak:0.2@3", Failure(leg=2, kind="weak", torque_fraction=0.2)),
        ("2:weak:tibia:0.2@3", Failure(leg=2, kind="weak", joint="tibia", torque_fraction=0.2)),
        ("6:stuck:tibia@12.5", Failure(leg=6, kind="stuck", joint="tibia")),
        ("3:missing@1", Failure(leg=3, kind="missing")),
    ],
)
def test_text_and_event_say_the_same(text: str, failure: Failure) -> None:
    event = parse_failure_event(text)
    assert event.failure == failure
    assert event.leg == failure.leg
    assert str(event) == text


def test_a_leg_heals() -> None:
    event = parse_healing("5@20")
    assert (event.leg, event.at_s, event.failure, str(event)) == (5, 20.0, None, "5@20")


@pytest.mark.parametrize(
    "text",
    [
        *("5", "5:locked", "locked@8", "7:locked@8", "5:locked@-1", "5:locked@nan", "5:locked@soon"),
        *("5:asleep@8", "5:stuck:femur:30@8", "5:unknown@8", "5:limp:foot@8", "5:weak:2@8"),
        *("5:locked:femur@8", "@", ":@", ""),
    ],
)
def test_what_is_no_event_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_failure_event(text)
    assert "\n" not in str(caught.value)
    assert "allowed" in str(caught.value)


@pytest.mark.parametrize("text", ["5", "5@", "@20", "0@3", "5:limp@8", "5@-1"])
def test_what_is_no_healing_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="allowed"):
        parse_healing(text)


def test_an_event_breaks_one_leg() -> None:
    with pytest.raises(InputError, match="leg 4"):
        FailureEvent(at_s=1.0, leg=4, failure=Failure(leg=5))
