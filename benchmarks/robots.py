"""Shipped robots with other servos, drawn at random by the surveys."""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot

ROBOTS = ("ant", "phantomx", "pexod")


@cache
def shipped(name: str) -> Robot:
    """A shipped robot."""
    return load_robot(name)


def with_servos(robot: Robot, *, stiffness: float = 1.0, torque: float = 1.0) -> Robot:
    """A robot with multiples of its servos' stiffness and torque."""
    servo = replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad)
    return replace(robot, servo=servo, joint_max_torque_nm=torque * robot.joint_max_torque_nm)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform between two bounds."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))
