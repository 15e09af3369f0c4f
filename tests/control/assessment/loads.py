"""Robots with another load than the shipped ones: mass, stiffness and torque varied, legs nearer together."""

from dataclasses import replace

from hexctl import Robot, make_gait
from hexctl.control.assessment.gait_load import GaitLoad, gait_load
from hexctl.gait.gait import Motion
from hexctl.robot.model import in_stance_of
from tests.robots import shipped, without_friction

AHEAD = (Motion(),)


def changed(name: str, *, mass: float = 1.0, stiffness: float = 1.0, torque: float = 1.0) -> Robot:
    """A shipped robot with multiples of mass (on the trunk), stiffness and torque, without dry friction.

    `phantomx` has a wide stance, in which its joints carry more.
    """
    robot = without_friction(name)
    robot = in_stance_of(robot, 0.15) if name == "phantomx" else robot
    body = replace(robot.body, mass_kg=robot.body.mass_kg + (mass - 1) * robot.mass_kg)
    servo = replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad)
    return replace(robot, body=body, servo=servo, joint_max_torque_nm=torque * robot.joint_max_torque_nm)


def load_of(robot: Robot, gait: str = "demo") -> GaitLoad:
    return gait_load(robot, make_gait(robot, gait), AHEAD)


def moved_together(share: float) -> Robot:
    """Pexod with its legs nearer to one another along the body."""
    robot = shipped("pexod")
    mounts, feet = robot.mount_positions_body.copy(), robot.stance_feet_body.copy()
    mounts[:, 0] *= share
    feet[:, 0] += mounts[:, 0] - robot.mount_positions_body[:, 0]
    return replace(robot, mount_positions_body=mounts, stance_feet_body=feet)


def moved_back(back_m: float) -> Robot:
    """Pexod with all its legs further back, so that its weight is before its feet."""
    robot = shipped("pexod")
    mounts, feet = robot.mount_positions_body.copy(), robot.stance_feet_body.copy()
    mounts[:, 0] -= back_m
    feet[:, 0] -= back_m
    return replace(robot, mount_positions_body=mounts, stance_feet_body=feet)
