"""Scoring, on paths whose distance and deviations are known."""

import json
import math
from dataclasses import replace
from typing import Any

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.plan import TrialPlan
from hexctl.control.result import Deviation, TrialResult, score
from hexctl.control.trace import TrialFrame
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray
from tests.robots import shipped
from tests.trials import gait_of

SPEED = 0.1485
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def _turned(yaws: FloatArray) -> FloatArray:
    zeros = np.zeros_like(yaws)
    return np.stack([np.cos(yaws / 2), zeros, zeros, np.sin(yaws / 2)], axis=-1)


def _score(
    path: FloatArray, *, heading: float = 0.0, yaws: FloatArray | None = None, status: str = "ok", **plan: Any
) -> TrialResult:
    """Score a path given in the trial frame, (T, 2), of a walk somewhere in the world."""
    origin = np.array([3.0, -2.0, 0.12])
    cos, sin = math.cos(heading), math.sin(heading)
    turned = path @ np.array([[cos, sin], [-sin, cos]])
    world = np.column_stack([turned + origin[:2], np.full(len(path), 0.1) + plan.pop("heights", 0.0)])
    quaternions = np.tile(UPRIGHT, (len(path), 1)) if yaws is None else _turned(yaws)
    duration_s, turned_rad = plan.pop("duration_s", 10.0), plan.pop("turned_rad", 0.0)
    hold, energy_j = plan.pop("hold", "none"), plan.pop("energy_j", None)
    return score(
        shipped(),
        TrialPlan(gait=gait_of(shipped()), **plan),
        status=status,
        duration_s=duration_s,
        turned_rad=turned_rad,
        clipped_ticks=3,
        hold=hold,
        energy_j=energy_j,
        frame=TrialFrame(origin, heading, 0.0 if yaws is None else float(yaws[0])),
        positions_world=world,
        quaternions_world=quaternions,
    )


def _along(distance: float, off: FloatArray) -> FloatArray:
    return np.column_stack([np.linspace(0, distance, len(off)), off])


@pytest.mark.parametrize("heading_deg", [0, 33, 90, 180, -120])
def test_distance_and_deviations_of_a_known_path_in_any_direction(heading_deg: float) -> None:
    off = np.array([0.0, 0.1, -0.3, -0.2, 0.05, -0.15])
    result = _score(_along(1.2, off), heading=math.radians(heading_deg))
    assert result.distance_m == pytest.approx(1.2)
    assert result.deviation is not None
    assert result.deviation.final == pytest.approx(0.15)
    assert result.deviation.signed == pytest.approx(-0.15)
    assert result.deviation.max == pytest.approx(0.3)
    assert result.deviation.mean == pytest.approx((0 + 0.1 + 0.3 + 0.2 + 0.05 + 0.15) / 6)
    np.testing.assert_allclose(result.path_m, _along(1.2, off), atol=1e-12)
    assert result.clipped_ticks == 3


@given(off=st.lists(st.floats(-5, 5), min_size=1, max_size=30))
def test_deviations_are_what_their_names_say(off: list[float]) -> None:
    deviation = _score(_along(1.2, np.array(off))).deviation
    assert deviation is not None
    assert deviation.final == pytest.approx(abs(deviation.signed))
    assert deviation.mean <= deviation.max + 1e-12
    assert deviation.final <= deviation.max + 1e-12


@pytest.mark.parametrize("turned_deg", [-1000, -350, -180, -10, 0, 90, 180, 359, 725])
def test_yaw_counts_whole_turns(turned_deg: float) -> None:
    yaws = np.radians(np.linspace(20, 20 + turned_deg, 400))
    result = _score(_along(1.2, np.zeros(400)), yaws=yaws)
    assert math.degrees(result.yaw_change_rad or 0.0) == pytest.approx(turned_deg, abs=1e-6)
    assert result.to_dict()["yaw_change_deg"] == pytest.approx(turned_deg, abs=1e-6)


def test_the_ideal_distance_is_the_papers() -> None:
    assert _score(_along(1.2, np.zeros(3)), duration_s=30.0).ideal_distance_m == pytest.approx(4.455)


