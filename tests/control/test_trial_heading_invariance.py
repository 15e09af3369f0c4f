"""A walk ends at the same place whatever its heading: on an even floor, and after a self-rotation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray
from tests.robots import shipped

HEADINGS_RAD = tuple(math.radians(45 * k) for k in range(8))
CODES = (17, 77, 118)


def ends_m(trials: list[SimTrial]) -> FloatArray:
    """Signed deviation at the end of each walk."""
    results = run_sim_trials(trials)
    assert all(result.deviation is not None for result in results)
    return np.array([result.deviation.signed for result in results if result.deviation is not None])


def plan_of(code: int, duration_s: float = 30.0, heading_rad: float = 0.0) -> TrialPlan:
    gait = make_gait(shipped(), str(code), failed_legs=(5,))
    return TrialPlan(gait=gait, belief=Failure(leg=5), duration_s=duration_s, heading_rad=heading_rad)


def spreads_m(cone: str, duration_s: float) -> FloatArray:
    """By how much the ends of each gait differ between eight directions in which the robot is put down."""
    ends = []
    for facing_rad in HEADINGS_RAD:
        trials = [
            SimTrial(
                robot=shipped(),
                plan=replace(plan_of(code, duration_s=duration_s), self_rotation="none"),
                failure=Failure(leg=5),
                world=World.model_validate({"friction_cone": cone}),
                facing_rad=facing_rad,
            )
            for code in CODES
        ]
        ends.append(ends_m(trials))
    return np.asarray(np.ptp(ends, axis=0))


def test_a_walk_put_down_in_eight_headings_ends_within_a_centimetre_of_itself() -> None:
    assert spreads_m("elliptic", 15.0).max() < 0.01
    assert spreads_m("pyramidal", 5.0).max() > 0.01, "the test sees a grain where there is one"


def test_a_trial_with_its_self_rotation_ends_within_centimetres_of_itself() -> None:
    """Eight headings are eight angles to turn by, and what is left of a turn moves the end."""
    ends = [
        ends_m(
            [
                SimTrial(robot=shipped(), plan=plan_of(code, heading_rad=heading_rad), failure=Failure(leg=5))
                for code in CODES
            ]
        )
        for heading_rad in HEADINGS_RAD
    ]
    assert np.ptp(ends, axis=0).max() < 0.04


@pytest.mark.parametrize("robot", ["phantomx", "pexod"])
def test_other_robots_put_down_in_another_heading(robot: str) -> None:
    trials = [
        SimTrial(
            robot=robot,
            plan=TrialPlan(gait=make_gait(shipped(robot), "demo"), duration_s=10.0),
            failure=None,
            facing_rad=facing_rad,
        )
        for facing_rad in (0.0, 0.8)
    ]
    assert np.ptp(ends_m(trials)) < 0.01
