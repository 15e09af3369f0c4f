"""The servos of a compiled MuJoCo model, with other values."""

from typing import Any

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servo_physics import GearFriction, ServoPower
from hexctl.identify.parameters import ServoValues
from hexctl.types import FloatArray

#: Interpolation between commands that wait in an actuator: dead times lie between steps of the physics.
LINEAR = 1


class PoweredServos(ServoPower):
    """The servos of a model with other values; their power is on.

    Args:
        model: with `position` actuators, one a joint, which keep samples for the longest dead time.
        dofs: degrees of freedom of the joints, in the order of the actuators.
        stiffness_nm_per_rad: of each actuator, instead of that of the values.
    """

    def __init__(
        self, model: Any, dofs: slice, values: ServoValues, stiffness_nm_per_rad: FloatArray | float
    ) -> None:
        import mujoco

        model.dof_armature[dofs] = values.rotor_inertia_kg_m2
        model.dof_frictionloss[dofs] = values.dry_friction_nm
        # The impedance of dry friction follows from the inertia.
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.actuator_forcerange[:, 0] = -values.max_torque_nm
        model.actuator_forcerange[:, 1] = values.max_torque_nm
        model.actuator_delay[:] = values.dead_time_s
        model.actuator_history[:, 1] = LINEAR
        model.actuator_gainprm[:, 0] = stiffness_nm_per_rad
        model.actuator_biasprm[:, 1] = -model.actuator_gainprm[:, 0]
        model.actuator_biasprm[:, 2] = -values.damping_nm_s_per_rad
        model.dof_damping[dofs] = values.gear_damping_nm_s_per_rad + values.back_emf_nm_s_per_rad
        super().__init__(model, dofs, values.gear_damping_nm_s_per_rad)
        self._model, self._dofs, self._rubs_at_s = model, dofs, PERIOD_S
        self._gears = GearFriction.of(model, dofs, values)

    def step(self, data: Any, steps: int) -> None:
        """Make steps of the physics; the friction follows the load once per control period."""
        import mujoco

        mujoco.mj_step(self._model, data, steps)
        if self._gears is not None and data.time > self._rubs_at_s - self._model.opt.timestep / 2:
            self._rubs_at_s += PERIOD_S
            limit_nm = self._gears.limit_nm(data.actuator_force, data.qvel[self._dofs])
            self._model.dof_frictionloss[self._dofs] = limit_nm
