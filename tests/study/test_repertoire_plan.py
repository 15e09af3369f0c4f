"""Which situations and candidates a repertoire walks."""

from itertools import combinations
from typing import Any

import pytest

from hexctl.control.monitor.recovery import GlideToStableGait
from hexctl.control.monitor.repertoire import SAFEST, WALK_ON, moved_parts, parts_of
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from tests.study.made_up_repertoire import plan


@pytest.mark.parametrize(
    ("name", "directions", "alike", "walked"),
    [("ant", 12, 12, 7), ("ant", 8, 4, 13), ("phantomx", 6, 4, 9), ("pexod", 6, 2, 18)],
)
def test_of_situations_that_are_alike_one_is_walked(
    name: str, directions: int, alike: int, walked: int
) -> None:
    asked = plan(name, directions=directions)
    assert len(asked.symmetries) == alike
    assert len(asked.situations) == walked
    reached = {
        (moved_parts(parts_of(failures), one.legs), round(one.heading_deg(heading_deg)) % 360)
        for failures, heading_deg in asked.situations
        for one in asked.symmetries
    }
    assert len(reached) == 6 * directions


def test_pairs_fail_alike() -> None:
    asked = plan("pexod", directions=1, failures=(), pair_failures=("limp",))
    legs = {tuple(one.leg for one in failures) for failures, _ in asked.situations}
    assert legs <= set(combinations(range(1, 7), 2))
    assert len(legs) == 9  # of 15, three of which are their own mirror images
    assert all(len(asked.candidates(*one)) > 3 for one in asked.situations)


def test_the_first_candidate_is_what_a_recovery_does_without_a_repertoire() -> None:
    asked = plan(directions=12, pair_failures=("missing",))
    for failures, heading_deg in asked.situations[::3]:
        first, *others = asked.candidates(failures, heading_deg)
        trial = TrialPlan(gait=asked.gait, hold="line")
        rule = GlideToStableGait(None).respond(asked.robot, trial, heading_deg / 57.29577951, failures)
        assert (first.name, first.gait(asked.gait)) == (SAFEST, rule.gait)
        assert WALK_ON in [one.name for one in others]


def test_candidates_differ_and_can_be_walked() -> None:
    asked = plan(codes=2)
    found = asked.candidates((Failure(leg=2, kind="stuck", joint="femur"),), 0.0)
    assert len({one.gait(asked.gait) for one in found}) == len(found) == 8
    assert [one.name for one in found[:6]] == [
        "safest", "walk-on", "not raised", "not tucked", "code 2", "code 3",
    ]  # fmt: skip
    assert found[3].tucked_legs == ()
    assert found[2].body_raise == 0.0
    gone = asked.candidates((Failure(leg=2, kind="missing"),), 0.0)
    assert "not tucked" not in [one.name for one in gone]


def test_worlds_are_none_that_a_benchmark_uses_and_fewer_are_the_first_of_more() -> None:
    numbers = [one.number for one in plan(worlds=16).places()]
    assert numbers == list(range(100, 116))
    few, many = (plan(worlds=worlds).places() for worlds in (1, 3))
    assert few[0].fingerprint == many[0].fingerprint


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"directions": 5}, "directions: got 5; allowed: 1, 2, 4, 6, 8, 12"),
        ({"worlds": 17}, "worlds: got 17; allowed: 1..16"),
        ({"worlds": 0}, "worlds: got 0"),
        ({"codes": 30}, "codes: got 30; allowed: 0..11"),
        ({"failures": ("tired",)}, "tired"),
    ],
)
def test_what_is_not_allowed_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        plan(**options).check()
