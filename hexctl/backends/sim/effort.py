"""Torques of the simulated actuators."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from hexctl.backends.sim.simulated_failure import FIRST_SPEED
from hexctl.backends.sim.simulation_model import Simulation
from hexctl.types import N_JOINTS, ArrayFields, BoolArray, FloatArray

#: A back-EMF below this is a rounding error.
LEAST_BACK_EMF = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class JointTorques(ArrayFields):
    """Torques of the servos on the joints of simulated robots, averaged over a control period.

    A servo applies MuJoCo's actuator force less its back-EMF, which is simulated as joint damping. Friction
    and damping of its gears are not subtracted. Joints of a missing leg have no torque. A stuck joint's servo
    pushes against the jam: stiffness times error, up to its limit.

    Attributes:
        steps: steps of the physics in a control period.
        driven: joints that a servo drives, (18,); None for all.
        stuck: joints whose servos push against a jam, (18,); None for none.
        stiffness_nm_per_rad: of the servos, (18,).
        limit_nm: of the servos, (18,).
        back_emf_nm_s_per_rad: torque lost per speed, (18,); None for none.
    """

    steps: int
    driven: BoolArray | None
    stuck: BoolArray | None
    stiffness_nm_per_rad: FloatArray
    limit_nm: FloatArray
    back_emf_nm_s_per_rad: FloatArray | None

    @classmethod
    def of(cls, simulation: Simulation) -> Self:
        """Torques of a simulation; its failed legs may change them."""
        failed = simulation.failed
        driven, stuck = failed.driven, failed.stiff
        lost = np.array(simulation.physics.model.dof_damping[FIRST_SPEED:]) - failed.gear_damping_nm_s_per_rad
        back_emf = np.where(lost > LEAST_BACK_EMF, lost, 0.0)
        steps = simulation.world.steps_per_tick
        return cls(
            steps,
            None if driven.all() else driven,
            stuck if stuck.any() else None,
            *failed.servo_springs,
            back_emf if back_emf.any() else None,
        )

    def forces_in(self, history: FloatArray) -> FloatArray:
        """View of the forces in MuJoCo's memory, leading shape + (18, steps).

        The memory ends with 18 * (2 + 2 * steps) numbers of the sensors: for each actuator two numbers, then
        a time and a force for each of the last steps. Before them are the delayed commands.
        """
        sensed = history[..., -N_JOINTS * (2 + 2 * self.steps) :]
        rows = sensed.reshape(*history.shape[:-1], N_JOINTS, 2 + 2 * self.steps)
        return rows[..., 2 + self.steps :]

    def applied(
        self, forces_nm: FloatArray, qvel: FloatArray, qpos: FloatArray, asked_rad: FloatArray
    ) -> FloatArray:
        """Torques over the last period, leading shape + (18,), with the speed at its end.

        Shapes are leading shape + (24,) of `qvel`, (25,) of `qpos` and (18,) of the servos' targets.
        """
        torques: FloatArray = np.add.reduce(forces_nm, axis=-1)
        torques /= self.steps
        if self.back_emf_nm_s_per_rad is not None:
            torques -= self.back_emf_nm_s_per_rad * qvel[..., FIRST_SPEED:]
        if self.driven is not None:
            torques *= self.driven
        if self.stuck is not None:
            pushed = self.stiffness_nm_per_rad * (asked_rad - qpos[..., -N_JOINTS:])
            torques = np.where(self.stuck, np.clip(pushed, -self.limit_nm, self.limit_nm), torques)
        return torques
