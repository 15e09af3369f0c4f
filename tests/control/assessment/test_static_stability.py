"""The gait that stands safest, against margins computed with another hull and by walking it."""

import math
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from hexctl.control.assessment.static_stability import (
    check_tucked,
    legs_that_stand,
    most_stable_slots,
    stable_slots_of,
    standing_margin_m,
    static_margins_m,
)
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.encoding import slots_from_code
from hexctl.gait.foot_trajectory import gait_feet_body
from hexctl.gait.gait import Gait, Motion, make_gait
from hexctl.gait.posture import Posture
from hexctl.ik.support_polygon import centre_of_mass_body
from hexctl.robot.failure import Failure
from hexctl.runs.run import run
from tests.robots import shipped


def walked_margin_m(robot_name: str, slots: tuple[int, ...], heading_rad: float, failure: Failure) -> float:
    """Smallest margin over the feet of the walk itself, by scipy's convex hull."""
    robot = shipped(robot_name)
    gait: Gait = make_gait(robot, slots)
    times_s = (10 + np.arange(200) / 200) / gait.pace_hz
    feet = gait_feet_body(robot, gait, Motion(heading_rad=heading_rad), times_s)
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    margins_m = []
    for row in feet:
        down = row[:, 2] < robot.stance_feet_body[:, 2] + 1e-9
        down[failure.leg - 1] = failure.kind == "locked"
        row[failure.leg - 1] = robot.stance_feet_body[failure.leg - 1]
        hull = ConvexHull(row[down, :2])
        margins_m.append(-(hull.equations[:, :2] @ centre + hull.equations[:, 2]).max())
    return float(min(margins_m))


@pytest.mark.parametrize("robot_name", ["ant", "phantomx"])
@pytest.mark.parametrize("kind", ["locked", "limp"])
def test_the_margin_is_that_of_the_feet_of_the_walk(robot_name: str, kind: str) -> None:
    robot, failure = shipped(robot_name), Failure(leg=2, kind=kind)
    slots = [slots_from_code(code, (2,)) for code in (1, 33, 77, 120)]
    margins_m = static_margins_m(robot, slots, heading_rad=0.4, failure=failure)[:, 0]
    expected_m = [walked_margin_m(robot_name, one, 0.4, failure) for one in slots]
    np.testing.assert_allclose(margins_m, expected_m, atol=0.004)


@pytest.mark.parametrize("kind", ["locked", "missing"])
def test_no_gait_has_a_larger_margin(kind: str) -> None:
    robot, failure = shipped(), Failure(leg=4, kind=kind)
    chosen = most_stable_slots(robot, heading_rad=0.0, failure=failure)
    others = [(*rest[:3], 4, *rest[3:]) for rest in permutations((1, 2, 3, 5, 6))]
    margins_m = static_margins_m(robot, [chosen, *others], heading_rad=0.0, failure=failure)[:, 0]
    assert margins_m[0] == pytest.approx(margins_m.max(), abs=1e-6)
    assert margins_m[0] > np.median(margins_m) + 0.01


def test_a_mirrored_failure_has_the_mirrored_margin() -> None:
    """Leg 2 is leg 6's mirror image."""
    robot = shipped()
    both = [
        static_margins_m(
            robot,
            [most_stable_slots(robot, heading_rad=heading_rad, failure=Failure(leg=leg))],
            heading_rad=heading_rad,
            failure=Failure(leg=leg),
        )[0, 0]
        for leg, heading_rad in ((2, math.radians(30)), (6, math.radians(-30)))
    ]
    assert both[0] == pytest.approx(both[1], abs=1e-9)


def test_it_is_chosen_for_the_direction_in_which_the_self_rotation_leaves_the_body() -> None:
    robot, failure = shipped(), Failure(leg=1)
    demo = make_gait(robot, "demo")
    rear = stable_slots_of(robot, TrialPlan(gait=demo, belief=failure))
    as_it_is = stable_slots_of(robot, TrialPlan(gait=demo, belief=failure, self_rotation="none"))
    assert rear == most_stable_slots(
        robot, heading_rad=float(robot.leg_azimuths_rad[0]) - math.pi, failure=failure
    )
    assert as_it_is == most_stable_slots(robot, heading_rad=0.0, failure=failure)
    assert rear != as_it_is


def test_an_intact_robot_has_one_too_and_it_walks() -> None:
    assert most_stable_slots(shipped(), heading_rad=0.0)[0] == 1
    walked = run(gait="auto", failure="2:missing", self_rotation="none", duration_s=10)
    assert walked.outcome["gait"]["name"] == "auto"
    assert walked.trial.status == "ok"
    assert walked.trial.distance_m is not None
    assert walked.trial.distance_m > 0.7 * walked.trial.ideal_distance_m


def standing(failure: Failure | None = None, **posture: Any) -> TrialPlan:
    gait = replace(make_gait(shipped(), "demo"), posture=Posture(**posture))
    return TrialPlan(gait=gait, belief=failure)


@pytest.mark.parametrize("robot_name", ["ant", "phantomx", "pexod"])
def test_the_margin_of_standing_is_that_of_the_hull_of_the_feet_that_stand(robot_name: str) -> None:
    robot = shipped(robot_name)
    for tucked, shift in (((), (0.0, 0.0)), ((2, 5), (0.03, -0.01)), ((1, 2, 3), (0.0, 0.0))):
        feet = [leg - 1 for leg in range(1, 7) if leg not in tucked]
        hull = ConvexHull(robot.stance_feet_body[feet, :2])
        over = centre_of_mass_body(robot, robot.stance_angles_rad)[:2] + np.array(shift) * robot.size_m
        expected_m = -(hull.equations[:, :2] @ over + hull.equations[:, 2]).max()
        plan = standing(tucked_legs=tucked, shift=shift)
        assert standing_margin_m(robot, plan) == pytest.approx(expected_m, abs=1e-9)


def test_legs_that_carry_nothing_do_not_stand() -> None:
    assert legs_that_stand(standing(tucked_legs=(2,))) == (1, 3, 4, 5, 6)
    for kind, stands in {
        "limp": False,
        "missing": False,
        "weak": True,
        "stuck": True,
        "locked": True,
    }.items():
        assert (4 in legs_that_stand(standing(Failure(leg=4, kind=kind)))) == stands
    assert 4 in legs_that_stand(standing(Failure(leg=4, kind="limp", joint="coxa")))
    raised = standing(Failure(leg=4), body_raise=0.01)
    assert 4 not in legs_that_stand(raised), "it hangs in its stance"


def test_legs_without_which_the_robot_cannot_stand_are_not_tucked() -> None:
    robot = shipped()
    for allowed in (standing(), standing(tucked_legs=(2, 5)), standing(tucked_legs=(1, 3, 5))):
        check_tucked(robot, allowed)
    check_tucked(robot, standing(tucked_legs=(1, 2), shift=(-0.05, -0.05)))
    for refused in (
        standing(tucked_legs=(1, 2)),
        standing(tucked_legs=(1, 2, 3)),
        standing(Failure(leg=6, kind="missing"), tucked_legs=(2, 4, 5)),
    ):
        with pytest.raises(InputError, match=r"tucked_legs: got .* above 0, where stance_shift counts"):
            check_tucked(robot, refused)
