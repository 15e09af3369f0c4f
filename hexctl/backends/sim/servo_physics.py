"""Gear friction and power of simulated servos, which MuJoCo does not have."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from hexctl.types import ArrayFields, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GearFriction(ArrayFields):
    """Friction of gears: dry + share * |torque| * (1 + |torque| / stall) / 2, with the torque of the motor.

    The linear and the quadratic term of BAM (Duclusaud et al. 2025, model M6) as one number: on runs of an
    XL330 and an STS3215 both are about equal at the stall torque. MuJoCo has no such friction (its issue
    3528), therefore the limit of its dry friction follows the torque, once per control period.

    Attributes:
        dry_nm: without torque, of each joint.
        linear, square_per_nm: factors of the torque and of its square.
        damping_nm_s_per_rad: view of that of MuJoCo's joints: of their gears, and of the back-EMF with power.
    """

    dry_nm: FloatArray
    linear: float
    square_per_nm: FloatArray
    damping_nm_s_per_rad: FloatArray
    gear_damping_nm_s_per_rad: float

    @classmethod
    def of(cls, model: Any, dofs: slice, servo: Any) -> Self | None:
        """Friction of the joints of a MuJoCo model, in the order of its actuators; None if it does not grow.

        `servo` is a `ServoModel` or has its `load_friction` and `gear_damping_nm_s_per_rad`.
        """
        half, dry_nm = servo.load_friction / 2, model.dof_frictionloss[dofs].copy()
        square_per_nm, damping = half / model.actuator_forcerange[:, 1], model.dof_damping[dofs]
        return cls(dry_nm, half, square_per_nm, damping, servo.gear_damping_nm_s_per_rad) if half else None

    def limit_nm(self, forces_nm: FloatArray, speeds_rad_s: FloatArray) -> FloatArray:
        """Most friction of joints at forces of their actuators, leading shape + (joints,)."""
        back_emf = self.damping_nm_s_per_rad - self.gear_damping_nm_s_per_rad
        load_nm = np.abs(forces_nm - back_emf * speeds_rad_s)
        return np.asarray(self.dry_nm + load_nm * (self.linear + self.square_per_nm * load_nm))


class ServoPower:
    """Switch of the power of all servos of a compiled MuJoCo model, in which it is on.

    Args:
        model: whose actuators are the servos.
        dofs: degrees of freedom of their joints.
        gear_damping_nm_s_per_rad: damping that stays without power.
    """

    def __init__(self, model: Any, dofs: slice, gear_damping_nm_s_per_rad: float) -> None:
        limp = (
            (model.actuator_gainprm, 0.0),
            (model.actuator_biasprm, 0.0),
            (model.dof_damping[dofs], gear_damping_nm_s_per_rad),
        )
        self._values = [(in_force, in_force.copy(), without) for in_force, without in limp]
        self.on = True

    def switch(self, *, on: bool) -> None:
        """Switch the power; the friction of the gears stays."""
        for in_force, powered, without in self._values:
            in_force[:] = powered if on else without
        self.on = on