@pytest.mark.parametrize(
    ("share", "status"), [(0.49, "no_progress"), (0.51, "ok"), (0.0, "no_progress"), (-1.0, "no_progress")]
)
def test_less_than_half_the_ideal_distance_is_no_progress(share: float, status: str) -> None:
    # The soft start takes one second of full stride away.
    distance = share * SPEED * (10.0 - 1.0)
    result = _score(_along(distance, np.zeros(5)))
    assert result.status == status
    assert result.valid == (status == "ok")


@pytest.mark.parametrize(("share", "status"), [(0.49, "no_progress"), (0.51, "ok")])
def test_the_floor_allows_for_the_soft_start(share: float, status: str) -> None:
    distance = share * SPEED * (3.0 - 1.0)  # a ramp of two seconds loses one
    assert _score(_along(distance, np.zeros(5)), duration_s=3.0).status == status


def test_a_walk_shorter_than_its_soft_start_has_no_floor() -> None:
    assert _score(_along(0.0, np.zeros(5)), duration_s=1.9).status == "ok"
    assert _score(_along(0.0, np.zeros(5)), duration_s=2.1).status == "no_progress"


@pytest.mark.parametrize("plan", [{"travel": 0.0}, {"turn_rate_rad_s": 0.2}])
def test_a_walk_that_is_not_meant_to_be_straight_has_no_floor(plan: dict[str, Any]) -> None:
    assert _score(_along(0.0, np.zeros(5)), **plan).status == "ok"


@pytest.mark.parametrize("status", ["fell", "diverged", "aborted"])
def test_a_walk_that_ended_badly_stays_bad_however_far_it_went(status: str) -> None:
    result = _score(_along(2.0, np.zeros(5)), status=status)
    assert result.status == status
    assert not result.valid
    assert result.distance_m == pytest.approx(2.0)


def test_the_numbers_are_plain_json_with_the_promised_keys() -> None:
    numbers = _score(_along(1.2, np.array([0.0, 0.1]))).to_dict()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert set(numbers) >= {
        "duration_s",
        "distance_m",
        "deviation_m",
        "yaw_change_deg",
        "status",
        "stopped",
        "self_rotation_deg",
        "clipped_ticks",
    }
    assert set(numbers["deviation_m"]) == {"final", "mean", "max", "signed"}


def test_a_robot_that_never_set_out_has_no_distance() -> None:
    result = _score(np.zeros((0, 2)), status="fell")
    assert (result.distance_m, result.deviation, result.yaw_change_rad) == (None, None, None)
    json.dumps(result.to_dict(), allow_nan=False)


def test_results_compare_by_value_and_travel_as_json() -> None:
    one = _score(_along(1.2, np.array([0.0, 0.1])))
    other = _score(_along(1.2, np.array([0.0, 0.1])))
    assert one == other
    assert one != replace(one, path_m=one.path_m + 1e-12)
    assert one != replace(one, status="fell")
    back = TrialResult.from_dict(json.loads(json.dumps(one.to_dict(path=True), allow_nan=False)))
    assert back.to_dict(path=True) == one.to_dict(path=True)
    assert back.deviation == one.deviation
    assert TrialResult.from_dict(one.to_dict()).path_m.shape == (0, 2)


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
    assert _score(_along(1.2, np.array([0.0, 0.1]))).true_path_m is None


def test_a_result_that_knows_nothing_travels_as_json_too() -> None:
    one = _score(_along(1.2, np.array([0.0, 0.1])))
    partly = replace(one, deviation=Deviation(0.1, float("nan"), float("nan"), 0.1), yaw_change_rad=None)
    for result in (partly, replace(one, deviation=None, distance_m=None, path_m=np.zeros((0, 2)))):
        data = json.loads(json.dumps(result.to_dict(path=True), allow_nan=False))
        assert TrialResult.from_dict(data).deviation == result.deviation
        assert TrialResult.from_dict(data).to_dict(path=True) == data


@pytest.mark.parametrize("data", [{}, {"status": "ok"}, 3, None])
def test_what_is_no_result_is_refused_in_one_line(data: object) -> None:
    with pytest.raises(InputError, match=r"trial result: cannot be read .* allowed: what `to_dict` gives"):
        TrialResult.from_dict(data)  # type: ignore[arg-type]


