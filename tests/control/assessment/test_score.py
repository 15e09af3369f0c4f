"""Scoring, on paths whose distance and deviations are known."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.assessment.score import score
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.robot.failure import Failure
from tests.control.assessment.scores import UPRIGHT, along, scored
from tests.robots import shipped
from tests.trials import gait_of

SPEED = 0.1485


@pytest.mark.parametrize("heading_deg", [0, 33, 90, 180, -120])
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


@pytest.mark.parametrize("turned_deg", [-1000, -350, -180, -10, 0, 90, 180, 359, 725])
def test_yaw_counts_whole_turns(turned_deg: float) -> None:
    yaws = np.radians(np.linspace(20, 20 + turned_deg, 400))
    result = scored(along(1.2, np.zeros(400)), yaws=yaws)
    assert math.degrees(result.yaw_change_rad or 0.0) == pytest.approx(turned_deg, abs=1e-6)
    assert result.to_dict()["yaw_change_deg"] == pytest.approx(turned_deg, abs=1e-6)


def test_the_ideal_distance_is_the_papers() -> None:
    assert scored(along(1.2, np.zeros(3)), duration_s=30.0).ideal_distance_m == pytest.approx(4.455)


@pytest.mark.parametrize(
    ("share", "status"), [(0.49, "no_progress"), (0.51, "ok"), (0.0, "no_progress"), (-1.0, "no_progress")]
)
def test_less_than_half_the_ideal_distance_is_no_progress(share: float, status: str) -> None:
    # The soft start takes one second of full stride away.
    distance = share * SPEED * (10.0 - 1.0)
    result = scored(along(distance, np.zeros(5)))
    assert result.status == status
    assert result.valid == (status == "ok")


@pytest.mark.parametrize(("share", "status"), [(0.49, "no_progress"), (0.51, "ok")])
def test_the_floor_allows_for_the_soft_start(share: float, status: str) -> None:
    distance = share * SPEED * (3.0 - 1.0)  # a ramp of two seconds loses one
    assert scored(along(distance, np.zeros(5)), duration_s=3.0).status == status


def test_a_walk_shorter_than_its_soft_start_has_no_floor() -> None:
    assert scored(along(0.0, np.zeros(5)), duration_s=1.9).status == "ok"
    assert scored(along(0.0, np.zeros(5)), duration_s=2.1).status == "no_progress"


@pytest.mark.parametrize("plan", [{"travel": 0.0}, {"turn_rate_rad_s": 0.2}])
def test_a_walk_that_is_not_meant_to_be_straight_has_no_floor(plan: dict[str, Any]) -> None:
    assert scored(along(0.0, np.zeros(5)), **plan).status == "ok"


@pytest.mark.parametrize("status", ["fell", "diverged", "aborted"])
def test_a_walk_that_ended_badly_stays_bad_however_far_it_went(status: str) -> None:
    result = scored(along(2.0, np.zeros(5)), status=status)
    assert result.status == status
    assert not result.valid
    assert result.distance_m == pytest.approx(2.0)


def test_a_robot_that_never_set_out_has_no_distance() -> None:
    result = scored(np.zeros((0, 2)), status="fell")
    assert (result.distance_m, result.deviation, result.yaw_change_rad) == (None, None, None)
    json.dumps(result.to_dict(), allow_nan=False)


def test_the_true_path_is_from_the_same_line_by_where_the_robot_was() -> None:
    measured_world = np.array([[1.0, 2.0, 0.0], [1.1, 3.9, 0.0]])
    result = score(
        shipped(),
        TrialPlan(gait=gait_of(shipped())),
        status="ok",
        duration_s=0.04,
        turned_rad=0.0,
        clipped_ticks=0,
        frame=TrialFrame(measured_world[0], math.pi / 2, 0.0),
        positions_world=measured_world,
        quaternions_world=np.tile(UPRIGHT, (2, 1)),
        true_positions_world=np.array([[1.0, 2.0, 0.0], [0.7, 4.0, 0.0]]),
    )
    assert result.true_path_m is not None
    np.testing.assert_allclose(result.true_path_m, [[0.0, 0.0], [2.0, 0.3]], atol=1e-12)
    assert result.true_deviation is not None
    assert result.true_deviation.signed == pytest.approx(0.3)
    assert scored(along(1.2, np.array([0.0, 0.1]))).true_path_m is None


@pytest.mark.parametrize(("turned_deg", "miss_deg"), [(60.0, 0.0), (61.5, 1.5), (-299.0, 1.0)])
def test_a_self_rotation_that_misses_its_goal_says_so(turned_deg: float, miss_deg: float) -> None:
    """Leg 3 of ant points to 120 degrees: it trails after a turn by 60."""
    result = scored(
        along(1.2, np.zeros(5)), belief=Failure(leg=3), turned_rad=math.radians(turned_deg), duration_s=1.0
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


def test_a_pose_that_freezes_shortly_counts() -> None:
    path = along(1.2, np.zeros(500))
    path[100:300] = path[99]
    assert scored(path, hold="line").hold_lost_s == 0.0
    path[200] = np.nan  # a dropout does not end it
    path[300] = path[99]
    assert scored(path, hold="line").hold_lost_s == 0.0, "nor does it belong to it"
    path[301] = path[99]
    assert scored(path, hold="line").hold_lost_s == pytest.approx(202 * 0.02)


def test_a_position_freezes_by_where_it_is_whatever_its_height_does() -> None:
    path = along(1.2, np.zeros(500))
    path[100:] = path[99]
    result = scored(path, hold="line", heights=0.1 + 0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m) == ("ok", None)
    assert result.hold_lost_s == pytest.approx(8.0)


def test_a_walk_that_shows_one_position_from_its_start_on_makes_no_progress() -> None:
    """A robot that stands, on odometry that counts millimetres."""
    still = np.zeros((500, 2))
    result = scored(still, yaws=0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m, result.deviation) == ("no_progress", None, None)
    assert scored(still, status="fell").status == "fell"
    assert scored(still, travel=0.0, turn_rate_rad_s=1.0).status == "ok"
    still[1:] = np.nan
    assert scored(still).status == "ok", "nothing is known of it"
    still[:] = np.nan
    assert scored(still).status == "ok"


@pytest.mark.parametrize("plan", [{"travel": 0.0, "turn_rate_rad_s": 1.0}, {"turn_rate_rad_s": 0.3}])
def test_a_turn_has_no_cost_of_transport(plan: dict[str, Any]) -> None:
    path = along(0.1, np.zeros(5))
    assert scored(path, energy_j=5.0).cost_of_transport is not None
    assert scored(path, energy_j=5.0, **plan).cost_of_transport is None
