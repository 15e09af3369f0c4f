"""Latency by the robot's own motion: in synthetic sightings, and of a simulated robot that twists."""

import math
from functools import cache

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.body_wiggle import BodyWiggle, wiggle_yaw_rad
from hexctl.control.controllers import Controller, Stand
from hexctl.control.guard import Guard
from hexctl.control.loop import run_controller
from hexctl.errors import InputError
from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.vision.estimation.latency import Latency, measure_latency
from tests.driven import course, driven
from tests.robots import shipped
from tests.vision.sightings import SIGMA

#: A twist of the body, by its joints.
TIMES_S = 0.02 * np.arange(300, dtype=float)
TWIST = np.column_stack([np.zeros((300, 2)), wiggle_yaw_rad(TIMES_S - 1.0)])


def pictures(
    times_s: FloatArray, true: FloatArray, *, late_s: float = 0.08, fps: float = 30.0, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Arrivals of pictures, and noisy poses in them."""
    rng = np.random.default_rng(seed)
    taken_s = np.arange(times_s[0] + 0.01, times_s[-1], 1 / fps)
    seen = np.column_stack([np.interp(taken_s, times_s, column) for column in true.T])
    return taken_s + late_s, seen + rng.normal(size=seen.shape) * SIGMA


@pytest.mark.parametrize("late_s", [0.0, 0.08, 0.25])
def test_noiseless_sightings_tell_the_latency(late_s: float) -> None:
    taken_s = np.arange(0.0, 5.9, 0.04)
    seen = np.column_stack([np.interp(taken_s, TIMES_S, column) for column in TWIST.T])
    found = measure_latency(TIMES_S, TWIST, taken_s + late_s, seen + np.array([0.5, -0.2, 3.0]))
    assert found.latency_s == pytest.approx(late_s, abs=5e-4)
    assert found.factor == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_its_uncertainty_is_that_of_its_errors() -> None:
    found = [measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, TWIST, seed=seed)) for seed in range(30)]
    errors_s = np.array([one.latency_s for one in found]) - 0.08
    assert np.abs(errors_s).max() < 0.015
    assert np.std(errors_s) == pytest.approx(np.mean([one.sigma_s for one in found]), rel=0.4)


def test_wild_sightings_do_not_count() -> None:
    arrivals_s, seen = pictures(TIMES_S, TWIST)
    seen[::9] += [0.4, 0.0, 1.0]
    assert abs(measure_latency(TIMES_S, TWIST, arrivals_s, seen).latency_s - 0.08) < 0.015


def test_a_body_that_turns_less_than_its_joints_say_tells_it_all_the_same() -> None:
    found = measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, TWIST * 0.7))
    assert abs(found.latency_s - 0.08) < 0.015
    assert found.factor == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize("steady", [np.zeros((300, 3)), np.outer(TIMES_S, [0.1, 0.0, 0.0])])
def test_standing_and_even_motion_tell_nothing(steady: FloatArray) -> None:
    with pytest.raises(InputError, match="too little motion"):
        measure_latency(TIMES_S, steady, *pictures(TIMES_S, steady))


def test_a_tag_that_moves_otherwise_is_refused() -> None:
    with pytest.raises(InputError, match="latency"):
        measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, TWIST * 3))
    with pytest.raises(InputError, match="latency"):
        measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, np.zeros((300, 3))))


def test_too_few_sightings_are_refused() -> None:
    arrivals_s, seen = pictures(TIMES_S, TWIST)
    with pytest.raises(InputError, match="20 or more"):
        measure_latency(TIMES_S, TWIST, arrivals_s[30:45], seen[30:45])


@cache
def simulated(robot: str, world: str, *, still: bool = False) -> tuple[FloatArray, ...]:
    """A simulated robot that stands, twists and stands.

    Returns when joints were measured and the poses that they tell, and times and poses of the truth.
    """
    model, servos = shipped(robot), SimServos(robot, world=world)
    rows: list[tuple[float, float, FloatArray, FloatArray, float]] = []

    class Watch:
        def record(self, tick: object, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
            assert servos.true_pose is not None
            position, quaternion = servos.true_pose
            joints_rad, yaw = state.joint_positions_rad.copy(), float(yaw_rad(quaternion))
            rows.append((state.stamp_s, servos.clock.now_s, joints_rad, position, yaw))

        def took(self, work_s: float) -> None:
            pass

    with Guard(servos) as guard:
        stance = model.stance_angles_rad
        twist: Controller = Stand(model, stance, 1, 200) if still else BodyWiggle(model, period_s=0.02)
        for controller in (Stand(model, stance, 1, 50), twist, Stand(model, stance, 1, 40)):
            run_controller(guard, controller, [Watch()])
    measured_s, times_s = np.array([row[:2] for row in rows]).T
    own = course(leg_motions(model, measured_s, np.array([row[2] for row in rows])).motions)
    return measured_s, own, times_s, np.array([[*row[3][:2], row[4]] for row in rows])


@pytest.mark.parametrize("fps", [15.0, 30.0])
@pytest.mark.parametrize("world", ["flat", "real:3"])
@pytest.mark.parametrize("robot", ["ant", "phantomx", "pexod"])
def test_a_twist_tells_the_latency_within_15_ms(robot: str, world: str, fps: float) -> None:
    measured_s, own, times_s, true = simulated(robot, world)
    found = [
        measure_latency(measured_s, own, *pictures(times_s, true, fps=fps, seed=seed)) for seed in range(5)
    ]
    assert max(abs(one.latency_s - 0.08) for one in found) < 0.015
    assert max(one.sigma_s for one in found) < 0.01


def test_a_robot_that_stands_still_tells_nothing() -> None:
    measured_s, own, times_s, true = simulated("ant", "flat", still=True)
    with pytest.raises(InputError, match="too little motion"):
        measure_latency(measured_s, own, *pictures(times_s, true))


@pytest.mark.slow
def test_a_walk_with_starts_and_turns_tells_it_too() -> None:
    walk = driven("ant", ((1, 0, 0, 0), (2, 1, 0, 0), (2, 0, 0, 0.7), (2, 0.5, 0.5, -0.7), (1, 0, 0, 0)))
    own = course(leg_motions(shipped(), walk.times_s, walk.joints_rad).motions)
    found: Latency = measure_latency(walk.times_s, own, *pictures(walk.times_s, walk.poses))
    assert abs(found.latency_s - 0.08) < 0.025
    assert math.isfinite(found.sigma_s)
