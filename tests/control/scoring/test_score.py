"""Scoring: distance and deviations of known paths, energy and steadiness, and why a walk made no progress."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import Failure, RobotState, TrialPlan, TrialResult, World
from hexctl.control.scoring.cause import Symptoms, WalkSamples
from hexctl.control.scoring.score import progress_floor_m, score
from hexctl.control.scoring.walk_quality import (
    BLOCK_TICKS,
    RAMP_TICKS,
    WalkEffort,
    cost_of_transport,
    lean_deg,
    unsteadiness_m_s,
)
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import GaitChange
from hexctl.robot.rotations import quaternion_of_euler
from hexctl.types import FloatArray
from tests.control.checks.loads import along, changed, scored
from tests.robots import shipped
from tests.trials import gait_of, walk

SPEED = 0.1485


@pytest.mark.parametrize("heading_deg", [0, 33, -120])
def test_distance_and_deviations_of_a_known_path_in_any_direction(heading_deg: float) -> None:
    off = np.array([0.0, 0.1, -0.3, -0.2, 0.05, -0.15])
    result = scored(along(1.2, off), heading=math.radians(heading_deg))
    assert result.distance_m == pytest.approx(1.2)
    assert result.deviation is not None
    assert result.deviation.final == pytest.approx(0.15)
    assert result.deviation.signed == pytest.approx(-0.15)
    assert result.deviation.max == pytest.approx(0.3)
    assert result.deviation.mean == pytest.approx((0 + 0.1 + 0.3 + 0.2 + 0.05 + 0.15) / 6)
    np.testing.assert_allclose(result.path_m, along(1.2, off), atol=1e-12)
    assert result.clipped_ticks == 3


@given(off=st.lists(st.floats(-5, 5), min_size=1, max_size=30))
def test_deviations_are_what_their_names_say(off: list[float]) -> None:
    deviation = scored(along(1.2, np.array(off))).deviation
    assert deviation is not None
    assert deviation.final == pytest.approx(abs(deviation.signed))
    assert deviation.mean <= deviation.max + 1e-12
    assert deviation.final <= deviation.max + 1e-12


@pytest.mark.parametrize("turned_deg", [-1000, -180, 0, 90, 359])
def test_yaw_counts_whole_turns(turned_deg: float) -> None:
    yaws = np.radians(np.linspace(20, 20 + turned_deg, 400))
    result = scored(along(1.2, np.zeros(400)), yaws=yaws)
    assert math.degrees(result.yaw_change_rad or 0.0) == pytest.approx(turned_deg, abs=1e-6)
    assert result.to_dict()["yaw_change_deg"] == pytest.approx(turned_deg, abs=1e-6)


@pytest.mark.parametrize(
    ("distance_m", "plan", "status"),
    [
        (0.49 * 9.0 * SPEED, {}, "no_progress"),  # the soft start takes one second of full stride away
        (0.51 * 9.0 * SPEED, {}, "ok"),
        (-9.0 * SPEED, {}, "no_progress"),
        (0.51 * 2.0 * SPEED, {"duration_s": 3.0}, "ok"),
        (0.0, {"duration_s": 1.9}, "ok"),  # shorter than its soft start
        (0.0, {"duration_s": 2.1}, "no_progress"),
        (0.0, {"travel": 0.0}, "ok"),  # not meant to be straight
        (0.0, {"turn_rate_rad_s": 0.2}, "ok"),
        (2.0, {"status": "fell"}, "fell"),  # a walk that ended badly stays bad however far it went
    ],
)
def test_less_than_half_the_ideal_distance_is_no_progress(
    distance_m: float, plan: dict[str, Any], status: str
) -> None:
    result = scored(along(distance_m, np.zeros(5)), **plan)
    assert (result.status, result.valid) == (status, status == "ok")
    assert result.distance_m == pytest.approx(distance_m)


def test_a_change_to_the_same_gait_asks_for_the_same_progress() -> None:
    plan = TrialPlan(gait=gait_of(shipped(), "tripod"), duration_s=10.0)
    changed_plan = replace(plan, changes=(GaitChange(gait=plan.gait, at_s=5.0),))
    least_m = progress_floor_m(shipped(), plan, 10.0)
    assert progress_floor_m(shipped(), changed_plan, 10.0) == pytest.approx(least_m)


def test_the_ideal_distance_is_the_papers_and_one_that_never_set_out_has_none() -> None:
    assert scored(along(1.2, np.zeros(3)), duration_s=30.0).ideal_distance_m == pytest.approx(4.455)
    result = scored(np.zeros((0, 2)), status="fell")
    assert (result.distance_m, result.deviation, result.yaw_change_rad) == (None, None, None)
    json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.parametrize(("turned_deg", "miss_deg"), [(60.0, 0.0), (61.5, 1.5), (-299.0, 1.0)])
def test_a_self_rotation_that_misses_its_goal_says_so(turned_deg: float, miss_deg: float) -> None:
    """Leg 3 of ant points to 120 degrees: it trails after a turn by 60."""
    result = scored(
        along(1.2, np.zeros(5)),
        failures=(Failure(leg=3),),
        turned_rad=math.radians(turned_deg),
        duration_s=1.0,
    )
    assert result.turn_miss_rad == pytest.approx(math.radians(miss_deg), abs=1e-9)
    again = TrialResult.from_dict(result.to_dict(path=True))
    assert again.turn_miss_rad == pytest.approx(result.turn_miss_rad)
    assert scored(along(1.2, np.zeros(5))).turn_miss_rad is None


def test_a_frozen_pose_is_not_measured_and_nothing_is_judged_by_it() -> None:
    ticks = 500
    moving = along(1.2, 0.001 * np.sin(np.arange(ticks)))
    frozen = moving.copy()
    frozen[100:] = frozen[99]
    result = scored(frozen, yaws=np.zeros(ticks), hold="line")
    assert (result.status, result.cause, result.distance_m, result.deviation) == ("ok", None, None, None)
    assert result.hold_lost_s == pytest.approx(8.0)
    frozen[450:] = moving[450:]
    result = scored(frozen, hold="line")
    assert result.distance_m == pytest.approx(1.2)
    assert result.hold_lost_s == pytest.approx(7.0)
    assert np.isnan(result.path_m[100:450]).all()


def test_a_position_freezes_by_where_it_is_and_one_that_never_changes_is_no_progress() -> None:
    path = along(1.2, np.zeros(500))
    path[100:] = path[99]
    result = scored(path, hold="line", heights=0.1 + 0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m) == ("ok", None)
    assert result.hold_lost_s == pytest.approx(8.0)
    still = np.zeros((500, 2))  # a robot that stands, on odometry that counts millimetres
    result = scored(still, yaws=0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m, result.deviation) == ("no_progress", None, None)
    assert scored(still, status="fell").status == "fell"
    assert scored(still, travel=0.0, turn_rate_rad_s=1.0).status == "ok"
    still[1:] = np.nan
    assert scored(still).status == "ok", "nothing is known of it"


# Energy and steadiness


def state(angle_rad: float, torque_nm: float | None) -> RobotState:
    torques_nm = None if torque_nm is None else np.full(18, torque_nm)
    return RobotState(np.full(18, angle_rad), 0.0, True, joint_torques_nm=torques_nm)


@pytest.mark.parametrize("ticks", [BLOCK_TICKS + 1, 3 * BLOCK_TICKS + 7])
def test_a_torque_works_along_its_way_and_what_a_joint_brakes_does_not_count(ticks: int) -> None:
    effort = WalkEffort()
    for tick in range(ticks):
        effort.add(state(math.sin(0.2 * tick), 2.0), np.zeros(18))
    rises = np.maximum(np.diff(np.sin(0.2 * np.arange(ticks))), 0).sum()
    assert effort.energy_j() == pytest.approx(18 * 2.0 * rises)


def test_without_all_torques_no_energy_is_known() -> None:
    for torques_nm in ((1.0, None, 1.0), (1.0, math.nan, 1.0)):
        effort = WalkEffort()
        assert effort.energy_j() is None
        for tick, torque_nm in enumerate(torques_nm):
            effort.add(state(0.1 * tick, torque_nm), np.zeros(18))
        assert effort.energy_j() is None


def test_a_robot_of_a_batch_counts_while_it_walks() -> None:
    both, alone = WalkEffort((2,)), WalkEffort()
    rng = np.random.default_rng(0)
    for tick in range(200):
        torques_nm, angles_rad = rng.normal(size=(2, 18)), rng.normal(size=(2, 18))
        if tick < 90:
            alone.add(RobotState(angles_rad[1], 0.0, True, joint_torques_nm=torques_nm[1]), np.zeros(18))
        else:
            torques_nm[1] = np.nan  # what a simulation that diverged says
        state = RobotState(angles_rad, 0.0, True, joint_torques_nm=torques_nm)
        both.add(state, np.zeros((2, 18)), np.array([True, tick < 90]))
    assert both.energy_j((1,)) == alone.energy_j()


def test_cost_of_transport_is_per_weight_and_metre_of_a_straight_walk() -> None:
    ant, path = shipped(), along(0.1, np.zeros(5))
    assert cost_of_transport(ant, 9.81 * ant.mass_kg, 2.0) == pytest.approx(0.5)
    for energy_j, distance_m in ((None, 1.0), (1.0, None), (1.0, 0.0), (1.0, -0.2)):
        assert cost_of_transport(ant, energy_j, distance_m) is None
    assert scored(path, energy_j=5.0).cost_of_transport is not None
    turns: list[dict[str, Any]] = [{"travel": 0.0, "turn_rate_rad_s": 1.0}, {"turn_rate_rad_s": 0.3}]
    for turn in turns:
        assert scored(path, energy_j=5.0, **turn).cost_of_transport is None


def leaning(roll_rad: FloatArray, yaw_rad: float) -> FloatArray:
    """Quaternions of a roll after a yaw."""
    return np.array([quaternion_of_euler(roll, 0.0, yaw_rad) for roll in roll_rad])


def test_lean_is_the_rms_angle_of_the_bodys_vertical_whatever_the_yaw() -> None:
    roll_rad = np.full(200, 0.7)
    roll_rad[RAMP_TICKS:] = np.radians(np.tile([3.0, -4.0], 100)[: 200 - RAMP_TICKS])
    for yaw_rad in (0.0, 2.0):
        rows = leaning(roll_rad, yaw_rad)
        assert lean_deg(rows) == pytest.approx(math.sqrt(12.5), rel=0.01)
        rows[::3] = np.nan
        assert lean_deg(rows) == pytest.approx(math.sqrt(12.5), rel=0.05)
    assert lean_deg(np.full((200, 4), np.nan)) is None
    assert lean_deg(leaning(roll_rad[:RAMP_TICKS], 0.0)) is None


def test_even_motion_is_steady_and_swaying_is_not() -> None:
    time_s = 0.02 * np.arange(1000 + RAMP_TICKS)
    even = np.stack([0.1 * time_s, -0.02 * time_s, 0 * time_s], axis=-1)
    assert unsteadiness_m_s(even) == pytest.approx(0.0, abs=1e-9)
    omega = 2 * math.pi * 0.5
    swaying = even + np.stack([0 * time_s, 0 * time_s, 0.01 * np.sin(omega * time_s)], axis=-1)
    assert unsteadiness_m_s(swaying) == pytest.approx(0.01 * omega / math.sqrt(2), rel=0.02)
    swaying[100:110] = np.nan
    assert unsteadiness_m_s(swaying) == pytest.approx(0.01 * omega / math.sqrt(2), rel=0.03)
    assert unsteadiness_m_s(np.full((500, 3), np.nan)) is None
    assert unsteadiness_m_s(even[:3]) is None


# Why a walk made no progress


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "name", "change", "world", "failure"),
    [
        ("saturation", "ant", {"torque": 0.025}, World(), None),
        ("sag", "pexod", {"stiffness": 0.05}, World(), Failure(leg=5)),
        ("trunk", "pexod", {"trunk_m": 0.4}, World(), None),
        ("clipping", "phantomx", {"speed": 0.05}, World(), None),
        ("slip", "ant", {}, World(friction=0.19, slope_deg=10), Failure(leg=5)),
        (None, "ant", {}, World(), None),
    ],
)
def test_the_cause_is_named(
    cause: str | None, name: str, change: dict[str, float], world: World, failure: Failure | None
) -> None:
    result = walk(robot=changed(name, **change), world=world, failure=failure, duration_s=5.0).result
    assert (result.status, result.cause) == ("no_progress" if cause else "ok", cause)
    assert TrialResult.from_dict(result.to_dict()).cause == cause


def test_joints_that_are_not_measured_tell_nothing() -> None:
    samples = WalkSamples(100)
    echoed = RobotState(np.zeros(18), 0.0, False, foot_contacts=np.ones(6, dtype=bool))
    for _ in range(100):
        samples.add(echoed, np.zeros(18))
    assert samples.of(100) is None


@pytest.mark.parametrize(
    ("saturated", "tracking_error", "slip", "cause"),
    [
        (0.51, 2.0, 3.0, "saturation"),  # torque limits come before soft servos and those before the floor
        (0.49, 0.43, 3.0, "sag"),
        (0.0, 0.41, 0.41, "slip"),
        (0.49, 0.41, 0.39, None),
        (0.49, 0.41, 3.0, "trunk"),
    ],
)
def test_a_cause_begins_at_its_bound(
    saturated: float, tracking_error: float, slip: float, cause: str | None
) -> None:
    grounded = 0.51 if cause == "trunk" else 0.49
    assert Symptoms(saturated, tracking_error, slip, grounded=grounded).cause == cause


def test_the_true_path_is_from_the_true_line_by_where_the_robot_was() -> None:
    measured_world = np.array([[1.0, 2.0, 0.0], [1.1, 3.9, 0.0]])
    result = score(
        shipped(),
        TrialPlan(gait=gait_of(shipped())),
        status="ok",
        duration_s=0.04,
        turned_rad=0.0,
        clipped_ticks=0,
        frame=TrialFrame(measured_world[0], 1.5, 0.0),
        positions_world=measured_world,
        quaternions_world=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        true_frame=TrialFrame(np.array([1.0, 2.0, 0.0]), math.pi / 2, 0.0),
        true_positions_world=np.array([[1.0, 2.0, 0.0], [0.7, 4.0, 0.0]]),
    )
    assert result.true_path_m is not None
    np.testing.assert_allclose(result.true_path_m, [[0.0, 0.0], [2.0, 0.3]], atol=1e-12)
    assert result.true_deviation is not None
    assert result.true_deviation.signed == pytest.approx(0.3)
    assert scored(along(1.2, np.array([0.0, 0.1]))).true_path_m is None
