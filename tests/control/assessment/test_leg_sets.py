"""Which legs a robot can lose: verdicts by the margin, and walks that agree with them."""

import math
from dataclasses import replace
from itertools import combinations

import pytest

from hexctl.control.assessment.crawl import auto_gait
from hexctl.control.assessment.leg_sets import (
    CRAWLS,
    DOUBTFUL,
    NO_GAIT,
    WALKS,
    LegSet,
    doubt,
    drag,
    leg_set,
    leg_sets,
)
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from tests.robots import ROBOT_NAMES, shipped


def judged(name: str, *legs: int) -> LegSet:
    robot = shipped(name)
    return leg_set(robot, make_gait(robot, "demo"), legs)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_any_leg_and_any_opposite_pair_may_be_lost(name: str) -> None:
    for legs in [(1,), (2,), (3,), (4,), (5,), (6,), (1, 4), (2, 5), (3, 6)]:
        found = judged(name, *legs)
        assert (found.verdict, found.crawl) == (WALKS, False)
        assert doubt(found) is None


def test_of_other_pairs_the_hexagonal_robot_crawls_without_any() -> None:
    robot = shipped("ant")
    sets = leg_sets(robot, make_gait(robot, "demo"), (0.0,))
    assert [one.legs for one in sets] == [*combinations(range(1, 7), 1), *combinations(range(1, 7), 2)]
    crawls = [one for one in sets if one.verdict == CRAWLS]
    assert len(crawls) == 12
    assert all(one.crawl and one.margin < 0 for one in crawls)


@pytest.mark.parametrize(("legs", "verdict"), [((1, 2), DOUBTFUL), ((1, 3), DOUBTFUL), ((1, 5), CRAWLS)])
def test_two_legs_of_one_side_of_a_long_robot_are_doubtful(legs: tuple[int, ...], verdict: str) -> None:
    found = judged("pexod", *legs)
    assert found.verdict == verdict
    assert (doubt(found) is None) == (verdict == CRAWLS)


def test_a_crawl_is_said_to_crawl_however_little_it_leans() -> None:
    found = judged("pexod", 3, 4)
    assert (found.verdict, found.crawl) == (CRAWLS, True)
    assert found.margin > -0.1


def test_a_code_that_leans_by_more_than_codes_may_is_doubtful() -> None:
    """Raised by 0.012 of its size, `ant` has no crawl in reach at twice the usual stride."""
    robot = shipped("ant")
    found = leg_set(robot, replace(make_gait(robot, "demo"), amplitude=0.22), (1, 4), (0.0,))
    assert (found.verdict, found.crawl) == (DOUBTFUL, False)
    assert "by 0.11 of the radius of the stance, and only up to 0.1 was tried" in (doubt(found) or "")


def test_three_legs_leave_no_gait() -> None:
    found = judged("ant", 1, 3, 5)
    assert found.verdict == NO_GAIT
    assert doubt(found) == "without legs 1, 3, 5 no gait keeps the robot up: only 3 carry, and one swings"


def test_a_verdict_is_that_of_the_worst_direction() -> None:
    robot, gait = shipped("ant"), make_gait(shipped("ant"), "demo")
    ways = (0.0, 1.57)
    each = [leg_set(robot, gait, (2, 6), (way,)).margin for way in ways]
    assert leg_set(robot, gait, (2, 6), ways).margin == min(each)


@pytest.mark.parametrize(("legs", "least", "most"), [((1, 5), 0.4, 1.1), ((2, 3), -0.5, 0.4)])
def test_the_simulation_agrees(legs: tuple[int, ...], least: float, most: float) -> None:
    """`pexod`, limp legs, straight ahead."""
    robot = shipped("pexod")
    first, second = (Failure(leg=leg, kind="limp") for leg in legs)
    plan = TrialPlan(
        gait=make_gait(robot, "demo"), belief=first, further_failures=(second,), duration_s=8.0, hold="line"
    )
    plan = TrialPlan(
        gait=auto_gait(robot, plan), belief=first, further_failures=(second,), duration_s=8.0, hold="line"
    )
    result = run_sim_trial(SimTrial(robot=robot, plan=plan, failure=first, further_failures=(second,)))
    assert result.distance_m is not None
    assert least <= result.distance_m / result.ideal_distance_m <= most


@pytest.mark.parametrize(
    ("legs", "kind", "heading_deg", "drags"),
    [
        ((1, 2), "limp", 0, True),
        ((1, 2), "limp", 120, False),
        ((1, 2), "missing", 0, False),
        ((2, 3), "limp", 0, False),
        ((2, 3), "limp", 90, True),
        ((2, 6), "limp", 0, False),
        ((1, 4), "limp", 0, False),
    ],
)
def test_limp_neighbours_ahead_drag(legs: tuple[int, ...], kind: str, heading_deg: int, drags: bool) -> None:
    failures = [Failure(leg=leg, kind=kind) for leg in legs]
    note = drag(shipped("ant"), failures, math.radians(heading_deg))
    assert (note is not None) == drags
