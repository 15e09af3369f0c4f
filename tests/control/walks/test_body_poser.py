"""Bodies that move over the feet of a walk: reach, speed, levelling, and batches."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.body_poser import LEAST_STROKE, LEVEL_STROKE, MOST_LEVEL_RAD, BodyPoser
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.gait.body_pose import BodyPose, feet_from_body
from hexctl.gait.foot_trajectory import StepPattern
from hexctl.gait.gait import make_gait
from hexctl.gait.posture import Posture
from hexctl.ik.legs import legs_that_reach, solve_legs
from hexctl.types import FloatArray, RobotState
from tests.robots import ROBOT_NAMES, shipped

DT_S = 0.02


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
        poser.update(DT_S, state(tilted(0.0)), pattern)
        now = solve_legs(robot, poser.feet(robot.stance_feet_body)).joint_positions_rad
        assert (np.abs(now - before) <= 0.5 * DT_S * robot.joint_max_speed_rad_s).all()
        before = now
    assert poser.at_rest
    assert LEAST_STROKE <= poser.stroke_share <= 1
    assert legs_that_reach(robot, poser.feet(robot.stance_feet_body)).all()


def test_frozen_bodies_stay_and_give_up_their_goal() -> None:
    robot = shipped("ant")
    pattern, poser = StepPattern.of(robot, make_gait(robot, "tripod")), BodyPoser(robot, (), OVERDRIVE)
    poser.move_to(BodyPose(roll_rad=0.2), pattern)
    poser.update(DT_S, state(tilted(0.0)), pattern)
    there = poser.poses
    poser.frozen = True
    poser.update(DT_S, state(tilted(0.5)), pattern)
    poser.frozen = False
    poser.update(DT_S, state(tilted(0.0)), pattern)
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
        together.update(DT_S, state(np.array(seen)), patterns[1])
        for poser, quaternion in zip(singles, seen, strict=True):
            poser.update(DT_S, state(quaternion), patterns[0])
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
        together.update(DT_S, state(np.array([frozen, moving])), patterns[1])
        one.update(DT_S, state(frozen), patterns[0])
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
        together.update(DT_S, state(seen), patterns[1])
        one.update(DT_S, state(seen[0]), patterns[0])
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
            poser.update(DT_S, state(tilted(0.0)), pattern)
            assert LEAST_STROKE <= poser.stroke_share <= 1
        shares.append(poser.pose_share)
        assert poser.at_rest
    assert shares[0] == shares[2] > shares[1] > 0


@pytest.mark.slow
def test_a_level_walk_of_a_batch_equals_a_single_one_and_leans_less() -> None:
    robot = shipped("ant")

    def trial(gait: str, *, level: bool) -> SimTrial:
        plan = TrialPlan(gait=make_gait(robot, gait), duration_s=4.0, hold="line", level=level)
        return SimTrial(robot=robot, plan=plan, failure=None, world="slope")

    trials = [trial("tripod", level=True), trial("wave", level=True), trial("tripod", level=False)]
    first, second, leaning = run_sim_trials(trials)
    assert [first, second] == [run_sim_trial(one) for one in trials[:2]]
    assert first.tilt_deg is not None
    assert leaning.tilt_deg is not None
    assert first.tilt_deg < 3 < leaning.tilt_deg
