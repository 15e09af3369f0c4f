"""Break a leg of a compiled simulation, physically."""

from typing import Any

import mujoco
import numpy as np

from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, BoolArray, FloatArray, leg_slice

#: A jammed gear train is this much stiffer than its servo, and no torque moves it.
JAM_STIFFNESS = 20.0

#: What is left of the mass of a missing leg: MuJoCo needs some.
MISSING_MASS_SHARE = 1e-4


def inject_failure(physics: Any, robot: Robot, failure: Failure | None) -> tuple[BoolArray, FloatArray]:
    """Change the model so that the leg fails.

    Returns which joints hold a fixed angle whatever they are told, and that angle; (18,) each.
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
        _scale_torque(physics, joints, 0.0)
    elif failure.kind == "weak":
        _scale_torque(physics, joints, failure.torque_fraction)
    else:
        _remove_leg(physics, failure.leg)
    return jammed, jammed_at


def _check_angle(robot: Robot, failure: Failure) -> None:
    """Refuse a joint stuck where it cannot go."""
    joint = JOINTS_PER_LEG * (failure.leg - 1) + JOINT_KINDS.index(failure.joint)
    if not robot.joint_lower_rad[joint] <= failure.angle_rad <= robot.joint_upper_rad[joint]:
        low, high = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
        raise InputError(
            f"stuck {failure.joint}: got {np.degrees(failure.angle_rad):g} deg; "
            f"allowed: {low:g} to {high:g} deg"
        )


def _jam(physics: Any, jammed: BoolArray, jammed_at: FloatArray, failure: Failure) -> None:
    """Hold one joint at an angle with far more than the servo's stiffness and torque."""
    joint = JOINTS_PER_LEG * (failure.leg - 1) + JOINT_KINDS.index(failure.joint)
    jammed[joint] = True
    jammed_at[joint] = failure.angle_rad
    model = physics.model
    for gains in (model.actuator_gainprm, model.actuator_biasprm):
        gains[joint] *= JAM_STIFFNESS
    model.actuator_forcerange[joint] *= JAM_STIFFNESS


def _scale_torque(physics: Any, joints: slice, fraction: float) -> None:
    """Multiply every torque that the leg's servos make."""
    model = physics.model
    for array in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
        array[joints] *= fraction


def _remove_leg(physics: Any, leg: int) -> None:
    """Let a leg touch nothing and weigh next to nothing."""
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
    """Return whether a compiled name, robot/leg/part, is of leg 1..6."""
    return name.split("/")[1:2] == [f"leg{leg}"]
