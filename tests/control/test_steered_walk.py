"""Walks that are steered, in simulation: they end on their line, and alone as in a batch."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.world import SensorNoise, World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.plan import TrialPlan
from hexctl.control.preparation import WalkStart
from hexctl.control.steered_walk import SteeredWalk
from hexctl.control.trace import TrialFrame
from hexctl.control.velocity_walk import OVERDRIVE
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray, RobotState
from tests.robots import shipped

#: Gaits of a failed leg 3 that end far from their line when nothing is held.
CODES = (17, 62, 98)


def trial_of(
    code: int, hold: str, *, robot: str = "ant", duration_s: float = 12.0, **options: object
) -> SimTrial:
    model, failure = shipped(robot), Failure(leg=3)
    plan = TrialPlan(
        gait=make_gait(model, str(code), failed_legs=(3,)), belief=failure, duration_s=duration_s, hold=hold
    )
    return SimTrial(robot=model, plan=plan, failure=failure, **options).put_down_turned()  # type: ignore[arg-type]


@pytest.mark.parametrize("robot", ["ant", "pexod"])
def test_a_steered_walk_ends_on_its_line_where_an_open_loop_one_does_not(robot: str) -> None:
    world = World(friction=0.6, slope_deg=1.0, slope_direction_deg=70.0)
    held, free = (
        run_sim_trials([trial_of(code, hold, robot=robot, world=world, duration_s=20.0) for code in CODES])
        for hold in ("line", "none")
    )
    assert [result.hold for result in held] == ["line"] * 3
    assert max(result.deviation.final for result in held if result.deviation) < 0.02
    assert max(result.deviation.final for result in free if result.deviation) > 0.2


def test_alone_is_as_in_a_batch_to_the_last_bit() -> None:
    noisy = World(sensor_noise=SensorNoise(position_m=0.01, yaw_deg=0.5, joint_deg=0.3))
    trials = [
        trial_of(code, hold, duration_s=4.0, world=noisy) for code in CODES for hold in ("line", "heading")
    ]
    together = run_sim_trials(trials)
    assert together == [run_sim_trial(trial) for trial in trials]
    assert {result.hold for result in together} == {"line", "heading"}


def test_what_has_no_line_is_not_held() -> None:
    trial = trial_of(17, "line", duration_s=2.0)
    arc = replace(trial, plan=replace(trial.plan, turn_rate_rad_s=0.1, hold="auto"))
    assert run_sim_trial(arc).hold == "none"
    assert run_sim_trial(replace(trial, plan=replace(trial.plan, hold="auto"))).hold == "line"
    assert run_sim_trial(replace(trial, plan=replace(trial.plan, hold="none"))).hold == "none"


def start_of(frame: TrialFrame | None) -> WalkStart:
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "demo"))
    return WalkStart(robot=robot, plans=(plan,), batch_shape=(), period_s=0.02, turned_rad=0.0, frame=frame)


def state_at(position_m: tuple[float, float]) -> RobotState:
    return RobotState(np.zeros(18), 0.0, True, np.array([*position_m, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]))


def test_no_foot_jumps_when_the_line_does() -> None:
    """The robot is moved aside by 20 cm: strokes change smoothly, and stay within the gait's bounds."""
    walk = SteeredWalk(start_of(TrialFrame(np.zeros(3), 0.0, 0.0)))
    robot = shipped()
    targets: list[FloatArray] = []
    for step in range(600):
        aside_m = 0.2 if step >= 300 else 0.0
        targets.append(walk.targets_rad(step, state_at((0.003 * step, aside_m))))
    feet = foot_positions_body(robot, np.array(targets))
    steps_m = np.linalg.norm(np.diff(feet[150:], axis=0), axis=-1)
    usual_m = steps_m[:140].max()
    assert steps_m.max() < 1.5 * usual_m
    reach_m = np.abs((feet - robot.stance_feet_body)[..., :2]).max()
    assert reach_m <= OVERDRIVE * robot.gait.amplitude * robot.size_m / 2 + 1e-9


def test_a_robot_without_a_pose_is_refused() -> None:
    with pytest.raises(InputError, match="without a pose"):
        SteeredWalk(start_of(None))
