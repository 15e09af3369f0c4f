"""Failures of legs: as values and as text."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from hexctl.errors import InputError
from hexctl.robot.failure import Failure, FailureEvent, check_events, failures_json
from hexctl.robot.failure_grammar import (
    option_of,
    parse_coming_kind,
    parse_failure,
    parse_failure_event,
    parse_failure_now,
    parse_healing,
    parse_kind,
    parse_leg,
    parse_legs,
    read_failures,
    read_failures_before,
)


@pytest.mark.parametrize("fails", [(), ("5:limp@6",), ("4:limp@1",)])
def test_a_leg_that_is_whole_is_not_to_heal(fails: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="heal: got 5@5"):
        check_events([*map(parse_failure_event, fails), parse_healing("5@5")])


def test_a_leg_heals_that_has_failed_by_option_by_world_or_before() -> None:
    healing = parse_healing("5@5")
    check_events([healing, parse_failure_event("5:limp@3")])
    check_events([healing], [parse_failure_event("5:limp@3")])
    check_events([healing], failed=[Failure(leg=5)])
    check_events([], [healing])


def test_a_leg_fails_in_one_manner_once_unless_it_heals() -> None:
    again, locked = parse_failure_event("5:locked@8"), Failure(leg=5)
    with pytest.raises(InputError, match="failure: got 5:locked@8"):
        check_events([again], failed=[locked])
    check_events([parse_failure_event("5:limp@8"), parse_failure_event("2:locked@8")], failed=[locked])
    check_events([again, parse_healing("5@5")], failed=[locked])


def test_results_name_every_failed_leg() -> None:
    told = failures_json([Failure(leg=2), Failure(leg=4, kind="limp"), Failure(leg=5, kind="missing")])
    assert told == {
        "failed_leg": 2,
        "failure": "locked",
        "further_failures": {"4": "limp", "5": "missing"},
    }


FAILURES = {
    "5": Failure(leg=5),
    "5:locked": Failure(leg=5),
    "5:limp": Failure(leg=5, kind="limp"),
    "5:limp:femur": Failure(leg=5, kind="limp", joint="femur"),
    "1:missing": Failure(leg=1, kind="missing"),
    "5:weak": Failure(leg=5, kind="weak", torque_fraction=0.3),
    "5:weak:0.5": Failure(leg=5, kind="weak", torque_fraction=0.5),
    "5:weak:femur:0.5": Failure(leg=5, kind="weak", joint="femur", torque_fraction=0.5),
    "5:stuck": Failure(leg=5, kind="stuck", joint="coxa", angle_rad=0.0),
    "5:stuck:tibia": Failure(leg=5, kind="stuck", joint="tibia"),
    "5:stuck:femur:-30": Failure(leg=5, kind="stuck", joint="femur", angle_rad=math.radians(-30)),
    "6:unknown": Failure(leg=6, kind="unknown"),
    " 5:LIMP:Femur": Failure(leg=5, kind="limp", joint="femur"),
}

#: Those that may come during a walk, as an event writes them.
COMING = (
    *("5:locked", "5:limp", "5:limp:femur", "1:missing", "5:weak:0.5", "5:weak:femur:0.5", "5:stuck:tibia"),
)

assert set(COMING) <= set(FAILURES)

WRONG_KINDS = [
    *("asleep", "", "locked:1", "locked:femur", "limp:0", "limp:foot", "missing:1"),
    *("weak:0.1:2", "weak:1.5", "weak:-0.1", "weak:nan", "weak:little", "weak:", "weak:2"),
    *("stuck:knee:3", "stuck:femur:far", "stuck:femur:nan", "stuck:femur:inf", "stuck:femur:1:2"),
]

#: Parsers of kinds, and the text that each takes.
PARSERS: list[tuple[Callable[[str], object], str]] = [
    (parse_failure, "5:{}"),
    (parse_failure_now, "5:{}"),
    (parse_failure_event, "5:{}@8"),
    (lambda text: parse_kind(5, text), "{}"),
    (lambda text: parse_coming_kind(5, text), "{}"),
]


@pytest.mark.parametrize("text", FAILURES)
def test_a_failure_is_read_from_its_text(text: str) -> None:
    failure = FAILURES[text]
    assert parse_failure(text) == failure
    assert read_failures(text) == ((failure,), ())
    assert parse_failure(f"{failure.leg}:{failure}") == failure
    if text in COMING:
        event = parse_failure_event(f"{text}@8.5")
        assert (event.leg, event.failure, event.at_s) == (failure.leg, failure, 8.5)
        assert str(event) == f"{text}@8.5"
        assert parse_failure_now(text) == failure
        assert read_failures(f"{text}@8.5") == ((), (event,))


@pytest.mark.parametrize(("parse", "form"), PARSERS)
def test_a_wrong_kind_is_refused(parse: Callable[[str], object], form: str) -> None:
    for kind in WRONG_KINDS:
        with pytest.raises(InputError):
            parse(form.format(kind))


@pytest.mark.parametrize("wrong", [3, "limpy"])
def test_a_wrong_kind_or_joint_has_one_name_and_the_allowed_ones(wrong: Any) -> None:
    with pytest.raises(InputError, match=r"^failure: got .*; allowed: locked, limp, stuck, weak, missing"):
        Failure(leg=5, kind=wrong)
    with pytest.raises(InputError, match=r"^failed joint: got .*; allowed: coxa, femur, tibia"):
        Failure(leg=5, kind="stuck", joint=wrong)


@pytest.mark.parametrize("suffix", ["", "@8"])
def test_a_failure_needs_its_leg(suffix: str) -> None:
    for text in ("limp", "", ":", "limp:5", "0:limp", "7:limp", "-1", "9limp", "5.0:limp", "²:limp", "\x1e5"):
        with pytest.raises(InputError, match="failure"):
            read_failures(text + suffix)


#: Texts that a parser refuses: a time out of place, or what only a walk from its start can have.
REFUSED_TEXTS: list[tuple[Callable[[str], object], tuple[str, ...]]] = [
    (parse_failure_event, ("5:locked@-1", "5:locked@nan", "5:locked@soon", "5:locked@", "5:limp", "5@@8")),
    (parse_failure_event, ("@", "5:stuck:femur:30@8", "5:stuck@8", "5:unknown@8")),
    (parse_failure_now, ("5:limp@8", "5@8", "limp", "9:limp", "5:stuck:femur:30", "5:stuck", "5:unknown")),
    (parse_healing, ("5", "5@", "@20", "0@3", "5:limp@8", "5@-1")),
]


@pytest.mark.parametrize(("parse", "texts"), REFUSED_TEXTS)
def test_what_a_failure_cannot_have_there_is_refused(
    parse: Callable[[str], object], texts: tuple[str, ...]
) -> None:
    for text in texts:
        with pytest.raises(InputError, match="allowed"):
            parse(text)


@pytest.mark.parametrize(
    ("asked", "legs", "failures", "events"),
    [
        (None, None, [], []),
        ((), "5", ["5:locked"], []),
        ((), (5, 2), ["2:locked", "5:locked"], []),
        ("5:limp", "2", ["2:locked", "5:limp"], []),
        ("5:locked", "2,5", ["2:locked", "5:locked"], []),
        (["5:limp", "2"], 1, ["1:locked", "2:locked", "5:limp"], []),
        ("5:limp,2:missing@4", None, ["5:limp"], ["2:missing@4"]),
        ("5:limp@8", 5, ["5:locked"], ["5:limp@8"]),
        (Failure(leg=3, kind="weak"), None, ["3:weak:0.3"], []),
        ((Failure(leg=3), "1:limp"), None, ["1:limp", "3:locked"], []),
        (FailureEvent(at_s=1.0, leg=4, failure=Failure(leg=4)), None, [], ["4:locked@1"]),
    ],
)
def test_failures_of_texts_values_and_legs_are_put_together(
    asked: Any, legs: Any, failures: list[str], events: list[str]
) -> None:
    read = read_failures(asked, legs)
    assert [f"{one.leg}:{one}" for one in read.failures] == failures
    assert [str(one) for one in read.events] == events


@pytest.mark.parametrize(
    ("asked", "legs", "option"),
    [
        ("5:limp,5:locked", None, "failure"),
        (None, (5, 5), "failed_leg"),
        (None, "1,2,3,4", "failed_leg"),
        (None, 7, "1..6"),
        (None, "7", "failed_leg"),
        (None, "two", "failed_leg"),
        ("5:limp,", None, "failure"),
        ("5:limp", 5, "failed_leg: got 5, a locked leg, which failure makes limp"),
    ],
)
def test_failures_that_cannot_be_together_are_refused(asked: Any, legs: Any, option: str) -> None:
    with pytest.raises(InputError, match=option):
        read_failures(asked, legs)


def test_failures_that_may_not_come_later_are_refused() -> None:
    assert read_failures_before("5:limp", 2, "") == (Failure(leg=2), Failure(leg=5, kind="limp"))
    with pytest.raises(InputError, match="failure"):
        read_failures_before("5:limp@8", None, "one before the search")


@pytest.mark.parametrize(("text", "option"), [("5:locked", "failed_leg"), ("2:stuck:femur:30", "failure")])
def test_the_option_of_a_failure_reads_back(text: str, option: str) -> None:
    name, value = option_of(parse_failure(text))
    assert name == option
    read = read_failures(value) if name == "failure" else read_failures((), value)
    assert read.failures == (parse_failure(text),)


def test_legs_are_numbers_with_commas() -> None:
    assert parse_legs("5, 2") == (2, 5)
    assert parse_leg("5") == 5
    for text in ("", ",", "7", "2,x", "auto", "2.0", "5\x1f", "\x1f"):
        with pytest.raises(InputError, match="--legs"):
            parse_legs(text, "--legs")
