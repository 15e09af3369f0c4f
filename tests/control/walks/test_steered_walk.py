"""Walks that are steered, in simulation: they end on their line, and alone as in a batch."""

import math
import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.preparation import WalkStart
from hexctl.control.trace import TrialFrame
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import Course, trimmed_rad
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray, RobotState
from tests.robots import shipped

ROOT = Path(__file__).parents[3]

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


@pytest.mark.slow
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


@pytest.mark.slow
def test_alone_is_as_in_a_batch_to_the_last_bit() -> None:
    noisy = World(sensor_noise=SensorNoise(position_m=0.01, yaw_deg=0.5, joint_deg=0.3))
    trials = [
        trial_of(code, hold, duration_s=4.0, world=noisy) for code in CODES for hold in ("line", "heading")
    ]
    together = run_sim_trials(trials)
    assert together == [run_sim_trial(trial) for trial in trials]
    assert {result.hold for result in together} == {"line", "heading"}


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "world"), [(3, World()), (5, World(friction=0.5, slope_deg=1.0))])
def test_a_square_with_a_dead_leg_closes(leg: int, world: World) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "square.py"))
    assert example["walk_square"](Failure(leg=leg), world=world) < 0.03


class Stepping(SteeredWalk):
    """Follows a line from 8 s on that is shifted to the left and turned; notes how far it is from it."""

    def __init__(self, start: WalkStart, shift_m: float, turn_rad: float) -> None:
        super().__init__(start)
        self._shift_m, self._turn_rad = shift_m, turn_rad
        self.aside_m: list[float] = []

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        assert state.base_position_world is not None
        x, y = state.base_position_world[:2].tolist()
        if step == 400:
            self._origin = x, self._shift_m
            origin_world = np.array(self._origin)
            self.follow(Course(origin_world=origin_world, heading_rad=self._turn_rad, yaw_rad=0.0))
        if step >= 400:
            moved = x - self._origin[0], y - self._origin[1]
            self.aside_m.append(math.cos(self._turn_rad) * moved[1] - math.sin(self._turn_rad) * moved[0])
        return super().targets_rad(step, state)


@pytest.mark.parametrize(("shift_m", "turn_rad"), [(0.2, 0.0), (0.0, math.radians(30))])
def test_a_line_that_is_shifted_or_turned_is_reached_without_overshooting_far(
    shift_m: float, turn_rad: float
) -> None:
    robot, made = shipped(), []

    def stepping(start: WalkStart) -> Stepping:
        made.append(Stepping(start, shift_m, turn_rad))
        return made[0]

    plan = TrialPlan(gait=make_gait(robot, "tripod"), hold="line", duration_s=25.0)
    with SimServos(robot) as servos:
        run_trial(servos, plan, stepping, soft_stop=False)
    aside_m = np.array(made[0].aside_m)
    assert aside_m[0] == pytest.approx(-shift_m, abs=0.02)
    assert np.abs(aside_m[-100:]).max() < 0.02, "on the new line, the sway of a cycle included"
    assert aside_m.max() < 0.06


@pytest.mark.slow
def test_one_measured_end_trims_the_next_walk_that_holds_its_heading() -> None:
    world = World(friction=0.6, slope_deg=4.0, slope_direction_deg=90.0)
    first = trial_of(17, "heading", world=world, duration_s=20.0)
    before = run_sim_trial(first)
    assert before.deviation is not None
    assert before.distance_m is not None
    assert before.deviation.final > 0.05
    trim_rad = trimmed_rad(0.0, signed_m=before.deviation.signed, distance_m=before.distance_m)
    trials = [replace(first, plan=replace(first.plan, trim_rad=one)) for one in (trim_rad, 0.0)]
    second, same = run_sim_trials(trials)
    assert second.deviation is not None
    assert second.deviation.final < 0.2 * before.deviation.final
    assert same == before
    assert run_sim_trial(trials[0]) == second
