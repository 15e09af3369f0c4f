"""The parameters of a servo model that an identification may change."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: Shortest dead time that counts as one: a hundredth of a step of the physics.
NO_TIME_S = 2e-5


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number to be identified, with bounds in which the physics make sense.

    Attributes:
        name: a field of `ServoValues`.
        unit: for reports.
        step: change by which its effect is measured: a share of the value, or a time.
        linear: searched as it is; others by their logarithm.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float = 0.03
    linear: bool = False

    def coordinate(self, value: float) -> float:
        """Coordinate of the search for a value, within the bounds; one unit is comparable for all."""
        value = min(max(value, self.low), self.high)
        return value / self.scale if self.linear else float(np.log(value))

    def value(self, coordinate: float) -> float:
        """Value for a coordinate of the search."""
        return coordinate * self.scale if self.linear else float(np.exp(coordinate))

    @property
    def scale(self) -> float:
        """Value of one unit of a linear coordinate."""
        return 0.1

    @property
    def coordinate_step(self) -> float:
        """The step, in the coordinate of the search."""
        return self.step / self.scale if self.linear else self.step


#: In the order of reports. The source of the bounds: published identifications of small servos, twice as far.
PARAMETERS = {
    one.name: one
    for one in (
        Parameter("stiffness_nm_per_rad", "N m/rad", 1e-3, 1e3),
        Parameter("damping_nm_s_per_rad", "N m s/rad", 1e-4, 20.0),
        Parameter("rotor_inertia_kg_m2", "kg m2", 1e-5, 0.5),
        Parameter("dry_friction_nm", "N m", 1e-4, 5.0),
        Parameter("gear_damping_nm_s_per_rad", "N m s/rad", 1e-4, 5.0),
        Parameter("max_torque_nm", "N m", 1e-2, 50.0),
        Parameter("no_load_speed_rad_s", "rad/s", 0.5, 50.0),
        Parameter("dead_time_s", "s", 0.0, 0.05, step=0.002, linear=True),
    )
}


@dataclass(frozen=True, slots=True)
class ServoValues:
    """One servo model, in the form of `ServoModel`: torque = stiffness * error - damping * speed, limited.

    Attributes:
        stiffness_nm_per_rad: of the reference joint or, of servos on a bench, per unit of their P gain.
        no_load_speed_rad_s: infinite without back-EMF.
    """

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    rotor_inertia_kg_m2: float
    dry_friction_nm: float
    gear_damping_nm_s_per_rad: float
    max_torque_nm: float
    no_load_speed_rad_s: float
    dead_time_s: float

    @classmethod
    def of(cls, robot: Robot) -> "ServoValues":
        """Values of a robot file; those of single joint kinds by their means."""
        speeds = robot.joint_no_load_speed_rad_s
        return cls(
            stiffness_nm_per_rad=float(robot.stiffness_nm_per_rad.mean()),
            damping_nm_s_per_rad=robot.servo.damping_nm_s_per_rad,
            rotor_inertia_kg_m2=robot.servo.rotor_inertia_kg_m2,
            dry_friction_nm=float(robot.dry_friction_nm.mean()),
            gear_damping_nm_s_per_rad=robot.servo.gear_damping_nm_s_per_rad,
            max_torque_nm=float(robot.joint_max_torque_nm.mean()),
            no_load_speed_rad_s=np.inf if speeds is None else float(speeds.mean()),
            dead_time_s=robot.servo.dead_time_s,
        )

    @property
    def back_emf_nm_s_per_rad(self) -> float:
        """Torque lost per speed with power."""
        return self.max_torque_nm / self.no_load_speed_rad_s

    def with_values(self, values: Mapping[str, float]) -> "ServoValues":
        """The same with other values of some parameters."""
        return ServoValues(**{name: values.get(name, getattr(self, name)) for name in PARAMETERS})


class PoweredServos:
    """The servos of a compiled MuJoCo model, whose values can be changed, and whose power can be cut.

    Args:
        model: with `position` actuators, one a joint; its actuators keep samples for the longest dead time.
        dofs: degrees of freedom of the joints, in the order of the actuators.
    """

    def __init__(self, model: Any, dofs: slice) -> None:
        self._model, self._dofs, self._values = model, dofs, (0.0, 0.0, 0.0)
        self._stiffness_nm_per_rad: FloatArray = np.zeros(model.nu)

    def set(self, values: ServoValues, stiffness_nm_per_rad: FloatArray | float, dead_steps: int) -> None:
        """Set values, the stiffness of each actuator, and a dead time in steps of the physics; power on."""
        import mujoco

        model = self._model
        model.dof_armature[self._dofs] = values.rotor_inertia_kg_m2
        model.dof_frictionloss[self._dofs] = values.dry_friction_nm
        # The impedance of dry friction follows from the inertia.
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.actuator_forcerange[:, 0] = -values.max_torque_nm
        model.actuator_forcerange[:, 1] = values.max_torque_nm
        # Half a step less, so that rounded times do not matter.
        model.actuator_delay[:] = max(0.0, (dead_steps - 0.5) * model.opt.timestep)
        self._values = (
            values.damping_nm_s_per_rad,
            values.gear_damping_nm_s_per_rad,
            values.back_emf_nm_s_per_rad,
        )
        self._stiffness_nm_per_rad[:] = stiffness_nm_per_rad
        self.power(on=True)

    def power(self, *, on: bool) -> None:
        """Switch the power; without it there is neither control nor back-EMF."""
        model, (damping, gear_damping, back_emf) = self._model, self._values
        stiffness = self._stiffness_nm_per_rad * on
        model.actuator_gainprm[:, 0] = stiffness
        model.actuator_biasprm[:, 1] = -stiffness
        model.actuator_biasprm[:, 2] = -damping * on
        model.dof_damping[self._dofs] = gear_damping + back_emf * on


def between_steps(dead_time_s: float, step_s: float) -> list[tuple[int, float]]:
    """Whole steps about a dead time, with their shares: simulations know whole steps only."""
    whole, part = divmod(dead_time_s / step_s, 1.0)
    if part * step_s < NO_TIME_S:
        return [(int(whole), 1.0)]
    return [(int(whole), 1.0 - part), (int(whole) + 1, part)]
