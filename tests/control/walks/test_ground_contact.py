"""Feet on uneven ground: a contact is injected at a height of the ground under each foot."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from hexctl import RobotState, TrialPlan, make_gait
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.drive.drive_walk import DriveWalk
from hexctl.control.preparation import WalkStart
from hexctl.control.walks.ground_contact import DEPTH, GAP, MISSES, UNEVEN_HEIGHT, step_height
from hexctl.control.walks.velocity_walk import MotionWalk, VelocityWalk
from hexctl.ik.legs import foot_positions_body, legs_that_reach
from hexctl.types import FloatArray
from tests.robots import shipped

ROBOT = shipped()
PERIOD_S = 0.02
LEVEL_M = ROBOT.stance_feet_body[:, 2]
CYCLE = round(1 / (ROBOT.gait.pace_hz * PERIOD_S))

#: From here on the soft start is over.
STEADY = 2 * CYCLE


def plan(gait: str = "tripod") -> TrialPlan:
    """A walk with adaptive feet."""
    made = make_gait(ROBOT, gait, height=step_height(ROBOT, "adaptive"))
    return TrialPlan(gait=made, feet="adaptive", duration_s=4.0)


def start(of: TrialPlan) -> WalkStart:
    """One robot that stands ready to walk."""
    return WalkStart(robot=ROBOT, plans=(of,))


def heights(
    walk: VelocityWalk,
    ground_m: FloatArray,
    ticks: int = 6 * CYCLE,
    first: int = 0,
    before: Callable[[], None] = lambda: None,
) -> tuple[FloatArray, FloatArray]:
    """Heights of the feet over the level of the stance, (ticks, 6), and the phases of legs that step.

    The joints follow at once; feet touch at or below `ground_m`, (6,). `before` is called before each tick.
    """
    joints, rows, phases = ROBOT.stance_angles_rad, [], []
    for step in range(first, first + ticks):
        now_m = foot_positions_body(ROBOT, joints)[:, 2] - LEVEL_M
        state = RobotState(joints, step * PERIOD_S, True, foot_contacts=now_m <= ground_m + 1e-9)
        before()
        joints = walk.targets_rad(step, state)
        rows.append(foot_positions_body(ROBOT, joints)[:, 2] - LEVEL_M)
        if walk.leg_phases is not None:
            phases.append(walk.leg_phases)
    return np.array(rows), np.array(phases)


def walked(ground_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heights and phases of a steady walk."""
    height_m, phases = heights(MotionWalk(start(plan())), ground_m)
    return height_m[STEADY:], phases[STEADY:]


@pytest.mark.parametrize("block_m", [0.0, 0.02])
def test_feet_are_as_planned_on_even_ground_and_on_a_block(block_m: float) -> None:
    planned = MotionWalk(start(replace(plan(), feet="planned")))
    adaptive = MotionWalk(start(plan()))
    ground_m = np.array([block_m, 0.0, 0.0, 0.0, 0.0, 0.0])
    for one, other in zip(heights(planned, ground_m), heights(adaptive, ground_m), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_foot_searches_down_into_a_pit_stops_on_contact_and_returns_by_the_gap() -> None:
    ground_m = np.array([0.0, -0.02, 0.0, 0.0, 0.0, 0.0])
    height_m, phases = walked(ground_m)
    standing = (phases < 0.33) | (phases >= 0.67)
    lowest = height_m[standing[:, 1], 1].min()
    assert -0.02 - 0.005 < lowest <= -0.02
    late = height_m[(phases[:, 1] > 0.2) & (phases[:, 1] < 0.33), 1]
    np.testing.assert_allclose(late, -0.02 + GAP * ROBOT.standing_height_m, atol=0.004)


def test_a_search_ends_where_the_leg_ends_and_the_next_step_is_as_high_as_the_others() -> None:
    ground_m = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    height_m, _ = walked(ground_m)
    foot = height_m[:, 2]
    assert -DEPTH * ROBOT.standing_height_m - 1e-9 <= foot.min() < -0.02
    assert foot.max() == pytest.approx(UNEVEN_HEIGHT, abs=0.006)
    feet = np.repeat(ROBOT.stance_feet_body[np.newaxis], len(foot), axis=0)
    feet[:, 2, 2] += foot
    assert legs_that_reach(ROBOT, feet).all()


def test_a_tucked_leg_and_a_robot_without_contacts_search_nothing() -> None:
    gait = plan().gait
    tucked = replace(gait, posture=replace(gait.posture, tucked_legs=(2,)))
    height_m, _ = heights(MotionWalk(start(replace(plan(), gait=tucked))), np.full(6, -1.0))
    assert height_m[STEADY:, 1].min() > 0
    walk, joints = MotionWalk(start(plan())), ROBOT.stance_angles_rad
    planned = MotionWalk(start(replace(plan(), feet="planned")))
    for step in range(2 * CYCLE):
        state = RobotState(joints, step * PERIOD_S, True)
        joints = walk.targets_rad(step, state)
        np.testing.assert_array_equal(joints, planned.targets_rad(step, state))


@pytest.mark.slow
@pytest.mark.parametrize("driven", [False, True])
def test_a_foot_in_a_pit_that_is_stopped_in_mid_rise_does_not_jump(driven: bool) -> None:
    """At any time of a cycle: no foot moves 1.2 cm in a tick, where the fastest swing moves 1.0 cm."""
    ground_m, wanted = np.array([0.0, -0.04, 0.0, 0.0, 0.0, 0.0]), np.array([0.05, 0.0, 0.0])
    walk = DriveWalk(start(plan()), lambda: wanted) if driven else MotionWalk(start(plan()))
    kept: list[VelocityWalk] = []
    walked_m, _ = heights(walk, ground_m, STEADY + CYCLE, before=lambda: kept.append(deepcopy(walk)))
    for ticks in range(STEADY, STEADY + CYCLE):
        kept[ticks].stop(ticks)
        stopped_m, _ = heights(kept[ticks], ground_m, 2 * CYCLE, first=ticks)
        assert np.abs(np.diff(np.vstack([walked_m[ticks - 1], stopped_m]), axis=0)).max() < 0.012, ticks


def test_a_foot_whose_contact_never_closes_gives_up_until_it_does() -> None:
    walk = MotionWalk(start(plan()))
    dead_m = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    first = (MISSES + 1) * CYCLE
    searched_m, _ = heights(walk, dead_m, first)
    assert searched_m[:, 1].min() < -0.02
    given_up_m, _ = heights(walk, dead_m, 3 * CYCLE, first)
    np.testing.assert_allclose(given_up_m.min(axis=0), 0.0, atol=1e-9)
    heights(walk, np.zeros(6), CYCLE, first + 3 * CYCLE)
    again_m, _ = heights(walk, dead_m, 2 * CYCLE, first + 4 * CYCLE)
    assert again_m[:, 1].min() < -0.02


#: Bumps as high as steps, on a coarser grid than blocks have.
STONY = World(roughness_m=0.01, roughness_length_m=0.1)


@pytest.mark.slow
def test_a_batch_on_uneven_ground_equals_single_walks() -> None:
    """To the last bit, for different ground, gaits and postures."""
    trials = [
        SimTrial(robot=ROBOT, plan=plan(gait), failure=None, world=world, seed=seed)
        for gait, world, seed in (("tripod", STONY, 1), ("wave", STONY, 2), ("tripod", "ramps", 3))
    ]
    for one, other in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert one == other
