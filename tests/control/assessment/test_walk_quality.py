"""Energy, cost of transport, lean and steadiness of walks with known answers."""

import math

import numpy as np
import pytest

from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimClock
from hexctl.backends.sim.world import World
from hexctl.control.assessment.walk_quality import (
    BLOCK_TICKS,
    RAMP_TICKS,
    WalkEffort,
    cost_of_transport,
    lean_deg,
    unsteadiness_m_s,
)
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray, RobotState
from tests.robots import shipped
from tests.trials import gait_of, walk

WORN = World.model_validate(
    {"sensor_noise": {"joint_deg": 0.2, "position_m": 0.001, "yaw_deg": 0.5}, "roughness_m": 0.004}
    | {"state_latency_s": 0.03, "servo_delay_s": 0.02}
)


def state(angle_rad: float, torque_nm: float | None) -> RobotState:
    torques_nm = None if torque_nm is None else np.full(18, torque_nm)
    return RobotState(np.full(18, angle_rad), 0.0, True, joint_torques_nm=torques_nm)


@pytest.mark.parametrize("ticks", [2, BLOCK_TICKS, BLOCK_TICKS + 1, 3 * BLOCK_TICKS + 7])
def test_a_constant_torque_works_along_its_way(ticks: int) -> None:
    effort = WalkEffort()
    for tick in range(ticks):
        effort.add(state(0.01 * tick, 2.0), np.zeros(18))
    assert effort.energy_j() == pytest.approx(18 * 2.0 * 0.01 * (ticks - 1))


def test_what_a_joint_brakes_does_not_count() -> None:
    effort = WalkEffort()
    for tick in range(100):
        effort.add(state(math.sin(0.2 * tick), 1.0), np.zeros(18))
    rises = np.maximum(np.diff(np.sin(0.2 * np.arange(100))), 0).sum()
    assert effort.energy_j() == pytest.approx(18 * rises)


def test_without_torques_no_energy_is_known() -> None:
    effort = WalkEffort()
    assert effort.energy_j() is None
    effort.add(state(0.0, 1.0), np.zeros(18))
    assert effort.energy_j() == 0.0
    effort.add(state(0.1, None), np.zeros(18))
    effort.add(state(0.2, 1.0), np.zeros(18))
    assert effort.energy_j() is None


def test_an_unknown_torque_makes_the_energy_unknown() -> None:
    effort = WalkEffort()
    for tick in range(3):
        effort.add(state(0.1 * tick, math.nan if tick == 1 else 1.0), np.zeros(18))
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


def test_cost_of_transport_is_per_weight_and_metre() -> None:
    ant = shipped()
    assert cost_of_transport(ant, 9.81 * ant.mass_kg, 2.0) == pytest.approx(0.5)
    for energy_j, distance_m in ((None, 1.0), (1.0, None), (1.0, 0.0), (1.0, -0.2)):
        assert cost_of_transport(ant, energy_j, distance_m) is None


def leaning(roll_rad: FloatArray, yaw_rad: float) -> FloatArray:
    """Quaternions of a roll after a yaw."""
    c, s, cy, sy = np.cos(roll_rad / 2), np.sin(roll_rad / 2), math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    return np.stack([cy * c, cy * s, sy * s, sy * c], axis=-1)


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


@pytest.mark.slow
@pytest.mark.parametrize("world", [World(), WORN], ids=["flat", "worn"])
@pytest.mark.parametrize("hold", ["none", "line"])
def test_a_batch_costs_what_its_trials_cost_alone(world: World, hold: str) -> None:
    ant, failure = shipped(), Failure(leg=5, kind="limp")
    trials = [
        SimTrial(
            robot=ant,
            plan=TrialPlan(
                gait=gait_of(ant, gait),
                duration_s=duration_s,
                belief=failure,
                hold=hold,
                self_rotation="none",
            ),
            failure=failure,
            world=world,
        )
        for gait, duration_s in (("tripod", 2.5), ("demo", 2.3), ("wave", 2.5))
    ]
    alone = [run_sim_trial(trial) for trial in trials]
    for one, other in zip(run_sim_trials(trials), alone, strict=True):
        assert one == other
        assert one.energy_j is not None
        assert one.energy_j > 0
        assert None not in (one.tilt_deg, one.steadiness)
    assert len({result.energy_j for result in alone}) == 3


def test_a_result_is_stored_with_its_qualities() -> None:
    result = walk("tripod", duration_s=2.5).result
    assert None not in (result.energy_j, result.cost_of_transport, result.tilt_deg, result.steadiness)
    stored = result.to_dict(path=True)
    again = TrialResult.from_dict(stored)
    assert (again.energy_j, again.steadiness) == (result.energy_j, result.steadiness)
    for name in ("energy_j", "cost_of_transport", "tilt_deg", "steadiness"):
        assert stored[name] == getattr(result, name)


def test_a_robot_that_tells_neither_torques_nor_pose_has_no_qualities() -> None:
    with MockServos(shipped(), clock=SimClock(lambda: None)) as servos:
        plan = TrialPlan(gait=gait_of(servos.robot), duration_s=1.0)
        result = run_trial(Guard(servos), plan)
    assert result.status == "ok"
    assert result.energy_j is result.cost_of_transport is result.tilt_deg is result.steadiness is None
