"""The likely cause of a walk without progress, in simulations that were built to have one."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.assessment.cause import CAUSES, Symptoms, WalkSamples
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import RobotState
from tests.robots import shipped
from tests.trials import gait_of

ICY_SLOPE = World(friction=0.19, slope_deg=10, friction_cone="elliptic")
FLAT = World(friction_cone="elliptic")


def changed(name: str, *, stiffness: float = 1.0, torque: float = 1.0) -> Robot:
    """A shipped robot with multiples of its servos' stiffness and torque."""
    robot = shipped(name)
    servo = replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad)
    return replace(robot, servo=servo, joint_max_torque_nm=torque * robot.joint_max_torque_nm)


def trial_of(robot: Robot, world: World, failure: Failure | None = None) -> SimTrial:
    plan = TrialPlan(gait=gait_of(robot, "demo"), duration_s=5.0, belief=failure)
    return SimTrial(robot=robot, plan=plan, failure=failure, world=world)


@pytest.mark.parametrize("failure", [None, Failure(leg=5)])
@pytest.mark.parametrize("name", ["ant", "pexod"])
@pytest.mark.parametrize(
    ("cause", "change", "world"),
    [
        ("saturation", {"torque": 0.025}, FLAT),
        ("sag", {"stiffness": 0.05}, FLAT),
        ("slip", {}, ICY_SLOPE),
    ],
)
def test_the_cause_is_named(
    cause: str, change: dict[str, float], world: World, name: str, failure: Failure | None
) -> None:
    result = run_sim_trial(trial_of(changed(name, **change), world, failure))
    assert result.status == "no_progress"
    assert result.cause == cause
    assert cause in repr(result)
    assert result.to_dict()["cause"] == cause
    assert TrialResult.from_dict(result.to_dict()).cause == cause


def test_a_good_walk_has_none() -> None:
    result = run_sim_trial(trial_of(shipped("ant"), FLAT))
    assert (result.status, result.cause) == ("ok", None)


@pytest.mark.slow
def test_a_batch_finds_what_each_trial_finds_alone() -> None:
    trial = trial_of(changed("ant", torque=0.025), FLAT)
    longer = replace_duration(trial, 9.0)
    together = run_sim_trials([trial, longer])
    assert together == [run_sim_trial(trial), run_sim_trial(longer)]
    assert [result.cause for result in together] == ["saturation", "saturation"]


def replace_duration(trial: SimTrial, duration_s: float) -> SimTrial:
    plan = replace(trial.plan, duration_s=duration_s)
    return SimTrial(robot=trial.robot, plan=plan, failure=trial.failure, world=trial.world)


def test_joints_that_are_not_measured_tell_nothing() -> None:
    samples = WalkSamples(100)
    echoed = RobotState(np.zeros(18), 0.0, False, foot_contacts=np.ones(6, dtype=bool))
    for _ in range(100):
        samples.add(echoed, np.zeros(18))
    assert samples.of(100) is None


@pytest.mark.parametrize(
    ("cause", "seen", "unseen"),
    [
        ("saturation", Symptoms(0.51, 0.0, 0.0), Symptoms(0.49, 0.0, 0.0)),
        ("sag", Symptoms(0.0, 0.43, 0.0), Symptoms(0.0, 0.41, 0.0)),
        ("slip", Symptoms(0.0, 0.0, 0.41), Symptoms(0.0, 0.0, 0.39)),
    ],
)
def test_a_cause_begins_at_its_bound(cause: str, seen: Symptoms, unseen: Symptoms) -> None:
    assert (seen.cause, unseen.cause) == (cause, None)


def test_torque_limits_come_before_soft_servos_and_those_before_the_floor() -> None:
    assert Symptoms(0.9, 2.0, 3.0, clipped=0.97, motion=0.3).cause == "clipping"
    assert Symptoms(saturated=0.9, tracking_error=2.0, slip=3.0).cause == "saturation"
    assert Symptoms(saturated=0.0, tracking_error=0.8, slip=3.0).cause == "sag"
    assert Symptoms(saturated=0.0, tracking_error=0.2, slip=3.0).cause == "slip"
    assert Symptoms(saturated=0.0, tracking_error=0.2, slip=0.1).cause is None
    assert set(CAUSES) == {"clipping", "saturation", "sag", "slip"}
