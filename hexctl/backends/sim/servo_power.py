"""The power of simulated servos: without it there is neither control nor back-EMF."""

from typing import Any


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
