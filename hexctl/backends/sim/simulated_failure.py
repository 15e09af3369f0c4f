"""Failed legs in the compiled model: torques, jammed joints, or missing legs."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.errors import InputError
from hexctl.mujoco_import import mujoco
from hexctl.robot.failure import Failure, FailureEvent, Failures, each_failure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, N_LEGS, BoolArray, FloatArray, leg_slice

#: An event this near before a control period, as a share of one, belongs to it.
ROUNDING = 1e-6

#: Where the joints begin in qvel: after the free joint's velocities.
FIRST_SPEED = 6

#: Stiffness and torque limit of a jammed joint, as multiples of its servo's.
JAM_STIFFNESS = 20.0

#: Remaining share of the mass of a missing leg: MuJoCo needs some.
MISSING_MASS_SHARE = 1e-4

#: A depth of contact that no foot reaches.
OUT_OF_REACH_M = 1e3

#: What a failure changes in MuJoCo's model.
_CHANGED = (
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_forcerange",
    "dof_damping",
    "geom_conaffinity",
    "pair_margin",
    "body_mass",
    "body_inertia",
)


class FailedLegs:
    """Failed legs of a simulation, changeable while it runs; `jammed` joints ignore their targets, (18,)."""

    def __init__(self, physics: Any, robot: Robot) -> None:
        self._model, self._robot = physics.model.ptr, robot
        self._whole = {name: getattr(self._model, name).copy() for name in _CHANGED}
        self._parts = {leg: _parts_of(physics.model, leg) for leg in range(1, N_LEGS + 1)}
        self.by_leg: dict[int, Failure] = {}
        self.jammed: BoolArray = np.zeros(N_JOINTS, dtype=bool)

    @property
    def gear_damping_nm_s_per_rad(self) -> float:
        """Viscous friction of every joint."""
        return self._robot.servo.gear_damping_nm_s_per_rad

    @property
    def stiff(self) -> BoolArray:
        """Joints jammed at their angles, (18,); other jammed joints hold targets."""
        stiff = np.zeros(N_JOINTS, dtype=bool)
        for failure in self.by_leg.values():
            if failure.kind == "stuck":
                stiff[failure.joint_index] = True
        return stiff

    @property
    def servo_springs(self) -> tuple[FloatArray, FloatArray]:
        """Stiffness and torque limit of the intact robot's servos, (18,) each."""
        limits = np.abs(self._whole["actuator_forcerange"]).max(axis=-1)
        return self._whole["actuator_gainprm"][:, 0], limits

    @property
    def driven(self) -> BoolArray:
        """Joints driven by a servo, (18,); not those of missing legs."""
        driven = np.ones(N_JOINTS, dtype=bool)
        for failure in self.by_leg.values():
            if failure.kind == "missing":
                driven[leg_slice(failure.leg)] = False
        return driven

    def change(self, leg: int, failure: Failure | None, scratch: Any = None) -> None:
        """Let a leg, 1..6, fail, or heal for None; the other legs stay as they are.

        `scratch` is MjData of the model that may be overwritten; None makes one if needed.
        """
        for name, values in self._whole.items():
            getattr(self._model, name)[:] = values
        had_missing = any(one.kind == "missing" for one in self.by_leg.values())
        self.by_leg.pop(leg, None)
        if failure is not None:
            self.by_leg[leg] = failure
        self.jammed[:] = False
        for one in self.by_leg.values():
            self._apply(one)
        if had_missing or (failure is not None and failure.kind == "missing"):
            mujoco.mj_setConst(self._model, mujoco.MjData(self._model) if scratch is None else scratch)

    def _apply(self, failure: Failure) -> None:
        if failure.kind == "locked":
            self.jammed[leg_slice(failure.leg)] = True
        elif failure.kind == "stuck":
            self._jam(failure.joint_index)
        elif failure.kind in ("limp", "weak"):
            self._scale_torque(failure.joints, 0.0 if failure.kind == "limp" else failure.torque_fraction)
        else:
            self._remove(failure.leg)

    def _jam(self, joint: int) -> None:
        """Hold one joint with far more than the servo's stiffness and torque."""
        self.jammed[joint] = True
        for gains in (self._model.actuator_gainprm, self._model.actuator_biasprm):
            gains[joint] *= JAM_STIFFNESS
        self._model.actuator_forcerange[joint] *= JAM_STIFFNESS

    def _scale_torque(self, joints: tuple[int, ...], fraction: float) -> None:
        """Scale all torques of servos, with their back-EMF; the friction of the gears stays."""
        model = self._model
        for joint in joints:
            lost = (1 - fraction) * self._robot.back_emf_nm_s_per_rad[joint]
            model.dof_damping[FIRST_SPEED + joint] -= lost
            for array in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
                array[joint] *= fraction

    def _remove(self, leg: int) -> None:
        model, (geoms, pairs, bodies) = self._model, self._parts[leg]
        model.geom_conaffinity[geoms] = 0
        # Nothing is as deep in the floor as this margin asks for.
        model.pair_margin[pairs] = -OUT_OF_REACH_M
        model.body_mass[bodies] *= MISSING_MASS_SHARE
        model.body_inertia[bodies] *= MISSING_MASS_SHARE


