"""Steered walks in simulation: they end on their line, also when sensors fail, and alone as in a batch."""

import math
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl import (
    Failure,
    Guard,
    InputError,
    RobotState,
    SimTrial,
    TrialPlan,
    TrialResult,
    World,
    make_gait,
    run_sim_trials,
    run_trial,
)
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.control.batch import run_sim_trial
from hexctl.control.preparation import WalkStart
from hexctl.control.trace import TrialFrame
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import Course
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.ik.legs import foot_positions_body
from hexctl.types import FloatArray
from tests.control.posed import Fault, Faulty
from tests.robots import shipped
from tests.trials import sim_trial

#: In times of the simulation; the walk begins at 1 s, and in open loop ends 1.1 m off. Measured: 0.3 cm off
#: without a fault, 0.4 to 0.6 with most, 1.9 and 0.9 with the second and third pose that freezes.
FAULTS: dict[str, dict[str, Any]] = {
    "a position that is a metre off for 3 s": {"position_jump_s": [[6, 9]]},
    "a pose that freezes for 4.8 s": {"pose_frozen_s": [[5, 9.8]]},
    "a pose that freezes when the walk begins": {"pose_frozen_s": [[1.5, 4.5]]},
    "a yaw that drifts": {"yaw_drift_deg_per_min": 3},
}


def off_line_trial(**given: Any) -> SimTrial:
    """A walk with leg 3 locked and no self-rotation, which veers by decimetres in open loop."""
    return sim_trial("62", failure=Failure(leg=3), **{"self_rotation": "none", "hold": "auto", **given})


def truly_off_m(result: TrialResult) -> float:
    """How far from its line a walk really ended."""
    assert result.true_deviation is not None
    return result.true_deviation.final


@pytest.fixture(scope="module")
def with_faults() -> dict[str, TrialResult]:
    """Walks among all faults, in one batch, and one without a fault in open loop."""
    trials = {
        name: off_line_trial(world=World.model_validate({"sensor_faults": faults}), duration_s=13.0)
        for name, faults in FAULTS.items()
    }
    frozen = World.model_validate({"sensor_faults": {"pose_frozen_s": [[5, 500]]}})
    trials["frozen for good"] = off_line_trial(world=frozen, duration_s=12.0)
    trials["open loop"] = off_line_trial(hold="none", duration_s=13.0)
    return dict(zip(trials, run_sim_trials(list(trials.values())), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_a_sensor_that_fails_bends_no_line(name: str, with_faults: dict[str, TrialResult]) -> None:
    result = with_faults[name]
    assert (result.status, result.hold) == ("ok", "line")
    assert truly_off_m(result) < 0.04
    assert result.true_deviation is not None
    assert result.true_deviation.max < 0.1
    assert with_faults["open loop"].hold == "none"
    assert truly_off_m(with_faults["open loop"]) > 0.2


@pytest.mark.slow
def test_a_pose_that_stays_frozen_is_lost_and_no_slip(with_faults: dict[str, TrialResult]) -> None:
    result = with_faults["frozen for good"]
    assert (result.stopped, result.hold, result.cause) == ("pose lost", "line", None)
    assert (result.distance_m, result.deviation) == (None, None)
    assert result.hold_lost_s == pytest.approx(5.0, abs=0.1)
    assert result.true_path_m is not None
    assert result.true_path_m[-1, 0] > 0.7, "it freezes after half a metre"


def without(*sensors: str, first_s: float = 0.0, last_s: float = math.inf) -> Fault:
    """A fault that takes away sensors for a time."""

    def fault(state: RobotState, time_s: float) -> RobotState:
        gone: dict[str, Any] = {f"base_{name}_world": None for name in sensors if first_s <= time_s < last_s}
        return replace(state, **gone)

    return fault


def walked(fault: Fault, **plan: Any) -> TrialResult:
    trial = off_line_trial(**plan)
    with Guard(Faulty(trial.servos(), fault)) as guard:
        return run_trial(guard, trial.plan, soft_stop=False)


@pytest.mark.slow
def test_with_yaw_alone_the_heading_is_held_and_the_true_course_is_scored() -> None:
    result = walked(without("position"), duration_s=16.0)
    assert (result.hold, result.deviation, result.distance_m) == ("heading", None, None)
    assert result.yaw_change_rad is not None
    assert abs(result.yaw_change_rad) < math.radians(20)
    assert truly_off_m(result) < 0.2


@pytest.mark.parametrize(
    ("gone", "wanted", "turn_rate_rad_s", "hold", "said"),
    [
        (("position", "quaternion"), "auto", 0.0, "none", "neither position nor yaw"),
        (("quaternion",), "heading", 0.0, "none", "no yaw"),
        (("position",), "line", 0.0, "heading", "no position"),
        (("quaternion",), "line", 0.0, "line", None),
        (("position",), "heading", 0.0, "heading", None),
        (("position", "quaternion"), "none", 0.0, "none", None),
        ((), "line", 0.1, "none", "an arc"),
        ((), "auto", 0.1, "none", "an arc"),
    ],
)
def test_a_walk_that_holds_less_than_it_should_says_why(
    gone: tuple[str, ...], wanted: str, turn_rate_rad_s: float, hold: str, said: str | None
) -> None:
    result = walked(without(*gone), hold=wanted, duration_s=0.1, turn_rate_rad_s=turn_rate_rad_s)
    assert result.hold == hold
    assert (result.hold_caveat is None) == (said is None)
    assert (said or "") in (result.hold_caveat or "")
    assert result.deviation is None or "position" not in gone


@pytest.mark.parametrize("sensors", [("quaternion",), ("position", "quaternion")])
def test_what_stays_away_for_three_seconds_and_comes_back_costs_no_course(sensors: tuple[str, ...]) -> None:
    result = walked(without(*sensors, first_s=4.0, last_s=7.0), duration_s=12.0)
    assert (result.status, result.hold) == ("ok", "line")
    assert result.hold_lost_s == pytest.approx(3.0 if "position" in sensors else 0.0, abs=0.05)
    assert truly_off_m(result) < 0.05


@pytest.mark.slow
def test_alone_is_as_in_a_batch_to_the_last_bit() -> None:
    noisy = World(sensor_noise=SensorNoise(position_m=0.01, yaw_deg=0.5, joint_deg=0.3))
    trials = [
        sim_trial(code, failure=Failure(leg=3), world=noisy, duration_s=4.0, hold=hold, trim_rad=trim_rad)
        for code, hold, trim_rad in (
            ("17", "line", 0.0),
            ("62", "heading", 0.0),
            ("98", "heading", 0.0),
            ("98", "heading", 0.05),
        )
    ]
    trials = [trial.put_down_turned() for trial in trials]
    together = run_sim_trials(trials)
    assert together == [run_sim_trial(trial) for trial in trials]
    assert {result.hold for result in together} == {"line", "heading"}
    untrimmed, trimmed = together[2:]
    assert untrimmed.deviation is not None
    assert trimmed.deviation is not None
    moved_m = trimmed.deviation.signed - untrimmed.deviation.signed
    assert moved_m == pytest.approx(0.05 * (untrimmed.distance_m or 0), rel=0.5), "to the left"


def test_a_robot_without_a_pose_is_refused() -> None:
    plan = TrialPlan(gait=make_gait(shipped(), "demo"))
    with pytest.raises(InputError):
        SteeredWalk(WalkStart(robot=shipped(), plans=(plan,), frame=None))


@pytest.mark.slow
def test_a_square_with_a_dead_leg_closes() -> None:
    example = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "square.py"))
    assert example["walk_square"](Failure(leg=5), world=World(friction=0.5, slope_deg=1.0)) < 0.03


