"""Robots with another load than the shipped ones: mass, stiffness and torque varied, legs nearer together."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from hexctl import Robot, TrialPlan, TrialResult, make_gait
from hexctl.control.checks.gait_load import GaitLoad, gait_load
from hexctl.control.scoring.score import score
from hexctl.control.trace import TrialFrame
from hexctl.gait.gait import Motion
from hexctl.robot.model import in_stance_of
from hexctl.robot.rotations import about_z
from hexctl.types import FloatArray
from tests.robots import shipped, without_friction
from tests.trials import gait_of


def changed(
    name: str,
    *,
    mass: float = 1.0,
    stiffness: float = 1.0,
    torque: float = 1.0,
    speed: float = 1.0,
    trunk_m: float | None = None,
) -> Robot:
    """A shipped robot with multiples of mass (on the trunk) and servo values, without dry friction.

    `phantomx` has a wide stance, in which its joints carry more.
    """
    robot = without_friction(name)
    robot = in_stance_of(robot, 0.15) if name == "phantomx" else robot
    size_m = (*robot.body.size_m[:2], robot.body.size_m[2] if trunk_m is None else trunk_m)
    body = replace(robot.body, mass_kg=robot.body.mass_kg + (mass - 1) * robot.mass_kg, size_m=size_m)
    servo = replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad)
    return replace(
        robot,
        body=body,
        servo=servo,
        joint_max_torque_nm=torque * robot.joint_max_torque_nm,
        joint_max_speed_rad_s=speed * robot.joint_max_speed_rad_s,
    )


def load_of(robot: Robot) -> GaitLoad:
    return gait_load(robot, make_gait(robot, "demo"), (Motion(),))


def moved(*, share: float = 1.0, back_m: float = 0.0) -> Robot:
    """Pexod with its legs nearer to one another along the body, or all of them further back."""
    robot = shipped("pexod")
    mounts, feet = robot.mount_positions_body.copy(), robot.stance_feet_body.copy()
    mounts[:, 0] = share * mounts[:, 0] - back_m
    feet[:, 0] += mounts[:, 0] - robot.mount_positions_body[:, 0]
    return replace(robot, mount_positions_body=mounts, stance_feet_body=feet)


def scored(
    path: FloatArray, *, heading: float = 0.0, yaws: FloatArray | None = None, status: str = "ok", **plan: Any
) -> TrialResult:
    """Score a path given in the trial frame, (T, 2), of a walk somewhere in the world."""
    origin = np.array([3.0, -2.0, 0.12])
    cos, sin = math.cos(heading), math.sin(heading)
    turned = path @ np.array([[cos, sin], [-sin, cos]])
    world = np.column_stack([turned + origin[:2], np.full(len(path), 0.1) + plan.pop("heights", 0.0)])
    directions = np.zeros(len(path)) if yaws is None else yaws
    quaternions = np.array([about_z(yaw) for yaw in directions]).reshape(-1, 4)
    duration_s, turned_rad = plan.pop("duration_s", 10.0), plan.pop("turned_rad", 0.0)
    hold, energy_j = plan.pop("hold", "none"), plan.pop("energy_j", None)
    return score(
        shipped(),
        TrialPlan(gait=gait_of(shipped()), **plan),
        status=status,
        duration_s=duration_s,
        turned_rad=turned_rad,
        clipped_ticks=3,
        hold=hold,
        energy_j=energy_j,
        frame=TrialFrame(origin, heading, 0.0 if yaws is None else float(yaws[0])),
        positions_world=world,
        quaternions_world=quaternions,
    )


def along(distance: float, off: FloatArray) -> FloatArray:
    return np.column_stack([np.linspace(0, distance, len(off)), off])