def _parts_of(model: Any, leg: int) -> tuple[list[int], list[int], list[int]]:
    """Ids of the geoms, explicit pairs of geoms, and bodies of a leg."""
    geoms = [geom for geom in range(model.ngeom) if _belongs_to(model.id2name(geom, "geom"), leg)]
    bodies = [body for body in range(model.nbody) if _belongs_to(model.id2name(body, "body"), leg)]
    return geoms, [pair for pair in range(model.npair) if model.pair_geom2[pair] in geoms], bodies


class FailuresToCome:
    """Scheduled failures and healings of a walk.

    Args:
        events: in the order of their times; one takes effect at the beginning of its control period.
    """

    def __init__(self, events: Sequence[FailureEvent], period_s: float) -> None:
        self._events, self._period_s, self._step = list(events), period_s, -1

    def due(self) -> list[FailureEvent]:
        """Due events, asked before each control period from the one at whose end the walk begins."""
        if not self._events:
            return []
        now_s = self._step * self._period_s
        self._step += 1
        due = [event for event in self._events if event.at_s < now_s + (1 - ROUNDING) * self._period_s]
        if self._step == 0:  # the walk has not begun
            due = []
        del self._events[: len(due)]
        return due


def jam_rad(failed: FailedLegs, qpos: FloatArray, ctrl: FloatArray) -> FloatArray:
    """Angles of joints that jam now, leading shape + (18,).

    Stuck joints keep those in `qpos`, leading shape + (25,), locked ones their last commands, leading shape +
    (18,).
    """
    return np.where(failed.stiff, qpos[..., -N_JOINTS:], ctrl)


def check_stuck_angle(robot: Robot, failure: Failure) -> None:
    """Raise InputError for a joint stuck outside its range."""
    joint = failure.joint_index
    if not robot.joint_lower_rad[joint] <= failure.angle_rad <= robot.joint_upper_rad[joint]:
        low, high = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
        raise InputError(
            f"stuck {failure.joint}: got {np.degrees(failure.angle_rad):g} deg; "
            f"allowed: {low:g} to {high:g} deg"
        )


def jammed_angles_rad(robot: Robot, failures: Failures) -> FloatArray:
    """Angles of jammed joints at the beginning, (18,)."""
    angles_rad: FloatArray = robot.stance_angles_rad.copy()
    for failure in each_failure(failures):
        if failure.kind == "stuck":
            angles_rad[failure.joint_index] = failure.angle_rad
    return angles_rad


def _belongs_to(name: str, leg: int) -> bool:
    return name.split("/")[1:2] == [f"leg{leg}"]
