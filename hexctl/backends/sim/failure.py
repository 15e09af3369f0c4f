"""A failed leg in the compiled model: its torques, its jammed joint, or the leg itself."""

from typing import Any

import mujoco
import numpy as np

from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import (
    N_JOINTS,
    BoolArray,
    FloatArray,
    leg_slice,
)

#: Where the joints begin in qvel: after the free joint's velocities.
FIRST_SPEED = 6

#: Stiffness and torque limit of a jammed joint, as multiples of its servo's.
JAM_STIFFNESS = 20.0

#: Remaining share of the mass of a missing leg: MuJoCo needs some.
MISSING_MASS_SHARE = 1e-4


def inject_failure(physics: Any, robot: Robot, failure: Failure | None) -> tuple[BoolArray, FloatArray]:
    """Change the compiled model so that the leg fails.

    The result is which joints hold a fixed angle regardless of their targets, and that angle; (18,) each.
    """
    jammed = np.zeros(N_JOINTS, dtype=bool)
    jammed_at = robot.stance_angles_rad.copy()
    if failure is None:
        return jammed, jammed_at
    joints = leg_slice(failure.leg)
    if failure.kind == "locked":
        jammed[joints] = True
    elif failure.kind == "stuck":
        _check_angle(robot, failure)
        _jam(physics, jammed, jammed_at, failure)
    elif failure.kind == "limp":
        _scale_torque(physics, robot, failure.leg, 0.0)
    elif failure.kind == "weak":
        _scale_torque(physics, robot, failure.leg, failure.torque_fraction)
    else:
        _remove_leg(physics, failure.leg)
    return jammed, jammed_at


def _check_angle(robot: Robot, failure: Failure) -> None:
    """Raise InputError for a joint stuck outside its range."""
    joint = failure.joint_index
    if not robot.joint_lower_rad[joint] <= failure.angle_rad <= robot.joint_upper_rad[joint]:
        low, high = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
        raise InputError(
            f"stuck {failure.joint}: got {np.degrees(failure.angle_rad):g} deg; "
            f"allowed: {low:g} to {high:g} deg"
        )


def _jam(physics: Any, jammed: BoolArray, jammed_at: FloatArray, failure: Failure) -> None:
    """Hold one joint at an angle with far more than the servo's stiffness and torque."""
    joint = failure.joint_index
    jammed[joint] = True
    jammed_at[joint] = failure.angle_rad
    model = physics.model
    for gains in (model.actuator_gainprm, model.actuator_biasprm):
        gains[joint] *= JAM_STIFFNESS
    model.actuator_forcerange[joint] *= JAM_STIFFNESS


def _scale_torque(physics: Any, robot: Robot, leg: int, fraction: float) -> None:
    """Scale all torques of the servos of a leg, their back-EMF too; the friction of its gears stays."""
    model, joints = physics.model, leg_slice(leg)
    for joint in range(N_JOINTS)[joints]:
        model.dof_damping[FIRST_SPEED + joint] -= (1 - fraction) * robot.back_emf_nm_s_per_rad[joint]
    for array in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
        array[joints] *= fraction


def _remove_leg(physics: Any, leg: int) -> None:
    """Remove the contacts of a leg and almost all of its mass."""
    model = physics.model
    for geom in range(model.ngeom):
        if _belongs_to(model.id2name(geom, "geom"), leg):
            model.geom_conaffinity[geom] = 0
    for body in range(model.nbody):
        if _belongs_to(model.id2name(body, "body"), leg):
            model.body_mass[body] *= MISSING_MASS_SHARE
            model.body_inertia[body] *= MISSING_MASS_SHARE
    mujoco.mj_setConst(model.ptr, physics.data.ptr)


def _belongs_to(name: str, leg: int) -> bool:
    """Whether a compiled name, robot/leg/part, belongs to leg 1..6."""
    return name.split("/")[1:2] == [f"leg{leg}"]
