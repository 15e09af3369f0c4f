"""Failures to come, as text and as values."""

import pytest

from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.failure_event import (
    FailureEvent,
    check_healings,
    parse_failure_event,
    parse_failure_now,
    parse_healing,
)


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
        *("5:asleep@8", "5:stuck:femur:30@8", "5:stuck@8", "5:unknown@8", "5:limp:foot@8", "5:weak:2@8"),
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


@pytest.mark.parametrize("text", ["limp", "5:asleep", "5:limp@8", "5:unknown", "5:stuck:foot", "5:weak:2"])
def test_what_is_offered_for_a_failure_that_comes_now_is_allowed(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_failure_now(text)
    said = str(caught.value)
    assert said.startswith(f"failure of a leg: got {text!r}; allowed: ")
    assert not [word for word in ("@", "DEGREES", "unknown") if word in said.partition("allowed:")[2]]
    assert parse_failure_now("5:limp") == Failure(leg=5, kind="limp")


@pytest.mark.parametrize("text", ["5:asleep@8", "5:limp", "5:limp:foot@8", "5:stuck:foot@8", "5:unknown@8"])
def test_what_is_offered_for_a_failure_to_come_is_allowed(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_failure_event(text)
    assert str(caught.value).startswith(f"failure event: got {text!r}; allowed: ")
    assert not [word for word in ("DEGREES", "unknown") if word in str(caught.value).partition("allowed")[2]]


@pytest.mark.parametrize("fails", [(), ("5:limp@6",), ("4:limp@1",)])
def test_a_leg_that_is_whole_is_not_to_heal(fails: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="healing: got 5@5, when leg 5 is whole; allowed: after its failure"):
        check_healings([*map(parse_failure_event, fails), parse_healing("5@5")])


def test_a_leg_heals_that_has_failed_by_option_by_world_or_before() -> None:
    healing = parse_healing("5@5")
    check_healings([healing, parse_failure_event("5:limp@3")])
    check_healings([healing], [parse_failure_event("5:limp@3")])
    check_healings([healing], failed_legs=[5])
    check_healings([], [healing])
