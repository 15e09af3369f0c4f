"""Self-rotation: how far to turn, and that the failed leg points there afterwards."""

import math
from typing import Any

import numpy as np
import pytest

from hexctl import Failure, Guard, SimServos, TrialPlan, TrialResult, World, run_trial
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.control.log import TickLog
from hexctl.control.trial_plan import SelfRotation
from hexctl.control.walks.turning import MAX_TURN_STEPS, TurnSteps, swallowed_rad, turn_needed_rad
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.rotations import yaw_rad
from tests.control.posed import PosedMock
from tests.robots import shipped
from tests.trials import gait_of


def _needed_deg(leg: int, heading_deg: float = 0.0, self_rotation: SelfRotation = "rear") -> float:
    plan = TrialPlan(
        gait=gait_of(shipped()),
        failures=(Failure(leg=leg),),
        heading_rad=math.radians(heading_deg),
        self_rotation=self_rotation,
    )
    return math.degrees(turn_needed_rad(shipped(), plan))


def test_the_turn_takes_the_heading_and_what_is_wanted_into_account() -> None:
    assert _needed_deg(4, heading_deg=90) == pytest.approx(90)
    assert _needed_deg(1, heading_deg=-30) == pytest.approx(150)
    assert _needed_deg(2, self_rotation="front") == pytest.approx(-60)
    assert _needed_deg(2, heading_deg=60, self_rotation="front") == pytest.approx(0)
    assert _needed_deg(2, self_rotation="none") == 0
    assert turn_needed_rad(shipped(), TrialPlan(gait=gait_of(shipped()))) == 0
    in_plane = Failure(leg=5, kind="stuck", joint="femur", angle_rad=math.radians(30))
    plan = TrialPlan(gait=gait_of(shipped()), failures=(in_plane,))
    assert turn_needed_rad(shipped(), plan) == pytest.approx(math.radians(-60)), "as with the leg intact"


@pytest.mark.parametrize(
    ("swallowed_deg", "believed_deg", "besides_deg", "missing_deg", "most_off_deg"),
    [(3, 3, 0.0, 0.8, 0.15), (3, 2, 0.0, 0.8, 0.15), (3, 4.2, 0.0, 0.8, 0.15), (0, 0, -0.3, 3.0, 0.03)],
)
def test_small_steps_learn_the_share_that_is_made_and_step_over_dry_friction(
    swallowed_deg: float, believed_deg: float, besides_deg: float, missing_deg: float, most_off_deg: float
) -> None:
    """Half of each step is made and some turn besides; friction may swallow the first part of it."""
    steps = TurnSteps(math.radians(believed_deg))
    swallowed, missing_rad = math.radians(swallowed_deg), math.radians(missing_deg)
    for _ in range(MAX_TURN_STEPS):
        command_rad = steps.command_rad(missing_rad)
        turned_rad = 0.5 * math.copysign(max(0.0, abs(command_rad) - swallowed), command_rad)
        turned_rad += math.radians(besides_deg)
        steps.learn(command_rad, turned_rad)
        missing_rad -= turned_rad
    assert abs(math.degrees(missing_rad)) < most_off_deg


def test_dry_friction_swallows_an_angle_that_the_robot_file_tells() -> None:
    assert swallowed_rad(shipped("ant")) == 0
    assert math.degrees(swallowed_rad(shipped("phantomx"))) == pytest.approx(2.4 * math.degrees(0.5 / 18))


def _turned(failure: Failure, robot: str = "ant", **plan: Any) -> tuple[TrialResult, TickLog]:
    """A trial that ends as its walk begins."""
    log, made = (
        TickLog(),
        TrialPlan(gait=gait_of(shipped(robot)), failures=(failure,), duration_s=0.02, **plan),
    )
    with SimServos(shipped(robot), failures=failure) as servos:
        return run_trial(servos, made, recorders=(log,), soft_stop=False), log


@pytest.mark.slow
@pytest.mark.parametrize(
    ("failure", "robot", "plan", "points_to_deg"),
    [
        (Failure(leg=3), "ant", {}, 180),
        (Failure(leg=1), "ant", {"self_rotation": "front", "heading_rad": 0.5}, 0),
        (Failure(leg=2), "ant", {"heading_rad": math.radians(75)}, 180),
        (Failure(leg=5), "phantomx", {}, 180),
        (Failure(leg=3), "pexod", {}, 180),
        (Failure(leg=5, kind="limp"), "ant", {}, 180),
        (Failure(leg=3, kind="missing"), "ant", {}, 180),
    ],
)
def test_the_failed_leg_points_where_it_should_when_the_walk_begins(
    failure: Failure, robot: str, plan: dict[str, Any], points_to_deg: float
) -> None:
    frame = _turned(failure, robot, **plan)[1].frame
    assert frame is not None
    points_to = frame.yaw_rad + float(shipped(robot).leg_azimuths_rad[failure.leg - 1])
    off = points_to - frame.heading_rad - math.radians(points_to_deg)
    assert abs(math.degrees(math.remainder(off, math.tau))) < 0.15
    assert frame.heading_rad == pytest.approx(plan.get("heading_rad", 0.0), abs=0.02)


