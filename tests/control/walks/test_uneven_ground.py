"""Walks on uneven ground: feet that search for it, and bodies that level."""

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.drive.drive_walk import DriveWalk
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.body_poser import LEAST_STROKE, LEVEL_STROKE, MOST_LEVEL_RAD, BodyPoser
from hexctl.control.walks.ground_contact import DEPTH, GAP, MISSES, UNEVEN_HEIGHT, step_height
from hexctl.control.walks.velocity_walk import OVERDRIVE, MotionWalk, VelocityWalk
from hexctl.gait.body_pose import BodyPose, feet_from_body
from hexctl.gait.foot_trajectory import StepPattern
from hexctl.gait.gait import make_gait
from hexctl.gait.posture import Posture
from hexctl.ik.legs import foot_positions_body, legs_that_reach, solve_legs
from hexctl.types import FloatArray, RobotState
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import sim_trial

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
        SimTrial(robot=ROBOT, plan=plan(gait), failures=None, world=world, seed=seed)
        for gait, world, seed in (("tripod", STONY, 1), ("wave", STONY, 2), ("tripod", "ramps", 3))
    ]
    for one, other in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert one == other


# Bodies that move over the feet of a walk: reach, speed, levelling


def state(quaternion: FloatArray) -> RobotState:
    joints_rad = np.zeros((*quaternion.shape[:-1], 18))
    return RobotState(joints_rad, stamp_s=0.0, measured=True, base_quaternion_world=quaternion)


def tilted(roll_rad: float, pitch_rad: float = 0.0) -> FloatArray:
    return np.array([math.cos(roll_rad / 2), math.sin(roll_rad / 2), math.sin(pitch_rad / 2), 0.0])


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize(
    "pose", [BodyPose(roll_rad=1.0, up_m=0.1), BodyPose(forward_m=1.0), BodyPose(up_m=-1.0)]
)
def test_a_pose_out_of_reach_is_scaled_down_and_leaves_room_to_step(name: str, pose: BodyPose) -> None:
    robot = shipped(name)
    pattern = StepPattern.of(robot, make_gait(robot, "tripod"))
    poser = BodyPoser(robot, (), OVERDRIVE)
    poser.move_to(pose, pattern)
    assert poser.pose_share < 1
    np.testing.assert_allclose(poser.goals, poser.pose_share * pose.array)
    before = solve_legs(robot, robot.stance_feet_body).joint_positions_rad
    for _ in range(500):
        poser.update(PERIOD_S, state(tilted(0.0)), pattern)
        now = solve_legs(robot, poser.feet(robot.stance_feet_body)).joint_positions_rad
        assert (np.abs(now - before) <= 0.5 * PERIOD_S * robot.joint_max_speed_rad_s).all()
        before = now
    assert poser.at_rest
    assert LEAST_STROKE <= poser.stroke_share <= 1
    assert legs_that_reach(robot, poser.feet(robot.stance_feet_body)).all()


def test_bodies_that_give_up_their_goal_stay_as_they_are() -> None:
    robot = shipped("ant")
    pattern, poser = StepPattern.of(robot, make_gait(robot, "tripod")), BodyPoser(robot, (), OVERDRIVE)
    poser.move_to(BodyPose(roll_rad=0.2), pattern)
    poser.update(PERIOD_S, state(tilted(0.0)), pattern)
    there = poser.poses
    poser.give_up_goal()
    poser.update(PERIOD_S, state(tilted(0.0)), pattern)
    assert there[0] > 0
    assert (poser.poses == there).all()


def test_level_bodies_turn_against_the_floor_and_a_batch_equals_single_ones() -> None:
    robot = shipped("ant")
    gait = make_gait(robot, "tripod")
    leans = [(0.05, 0.0), (0.0, 0.1), (1.0, -1.0), (math.nan, 0.0), (0.3, 0.3)]
    patterns = [StepPattern.of(robot, gait), StepPattern.of(robot, [gait] * len(leans))]
    together = BodyPoser(robot, (len(leans),), OVERDRIVE, level=True)
    singles = [BodyPoser(robot, (), OVERDRIVE, level=True) for _ in leans]
    for _ in range(200):
        # Their bodies lean as the floor does, less than they have turned already.
        seen = [
            tilted(roll + float(one.poses[0]), pitch + float(one.poses[1]))
            for one, (roll, pitch) in zip(singles, leans, strict=True)
        ]
        together.update(PERIOD_S, state(np.array(seen)), patterns[1])
        for poser, quaternion in zip(singles, seen, strict=True):
            poser.update(PERIOD_S, state(quaternion), patterns[0])
    assert (together.poses == np.stack([one.poses for one in singles])).all()
    assert (together.stroke_share == np.stack([one.stroke_share for one in singles])).all()
    np.testing.assert_allclose(together.poses[:2, :2], [[-0.05, 0], [0, -0.1]], atol=0.01)
    assert 0.1 < np.abs(together.poses[2, :2]).max() <= MOST_LEVEL_RAD
    assert together.stroke_share.min() >= LEVEL_STROKE, "the last one levels slowly"
    assert legs_that_reach(robot, feet_from_body(robot.stance_feet_body, together.poses[2])).all()
    assert not together.poses[3].any()


