"""Torques of simulated actuators, against MuJoCo's own generalized forces."""

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_failure import FIRST_SPEED
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.types import FloatArray, JointTargets
from tests.robots import shipped
from tests.trials import gait_of

JOINTS = slice(FIRST_SPEED, FIRST_SPEED + 18)


class Metered(SimServos):
    """A simulation that is stepped one by one, with MuJoCo's forces and power of each step."""

    def connect(self) -> None:
        super().connect()
        self.forces_nm: list[FloatArray] = []
        self.work_j: list[FloatArray] = []

    def _step(self) -> None:
        physics, forces, work = self.compiled.physics, [], []
        back_emf = self.robot.back_emf_nm_s_per_rad
        for _ in range(self.world.steps_per_tick):
            physics.step()
            velocity = np.array(physics.data.qvel[JOINTS])
            force = np.array(physics.data.qfrc_actuator[JOINTS])
            forces.append(force)
            work.append((force - back_emf * velocity) * velocity * self.world.time_step_s)
        self.forces_nm.append(np.mean(forces, axis=0))
        self.work_j.append(np.sum(work, axis=0))


@pytest.mark.parametrize("name", ["ant", "phantomx"])
def test_energy_is_the_work_of_mujocos_forces(name: str) -> None:
    with Metered(shipped(name)) as servos:
        plan = TrialPlan(gait=gait_of(servos.robot, "tripod"), duration_s=2.0)
        result = run_trial(Guard(servos), plan, soft_stop=False)
        # Each period of each joint is counted where it is positive; the walk's first tick begins the count.
        work_j = np.array(servos.work_j)[-99:]
    assert result.energy_j == pytest.approx(np.maximum(work_j, 0).sum(), rel=0.04)
    weight_n = 9.81 * servos.robot.mass_kg
    assert result.energy_j is not None
    assert result.distance_m is not None
    cost = result.energy_j / (weight_n * result.distance_m)
    assert result.cost_of_transport == pytest.approx(cost)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["limp", "missing"])
def test_a_leg_without_torque_costs_nothing(kind: str) -> None:
    failure, log = Failure(leg=5, kind=kind), TickLog()
    with SimServos(shipped(), failure=failure) as servos:
        plan = TrialPlan(gait=gait_of(servos.robot), belief=failure, self_rotation="none", duration_s=1.0)
        run_trial(Guard(servos), plan, recorders=(log,))
    torques_nm = log["joint_torques_nm"]
    assert (torques_nm[:, 12:15] == 0).all()
    assert (torques_nm[:, :12] != 0).any(axis=0).all()


def test_the_servo_of_a_stuck_joint_pushes_against_the_jam() -> None:
    """As stiff as it is and no stronger, whatever the jam itself takes."""
    with SimServos(shipped(), failure=parse_kind(2, "stuck:femur:30")) as servos:
        robot = servos.robot
        for off_rad in (0.02, 1.0):
            targets_rad = robot.stance_angles_rad.copy()
            targets_rad[4] = np.radians(30.0) + off_rad
            for _ in range(20):
                servos.write(JointTargets(targets_rad, servos.clock.now_s))
                servos.clock.tick()
            state = servos.read()
            assert state.joint_torques_nm is not None
            pushed_nm = robot.stiffness_nm_per_rad[4] * (targets_rad[4] - state.joint_positions_rad[4])
            limit_nm = robot.joint_max_torque_nm[4]
            assert state.joint_torques_nm[4] == pytest.approx(min(pushed_nm, limit_nm))
            assert (pushed_nm > limit_nm) == (off_rad == 1.0)