def test_a_result_is_one_line_and_can_be_drawn() -> None:
    matplotlib.use("Agg")
    result = _score(_along(1.2, np.array([0.0, 0.1])))
    assert "\n" not in repr(result)
    assert repr(result).startswith("TrialResult(")
    ax = result.plot()
    np.testing.assert_array_equal(ax.lines[1].get_xydata(), result.path_m)
    assert result.plot(ax) is ax


@pytest.mark.parametrize(("turned_deg", "miss_deg"), [(60.0, 0.0), (61.5, 1.5), (-299.0, 1.0)])
def test_a_self_rotation_that_misses_its_goal_says_so(turned_deg: float, miss_deg: float) -> None:
    """Leg 3 of ant points to 120 degrees: it trails after a turn by 60."""
    result = _score(
        _along(1.2, np.zeros(5)), belief=Failure(leg=3), turned_rad=math.radians(turned_deg), duration_s=1.0
    )
    assert result.turn_miss_rad == pytest.approx(math.radians(miss_deg), abs=1e-9)
    again = TrialResult.from_dict(result.to_dict(path=True))
    assert again.turn_miss_rad == pytest.approx(result.turn_miss_rad)
    assert _score(_along(1.2, np.zeros(5))).turn_miss_rad is None
    old = result.to_dict()
    del old["turn_miss_deg"]
    assert TrialResult.from_dict(old).turn_miss_rad is None


def test_a_frozen_pose_is_not_measured_and_nothing_is_judged_by_it() -> None:
    ticks = 500
    moving = _along(1.2, 0.001 * np.sin(np.arange(ticks)))
    frozen = moving.copy()
    frozen[100:] = frozen[99]
    result = _score(frozen, yaws=np.zeros(ticks), hold="line")
    assert (result.status, result.cause, result.distance_m, result.deviation) == ("ok", None, None, None)
    assert result.hold_lost_s == pytest.approx(8.0)
    frozen[450:] = moving[450:]
    result = _score(frozen, hold="line")
    assert result.distance_m == pytest.approx(1.2)
    assert result.hold_lost_s == pytest.approx(7.0)
    assert np.isnan(result.path_m[100:450]).all()


def test_a_pose_that_freezes_shortly_counts() -> None:
    path = _along(1.2, np.zeros(500))
    path[100:300] = path[99]
    assert _score(path, hold="line").hold_lost_s == 0.0
    path[200] = np.nan  # a dropout does not end it
    path[300] = path[99]
    assert _score(path, hold="line").hold_lost_s == 0.0, "nor does it belong to it"
    path[301] = path[99]
    assert _score(path, hold="line").hold_lost_s == pytest.approx(202 * 0.02)


def test_a_position_freezes_by_where_it_is_whatever_its_height_does() -> None:
    path = _along(1.2, np.zeros(500))
    path[100:] = path[99]
    result = _score(path, hold="line", heights=0.1 + 0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m) == ("ok", None)
    assert result.hold_lost_s == pytest.approx(8.0)


def test_a_walk_that_shows_one_position_from_its_start_on_makes_no_progress() -> None:
    """A robot that stands, on odometry that counts millimetres."""
    still = np.zeros((500, 2))
    result = _score(still, yaws=0.001 * np.sin(np.arange(500)))
    assert (result.status, result.distance_m, result.deviation) == ("no_progress", None, None)
    assert _score(still, status="fell").status == "fell"
    assert _score(still, travel=0.0, turn_rate_rad_s=1.0).status == "ok"
    still[1:] = np.nan
    assert _score(still).status == "ok", "nothing is known of it"
    still[:] = np.nan
    assert _score(still).status == "ok"


@pytest.mark.parametrize("plan", [{"travel": 0.0, "turn_rate_rad_s": 1.0}, {"turn_rate_rad_s": 0.3}])
def test_a_turn_has_no_cost_of_transport(plan: dict[str, Any]) -> None:
    path = _along(0.1, np.zeros(5))
    assert _score(path, energy_j=5.0).cost_of_transport is not None
    assert _score(path, energy_j=5.0, **plan).cost_of_transport is None