def test_levelling_holds_while_the_orientation_is_frozen() -> None:
    robot = shipped("ant")
    gait = make_gait(robot, "tripod")
    patterns = [StepPattern.of(robot, gait), StepPattern.of(robot, [gait] * 2)]
    together, one = (BodyPoser(robot, shape, OVERDRIVE, level=True) for shape in ((2,), ()))
    rolls_rad: list[float] = []
    for tick in range(600):
        frozen, moving = tilted(0.01), tilted(0.01 + 1e-6 * (tick % 2))
        if tick == 599:
            frozen = tilted(0.02)
        together.update(PERIOD_S, state(np.array([frozen, moving])), patterns[1])
        one.update(PERIOD_S, state(frozen), patterns[0])
        rolls_rad.append(float(one.poses[0]))
        assert (together.poses[0] == one.poses).all()
    at_4_s, at_5_s, at_end = rolls_rad[190], rolls_rad[250], rolls_rad[598]
    assert 0 > at_4_s > at_5_s == at_end > together.poses[1, 0]
    assert rolls_rad[599] < at_end, "it levels again"


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_levelling_stays_at_its_limit_and_turns_back_from_it(name: str) -> None:
    robot = shipped(name)
    gait = make_gait(robot, "tripod")
    patterns = [StepPattern.of(robot, gait), StepPattern.of(robot, [gait] * 2)]
    together, one = (BodyPoser(robot, shape, OVERDRIVE, level=True) for shape in ((2,), ()))
    pitches_rad: list[float] = []
    for tick in range(1600):
        slope_rad = 0.5 if tick < 1000 else 0.02 if tick < 1300 else 0.5
        noise_rad = 0.01 * math.sin(tick)
        leans = [slope_rad + noise_rad + float(one.poses[1]), noise_rad]
        seen = np.array([tilted(0.0, lean) for lean in leans])
        together.update(PERIOD_S, state(seen), patterns[1])
        one.update(PERIOD_S, state(seen[0]), patterns[0])
        pitches_rad.append(float(one.poses[1]))
        assert (together.poses[0] == one.poses).all()
    assert np.ptp(pitches_rad[500:1000]) == 0
    assert pitches_rad[500] < -0.05
    assert abs(pitches_rad[1299] + 0.02) < 0.01
    assert abs(pitches_rad[1599] - pitches_rad[500]) < 0.01, "it reaches its limit again"


def test_another_gait_scales_the_pose_again() -> None:
    robot = shipped("pexod")
    gait, poser = make_gait(robot, "tripod"), BodyPoser(robot, (), OVERDRIVE)
    high = replace(gait, posture=Posture(body_raise=0.03))
    shares: list[float] = []
    for one in (gait, high, gait):
        pattern = StepPattern.of(robot, one)
        if not shares:
            poser.move_to(BodyPose(roll_rad=0.2), pattern)
        for _ in range(100):
            poser.update(PERIOD_S, state(tilted(0.0)), pattern)
            assert LEAST_STROKE <= poser.stroke_share <= 1
        shares.append(poser.pose_share)
        assert poser.at_rest
    assert shares[0] == shares[2] > shares[1] > 0


@pytest.mark.slow
def test_a_level_walk_of_a_batch_equals_a_single_one_and_leans_less() -> None:
    trials = [
        sim_trial(gait, world="slope", duration_s=4.0, hold="line", level=level)
        for gait, level in (("tripod", True), ("wave", True), ("tripod", False))
    ]
    first, second, leaning = run_sim_trials(trials)
    assert [first, second] == [run_sim_trial(one) for one in trials[:2]]
    assert first.tilt_deg is not None
    assert leaning.tilt_deg is not None
    assert first.tilt_deg < 3 < leaning.tilt_deg