def test_a_jammed_foot_trails_when_the_walk_begins() -> None:
    _, log = _turned(Failure(leg=5, kind="stuck", joint="coxa", angle_rad=math.radians(30)))
    assert log.frame is not None
    x, y, _ = foot_positions_body(shipped(), log["measured_rad"][log.rows_of("walk").start])[4]
    off_rad = log.frame.yaw_rad + math.atan2(y, x) - log.frame.heading_rad - math.pi
    assert abs(math.degrees(math.remainder(off_rad, math.tau))) < 3


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [1.0, -3.0, 20.0])
def test_a_small_turn_is_as_exact_and_the_robot_stands_still_after_it(turn_deg: float) -> None:
    result, log = _turned(Failure(leg=2), turn_rad=math.radians(turn_deg))
    assert math.degrees(result.turned_rad) == pytest.approx(turn_deg, abs=0.15)
    before = log.rows_of("turn").stop
    stance_rad = shipped().stance_angles_rad
    np.testing.assert_allclose(log["requested_rad"][before - 1], stance_rad, atol=1e-9)
    moved = np.diff(log["base_position_world"][before - 5 : before], axis=0)
    assert np.abs(moved).max() < 1e-4


@pytest.mark.slow
def test_noise_of_the_yaw_counts_as_its_mean_not_as_its_samples() -> None:
    """Half a degree a sample is 0.14 degrees in the mean of a rest of 13; twice that is not corrected."""
    world = World(sensor_noise=SensorNoise(yaw_deg=0.5))
    misses_deg = []
    for seed in range(4):
        with SimServos(shipped(), world=world, failures=Failure(leg=2), seed=seed) as servos:
            plan = TrialPlan(gait=gait_of(shipped()), failures=(Failure(leg=2),), duration_s=0.02)
            run_trial(servos, plan, soft_stop=False)
            quaternion = servos.compiled.physics.data.qpos[3:7]
            misses_deg.append(math.degrees(float(yaw_rad(quaternion))) - 120)
    assert max(map(abs, misses_deg)) < 0.8


def test_no_turn_when_told_not_to_or_when_the_leg_trails_already() -> None:
    for leg, self_rotation in ((2, "none"), (4, "rear"), (1, "front")):
        _, log = _turned(Failure(leg=leg), self_rotation=self_rotation)
        assert log.rows_of("turn") == slice(0, 0)


def test_a_robot_that_does_not_turn_walks_from_where_it_is() -> None:
    """Its own yaw never changes: after four times the ideal time it gives up."""
    servos, log = PosedMock(), TickLog()
    plan = TrialPlan(gait=gait_of(servos.robot), failures=(Failure(leg=2),), duration_s=1)
    with Guard(servos) as guard:
        result = run_trial(guard, plan, recorders=(log,))
    turning = log.rows_of("turn")
    ideal_s = 2 + math.radians(120) / (1.5 * 0.9 * 0.055 / 0.204)
    assert (turning.stop - turning.start) * 0.02 == pytest.approx(4 * ideal_s + 2 + 0.5, abs=0.1)
    assert result.duration_s == pytest.approx(1)


@pytest.mark.parametrize("name", ["ant", "pexod"])
def test_the_foot_of_a_jammed_leg_is_where_the_jam_puts_it(name: str) -> None:
    """Leg 5 with its coxa at +30 deg: the foot stands further forward than the leg's stance."""
    robot = shipped(name)
    failure = Failure(leg=5, kind="stuck", joint="coxa", angle_rad=math.radians(30))
    mount, foot = robot.mount_positions_body[4, :2], robot.stance_feet_body[4, :2]
    cos, sin = math.cos(failure.angle_rad), math.sin(failure.angle_rad)
    x, y = np.array([[cos, -sin], [sin, cos]]) @ (foot - mount) + mount
    plan = TrialPlan(gait=gait_of(robot), failures=(failure,))
    wanted_deg = math.remainder(180 - math.degrees(math.atan2(y, x)), 360)
    assert math.degrees(turn_needed_rad(robot, plan)) == pytest.approx(wanted_deg, abs=1e-9)
