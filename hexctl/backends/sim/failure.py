"""A failed leg in the compiled model: its torques, its jammed joint, or the leg itself."""

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from hexctl.errors import InputError
from hexctl.robot.failure import BROKEN_KINDS, UNKNOWN, Failure
from hexctl.robot.model import Robot
from hexctl.types import (
    JOINT_KINDS,
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


#: Standard deviation of the angle at which a joint of an unknown failure jams, about its angle in the stance.
JAM_SPREAD_RAD = math.radians(20.0)

#: Share of the torque that a weak leg of an unknown failure has.
WEAK_SHARES = (0.05, 0.6)


def drawn_failure(robot: Robot, failure: Failure | None, seed: int) -> Failure | None:
    """The failure that a simulation with a seed applies: the one given, or one drawn where it is `unknown`.

    Every kind is as likely as any other. A jammed joint is any of the three, near its angle in the stance.
    """
    if failure is None or failure.kind != UNKNOWN:
        return failure
    rng = np.random.default_rng((seed, failure.leg))
    kind, joint = str(rng.choice(BROKEN_KINDS)), str(rng.choice(JOINT_KINDS))
    drawn = Failure(leg=failure.leg, kind=kind, joint=joint, torque_fraction=float(rng.uniform(*WEAK_SHARES)))
    index = drawn.joint_index
    angle_rad = robot.stance_angles_rad[index] + JAM_SPREAD_RAD * rng.standard_normal()
    within_rad = np.clip(angle_rad, robot.joint_lower_rad[index], robot.joint_upper_rad[index])
    return replace(drawn, angle_rad=float(within_rad))


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
