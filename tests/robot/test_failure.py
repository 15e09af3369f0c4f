"""Failures as values."""

import pickle
from typing import Any

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.robot.failure import FAILURE_KINDS, Failure, FailureEvent, check_healings, failure_text
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing


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


def test_failures_of_several_legs_are_one_text() -> None:
    assert failure_text(Failure(leg=2, kind="limp"), Failure(leg=5)) == "leg 2 limp and leg 5 locked"
    assert failure_text() == "none"


def test_an_event_breaks_one_leg() -> None:
    with pytest.raises(InputError, match="leg 4"):
        FailureEvent(at_s=1.0, leg=4, failure=Failure(leg=5))


@pytest.mark.parametrize("fails", [(), ("5:limp@6",), ("4:limp@1",)])
def test_a_leg_that_is_whole_is_not_to_heal(fails: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="heal: got 5@5, when leg 5 is whole"):
        check_healings([*map(parse_failure_event, fails), parse_healing("5@5")])


def test_a_leg_heals_that_has_failed_by_option_by_world_or_before() -> None:
    healing = parse_healing("5@5")
    check_healings([healing, parse_failure_event("5:limp@3")])
    check_healings([healing], [parse_failure_event("5:limp@3")])
    check_healings([healing], failed_legs=[5])
    check_healings([], [healing])
