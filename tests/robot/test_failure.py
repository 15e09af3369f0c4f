"""Failures and their command-line text."""

import math
import pickle
from typing import Any

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.robot.failure import (
    FAILURE_KINDS,
    Failure,
    failure_of,
    failure_text,
    failures_of,
    parse_failure,
)


@pytest.mark.parametrize(
    ("text", "failure"),
    [
        ("locked", Failure(leg=5)),
        ("limp", Failure(leg=5, kind="limp")),
        ("missing", Failure(leg=5, kind="missing")),
        ("weak", Failure(leg=5, kind="weak", torque_fraction=0.3)),
        ("weak:0.5", Failure(leg=5, kind="weak", torque_fraction=0.5)),
        ("stuck", Failure(leg=5, kind="stuck", joint="coxa", angle_rad=0.0)),
        ("stuck:tibia", Failure(leg=5, kind="stuck", joint="tibia")),
        ("stuck:femur:-30", Failure(leg=5, kind="stuck", joint="femur", angle_rad=math.radians(-30))),
        ("unknown", Failure(leg=5, kind="unknown")),
    ],
)
def test_a_failure_is_read_from_its_text(text: str, failure: Failure) -> None:
    assert parse_failure(5, text) == failure


@pytest.mark.parametrize(
    "text", ["locked", "limp", "missing", "weak:0.5", "stuck:coxa:0", "stuck:femur:-30", "unknown"]
)
def test_the_text_of_a_failure_reads_back(text: str) -> None:
    assert str(parse_failure(2, text)) == text


@pytest.mark.parametrize(
    ("leg", "text", "allowed"),
    [
        (0, "locked", "1..6"),
        (7, "locked", "1..6"),
        (1, "broken", "failure: got broken; allowed: locked, limp[:JOINT], missing, weak"),
        (1, "", "locked"),
        (1, "Lockd", "locked"),
        (1, "locked:1", "weak:[JOINT:]FRACTION"),
        (1, "limp:0", "limp:JOINT with coxa, femur, tibia"),
        (1, "unknown:1", "weak:[JOINT:]FRACTION"),
        (1, "weak:0.1:2", "weak:FRACTION"),
        (1, "weak:1.5", "failure: got weak:1.5; allowed: weak:FRACTION or weak:JOINT:FRACTION"),
        (1, "weak:-0.1", "0..1"),
        (1, "weak:nan", "0..1"),
        (1, "weak:little", "a number in place of 'little'"),
        (1, "weak:", "a number"),
        (1, "stuck:knee:3", "coxa, femur, tibia"),
        (1, "stuck:femur:far", "a number in place of 'far'"),
        (1, "stuck:femur:nan", "finite"),
        (1, "stuck:femur:inf", "finite"),
        (1, "stuck:femur:1:2", "stuck:JOINT:DEGREES"),
    ],
)
def test_anything_else_is_refused_with_what_is_allowed(leg: int, text: str, allowed: str) -> None:
    with pytest.raises(InputError, match="got") as refused:
        parse_failure(leg, text)
    assert allowed in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_failure_needs_its_leg_and_a_leg_alone_is_locked() -> None:
    assert failure_of(None, None) is None
    assert failure_of(5, None) == Failure(leg=5)
    assert failure_of(5, "limp") == Failure(leg=5, kind="limp")
    with pytest.raises(InputError, match=r"^failure: got limp without a leg; allowed: with failed_leg 1..6$"):
        failure_of(None, "limp")


@pytest.mark.parametrize("kind", FAILURE_KINDS)
def test_a_failure_travels_to_another_process(kind: str) -> None:
    failure = Failure(leg=3, kind=kind, torque_fraction=0.4, angle_rad=0.2)
    assert pickle.loads(pickle.dumps(failure)) == failure  # noqa: S301  our own bytes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"leg": "5"}, "failed leg: got '5' (str); allowed: a leg's number, 1..6"),
        ({"leg": True}, "failed leg: got True (bool)"),
        ({"leg": None}, "failed leg: got None (NoneType)"),
        ({"kind": 1}, "failure: got 1 (int); allowed: locked, limp"),
        ({"joint": 2}, "failed joint: got 2 (int); allowed: coxa, femur, tibia"),
        ({"angle_rad": "0.3"}, "stuck angle: got '0.3' (str); allowed: a finite angle in rad"),
        ({"torque_fraction": "half"}, "weak torque fraction: got 'half' (str); allowed: a number in 0..1"),
    ],
)
def test_a_value_of_a_wrong_type_is_refused_at_once(change: dict[str, Any], message: str) -> None:
    with pytest.raises(WrongTypeError) as refused:
        Failure(**{"leg": 5, **change})
    assert str(refused.value).startswith(message)


def test_a_failure_is_not_read_from_another_failure() -> None:
    with pytest.raises(WrongTypeError, match=r"failure: got Failure\(.*allowed: locked, limp"):
        parse_failure(5, Failure(leg=5))  # type: ignore[arg-type]


def test_failures_of_several_legs_are_one_for_all_or_one_for_each() -> None:
    assert failures_of((5, 2), "limp") == (Failure(leg=2, kind="limp"), Failure(leg=5, kind="limp"))
    assert failures_of((5, 2), "limp,stuck:femur:20") == (
        parse_failure(2, "stuck:femur:20"),
        Failure(leg=5, kind="limp"),
    )
    assert failures_of((3,), None) == (Failure(leg=3),)
    assert failure_text(*failures_of((2, 5), "limp,locked")) == "leg 2 limp and leg 5 locked"


@pytest.mark.parametrize(
    ("legs", "words", "message"),
    [
        ((2, 2), "limp", "got legs 2, 2; allowed: each leg once"),
        ((1, 2, 3, 4), "limp", "got 4 legs; allowed: up to 3"),
        (
            (2, 5),
            "limp,limp,limp",
            "got limp,limp,limp with legs 2, 5; allowed: one for all, or one",
        ),
        ((2, 7), "limp", "failed leg: got 7; allowed: 1..6"),
    ],
)
def test_failures_of_several_legs_that_cannot_be(legs: tuple[int, ...], words: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        failures_of(legs, words)