def state_at(position_m: tuple[float, float]) -> RobotState:
    return RobotState(np.zeros(18), 0.0, True, np.array([*position_m, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]))


def test_no_foot_jumps_when_the_line_does() -> None:
    """The robot is moved aside by 20 cm: strokes change smoothly, and stay within the gait's bounds."""
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "demo"))
    walk = SteeredWalk(WalkStart(robot=robot, plans=(plan,), frame=TrialFrame(np.zeros(3), 0.0, 0.0)))
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


class Stepping(SteeredWalk):
    """Follows a line from 4 s on that is shifted to the left and turned; notes how far it is from it."""

    def __init__(self, start: WalkStart, shift_m: float, turn_rad: float) -> None:
        super().__init__(start)
        self._shift_m, self._turn_rad = shift_m, turn_rad
        self.aside_m: list[float] = []

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        assert state.base_position_world is not None
        x, y = state.base_position_world[:2].tolist()
        if step == 200:
            self._origin = x, self._shift_m
            origin_world = np.array(self._origin)
            self.follow(Course(origin_world=origin_world, heading_rad=self._turn_rad, yaw_rad=0.0))
        if step >= 200:
            moved = x - self._origin[0], y - self._origin[1]
            self.aside_m.append(math.cos(self._turn_rad) * moved[1] - math.sin(self._turn_rad) * moved[0])
        return super().targets_rad(step, state)


@pytest.mark.parametrize(("shift_m", "turn_rad"), [(0.2, 0.0), (0.0, math.radians(30))])
def test_a_line_that_is_shifted_or_turned_is_reached_without_overshooting_far(
    shift_m: float, turn_rad: float
) -> None:
    made: list[Stepping] = []

    def stepping(start: WalkStart) -> Stepping:
        made.append(Stepping(start, shift_m, turn_rad))
        return made[0]

    run_sim_trial(sim_trial(hold="line", duration_s=18.0), stepping)
    aside_m = np.array(made[0].aside_m)
    assert aside_m[0] == pytest.approx(-shift_m, abs=0.02)
    assert np.abs(aside_m[-100:]).max() < 0.02, "on the new line, the sway of a cycle included"
    assert aside_m.max() < 0.06
