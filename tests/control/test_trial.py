"""Trials from settling to stopping: straightness, headings, turning, every robot with every failure."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.robot.failure import FAILURE_KINDS, Failure
from hexctl.robot.loader import load_robot
from hexctl.types import JointTargets
from tests.control.posed import PosedMock
from tests.robots import ROBOT_NAMES, edited_file, put, shipped
from tests.trials import gait_of, walk

#: Directions of six legs around the body (x, y), how high they begin, and their yaws.
UNEVEN_MOUNTS = [
    (math.cos(math.radians(yaw)), math.sin(math.radians(yaw)), z, yaw)
    for yaw, z in ((0, 0.0), (60, 0.015), (120, -0.01), (180, 0.02), (240, 0.0), (300, -0.015))
]


def _all_finite(result: TrialResult) -> bool:
    """Whether the numbers of a result survive strict JSON, which knows no NaN."""
    json.dumps(result.to_dict(), allow_nan=False)
    return bool(np.isfinite(result.path_m).all())


def test_the_demo_gait_walks_half_a_minute_nearly_straight() -> None:
    result = walk("demo", duration_s=30).result
    assert result.status == "ok"
    assert result.ideal_distance_m == pytest.approx(4.455)
    assert result.distance_m is not None
    assert result.deviation is not None
    assert 0.85 * 4.455 <= result.distance_m <= 4.455
    assert result.deviation.final <= 0.35
    assert result.duration_s == pytest.approx(30)


def test_the_tripod_walks_half_a_minute_straight() -> None:
    result = walk("tripod", duration_s=30).result
    assert result.status == "ok"
    assert result.distance_m is not None
    assert result.deviation is not None
    assert result.distance_m >= 0.85 * 4.455
    assert result.deviation.max <= 0.02
    assert result.yaw_change_rad == pytest.approx(0, abs=math.radians(1))


@pytest.mark.parametrize("heading_deg", [0, 60, 90, 137, 180, 270])
def test_it_walks_along_the_heading_that_it_is_given(heading_deg: float) -> None:
    outcome = walk("tripod", heading_rad=math.radians(heading_deg), duration_s=10)
    walked = outcome.log["base_position_world"][outcome.log.rows_of("walk")]
    way = walked[-1] - walked[0]
    off = math.degrees(math.atan2(way[1], way[0])) - heading_deg
    assert math.remainder(off, 360) == pytest.approx(0, abs=5)
    result = outcome.result
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.distance_m == pytest.approx(math.hypot(way[0], way[1]), rel=0.01), "the frame lies along it"
    assert abs(result.deviation.signed) < math.tan(math.radians(5)) * float(result.distance_m or 0)


def test_a_walk_to_the_left_of_the_line_deviates_positively() -> None:
    """The line is the heading; the floor is a slope that pulls the robot down to its left."""
    slope = World(slope_deg=12, slope_direction_deg=-90, friction=0.6)
    deviation = walk("tripod", world=slope, duration_s=8).result.deviation
    assert deviation is not None
    assert deviation.signed > 0.02
    assert deviation.final == pytest.approx(deviation.signed)


@pytest.mark.parametrize("rate_deg_s", [10, 20, -20])
def test_it_turns_in_place_at_the_rate_that_it_is_given(rate_deg_s: float) -> None:
    result = walk("tripod", travel=0.0, turn_rate_rad_s=math.radians(rate_deg_s), duration_s=10).result
    assert result.status == "ok"
    assert result.yaw_change_rad is not None
    assert 0.6 <= math.degrees(result.yaw_change_rad) / (10 * rate_deg_s) <= 1.0
    assert math.hypot(*result.path_m[-1]) < 0.10


def test_a_blend_of_travel_and_turn_walks_a_curve() -> None:
    result = walk("tripod", turn_rate_rad_s=math.radians(8), duration_s=10).result
    assert result.status == "ok"
    assert result.yaw_change_rad is not None
    assert result.deviation is not None
    assert math.degrees(result.yaw_change_rad) > 40
    assert result.deviation.signed > 0.2


@pytest.mark.parametrize("name", ["phantomx", "pexod"])
def test_the_other_robots_walk_at_their_own_pace(name: str) -> None:
    result = walk("tripod", robot=shipped(name), duration_s=10).result
    assert result.status == "ok"
    assert result.distance_m is not None
    assert result.deviation is not None
    assert result.distance_m > 0.6 * result.ideal_distance_m
    assert result.deviation.final < 0.1


@pytest.mark.slow
def test_a_robot_with_an_odd_leg_of_its_own_walks(tmp_path: Path) -> None:
    odd = {"position_m": [0.03, -0.09, 0.01], "yaw_deg": -75}
    robot = load_robot(edited_file(tmp_path, put("mounts", 5, odd), put("name", "odd")))
    result = walk("tripod", robot=robot, duration_s=10).result
    assert result.status == "ok"
    assert result.distance_m is not None
    assert result.distance_m > 0.6 * result.ideal_distance_m


def test_a_robot_whose_mounts_differ_in_height_stands_level_and_walks(tmp_path: Path) -> None:
    raised = [{"position_m": [0.08 * x, 0.08 * y, z], "yaw_deg": yaw} for x, y, z, yaw in UNEVEN_MOUNTS]
    robot = load_robot(edited_file(tmp_path, put("mounts", raised), put("name", "uneven")))
    outcome = walk("tripod", robot=robot, duration_s=8)
    stood = outcome.log.rows_of("walk").start - 1
    _, x, y, _ = outcome.log["base_quaternion_world"][stood]
    assert math.degrees(2 * math.hypot(x, y)) < 1
    assert outcome.log["foot_contacts"][stood].all()
    assert outcome.result.status == "ok"
    assert outcome.result.distance_m is not None
    assert outcome.result.deviation is not None
    assert outcome.result.distance_m > 0.8 * outcome.result.ideal_distance_m
    assert outcome.result.deviation.final < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAILURE_KINDS)
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_robot_with_every_failure_comes_to_a_result(name: str, kind: str) -> None:
    leg = 1 + (FAILURE_KINDS.index(kind) + ROBOT_NAMES.index(name)) % 6
    failure = Failure(leg=leg, kind=kind, joint="femur", angle_rad=0.3)
    outcome = walk(robot=shipped(name), failure=failure, duration_s=4)
    assert outcome.result.status in STATUSES
    assert outcome.result.distance_m is not None
    assert _all_finite(outcome.result)
    assert np.isfinite(outcome.log["measured_rad"]).all()


@pytest.mark.parametrize("heading_deg", [0, 100])
@pytest.mark.parametrize("leg", range(1, 7))
def test_after_the_self_rotation_it_walks_along_the_heading_that_it_was_given(
    leg: int, heading_deg: float
) -> None:
    plan: dict[str, Any] = {"heading_rad": math.radians(heading_deg), "duration_s": 4}
    outcome = walk(failure=Failure(leg=leg), **plan)
    frame, result = outcome.log.frame, outcome.result
    assert frame is not None
    assert math.degrees(frame.heading_rad) == pytest.approx(heading_deg, abs=1), "as it stood at first"
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.deviation.final < 0.15
    walked = outcome.log["base_position_world"][outcome.log.rows_of("walk")]
    start = outcome.log["base_position_world"][outcome.log.rows_of("walk").start - 1]
    np.testing.assert_allclose(frame.origin_world[:2], start[:2], atol=1e-3)
    way = walked[-1] - walked[0]
    assert math.degrees(math.atan2(way[1], way[0])) == pytest.approx(heading_deg, abs=15)


def test_a_trial_lasts_as_long_as_it_says_phase_by_phase() -> None:
    log = walk("tripod", duration_s=2.5, settle_s=0.6).log
    lengths = {
        phase: log.rows_of(phase).stop - log.rows_of(phase).start for phase in ("settle", "walk", "stop")
    }
    assert lengths == {"settle": 30, "walk": 125, "stop": 101}
    np.testing.assert_allclose(np.diff(log["time_s"]), 0.02, atol=1e-9)


def test_the_settling_brings_the_joints_to_the_stance_evenly() -> None:
    servos, log = PosedMock(), TickLog()
    servos.connect()
    servos.write(JointTargets(shipped().stance_angles_rad + 0.3, 0.0))
    run_trial(Guard(servos), TrialPlan(gait=gait_of(shipped()), duration_s=0.02), recorders=(log,))
    sent = log["commanded_rad"][log.rows_of("settle")]
    np.testing.assert_allclose(sent[0], shipped().stance_angles_rad + 0.3)
    np.testing.assert_array_equal(sent[-1], shipped().stance_angles_rad)
    assert np.abs(np.diff(sent, axis=0)).max() == pytest.approx(0.3 / 25)


def test_what_recorders_take_after_the_last_command_is_no_silence() -> None:
    expected: list[bool] = []

    class SlowDisk:
        block_ticks = 1_000_000

        def write_block(self, log: TickLog, start: int, stop: int) -> None:
            expected.append(guard.expects_commands)

    with Guard(PosedMock()) as guard:
        plan = TrialPlan(gait=gait_of(shipped()), duration_s=0.1)
        run_trial(guard, plan, recorders=[SlowDisk()])
    assert expected == [False]
