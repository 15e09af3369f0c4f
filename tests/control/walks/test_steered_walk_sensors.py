"""Steered walks whose sensors fail, in simulation, scored by where the robot really was."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.types import RobotState
from tests.robots import shipped

#: A state at a time since the walk began, as a faulty sensor shows it.
Fault = Callable[[RobotState, float], RobotState]

WALK_S = 16.0


class Faulty(ServosWrapper):
    """A robot whose sensors show something else than what is; times count from the first state."""

    def __init__(self, servos: LegServos, fault: Fault) -> None:
        super().__init__(servos)
        self._fault = fault

    def read(self) -> RobotState:
        state = super().read()
        return self._fault(state, state.stamp_s)


def walked(
    fault: Fault,
    *,
    hold: str = "auto",
    code: int = 62,
    world: World | None = None,
    duration_s: float = WALK_S,
    turn_rate_rad_s: float = 0.0,
) -> TrialResult:
    """A walk with leg 3 locked and no self-rotation, which veers by decimetres in open loop."""
    robot, failure = shipped(), Failure(leg=3)
    plan = TrialPlan(
        gait=make_gait(robot, str(code), failed_legs=(3,)),
        belief=failure,
        duration_s=duration_s,
        self_rotation="none",
        turn_rate_rad_s=turn_rate_rad_s,
        hold=hold,
    )
    with Guard(Faulty(SimServos(robot, world=world, failure=failure), fault)) as guard:
        return run_trial(guard, plan, soft_stop=False)


def truly_off_m(result: TrialResult) -> float:
    """How far from its line a walk really ended."""
    assert result.true_deviation is not None
    return result.true_deviation.final


def healthy(state: RobotState, _time_s: float) -> RobotState:
    return state


def without(*sensors: str, first_s: float = 0.0, last_s: float = math.inf) -> Fault:
    """A fault that takes away sensors for a time."""

    def fault(state: RobotState, time_s: float) -> RobotState:
        gone: dict[str, Any] = {f"base_{name}_world": None for name in sensors if first_s <= time_s < last_s}
        return replace(state, **gone)

    return fault


def test_open_loop_it_veers() -> None:
    result = walked(healthy, hold="none")
    assert result.hold == "none"
    assert truly_off_m(result) > 0.2


@pytest.mark.slow
def test_with_yaw_alone_the_heading_is_held_and_the_true_course_is_scored() -> None:
    result = walked(without("position"))
    assert (result.hold, result.deviation, result.distance_m) == ("heading", None, None)
    assert result.yaw_change_rad is not None
    assert abs(result.yaw_change_rad) < math.radians(20)
    assert truly_off_m(result) < 0.2


def test_with_a_position_alone_the_line_is_held() -> None:
    result = walked(without("quaternion"))
    assert (result.hold, result.yaw_change_rad) == ("line", None)
    assert truly_off_m(result) < 0.05


@pytest.mark.parametrize(
    ("gone", "wanted", "hold", "said"),
    [
        (("position", "quaternion"), "auto", "none", "neither position nor yaw was measured"),
        (("quaternion",), "heading", "none", "no yaw was measured"),
        (("position",), "line", "heading", "no position was measured"),
        (("quaternion",), "line", "line", None),
        (("position",), "heading", "heading", None),
        (("position", "quaternion"), "none", "none", None),
    ],
)
def test_a_walk_that_holds_less_than_it_should_says_why(
    gone: tuple[str, ...], wanted: str, hold: str, said: str | None
) -> None:
    result = walked(without(*gone), hold=wanted, duration_s=0.1)
    assert result.hold == hold
    assert result.hold_caveat == (said and f"{said} at rest before the walk")


@pytest.mark.slow
@pytest.mark.parametrize("wanted", ["auto", "heading", "line"])
def test_an_arc_says_why_it_holds_nothing(wanted: str) -> None:
    result = walked(without(), hold=wanted, duration_s=0.1, turn_rate_rad_s=0.1)
    assert (result.hold, result.hold_caveat) == ("none", "a turn and an arc have no line")


def test_without_any_pose_nothing_is_held() -> None:
    result = walked(without("position", "quaternion"))
    assert (result.hold, result.deviation, result.true_deviation) == ("none", None, None)


@pytest.mark.parametrize("sensors", [("position",), ("quaternion",), ("position", "quaternion")])
def test_what_stays_away_for_three_seconds_and_comes_back_costs_no_course(sensors: tuple[str, ...]) -> None:
    result = walked(without(*sensors, first_s=6.0, last_s=9.0))
    assert (result.status, result.hold) == ("ok", "line")
    assert result.hold_lost_s == pytest.approx(3.0 if "position" in sensors else 0.0, abs=0.05)
    assert truly_off_m(result) < 0.05


#: In times of the simulation; the walk begins at 1 s, and in open loop ends 1.1 m off. Measured: 0.3 cm off
#: without a fault, 0.4 to 0.6 with most, 1.9 and 0.9 with the second and third pose that freezes.
FAULTS: dict[str, dict[str, Any]] = {
    "a position that is a metre off for 3 s": {"position_jump_s": [[6, 9]]},
    "a pose that freezes for 3 s": {"pose_frozen_s": [[6, 9]]},
    "a pose that freezes for 6 s": {"pose_frozen_s": [[5, 11]]},
    "a pose that freezes when the walk begins": {"pose_frozen_s": [[1.5, 4.5]]},
    "a yaw that drifts": {"yaw_drift_deg_per_min": 3},
}


@pytest.mark.parametrize("faults", FAULTS.values(), ids=FAULTS)
def test_a_sensor_that_fails_bends_no_line(faults: dict[str, Any]) -> None:
    result = walked(healthy, world=World.model_validate({"sensor_faults": faults}))
    assert (result.status, result.hold) == ("ok", "line")
    assert truly_off_m(result) < 0.04
    assert result.true_deviation is not None
    assert result.true_deviation.max < 0.1


def test_a_pose_that_stays_frozen_is_lost_and_no_slip() -> None:
    faults = {"pose_frozen_s": [[5, 500]]}
    result = walked(healthy, world=World.model_validate({"sensor_faults": faults}), duration_s=12.0)
    assert (result.status, result.hold, result.cause) == ("ok", "line", None)
    assert (result.distance_m, result.deviation) == (None, None)
    assert result.hold_lost_s == pytest.approx(8.0, abs=0.1)
    assert result.true_path_m is not None
    assert result.true_path_m[-1, 0] > 1.0


@pytest.mark.slow
def test_noise_delay_and_dropouts_cost_a_centimetre_or_so() -> None:
    world = World(
        sensor_noise=SensorNoise(position_m=0.01, yaw_deg=0.5, joint_deg=0.3),
        state_latency_s=0.04,
        lost_poses=0.05,
    )
    result = walked(healthy, world=world)
    assert (result.status, result.hold) == ("ok", "line")
    assert truly_off_m(result) < 0.03
    assert np.isnan(result.path_m[:, 0]).mean() == pytest.approx(0.05, abs=0.03)
