"""Body twist of a standing robot about its middle, feet in place: a motion that a camera can time."""

import math

import numpy as np

from hexctl.control.controllers import Controller
from hexctl.ik.legs import solve_legs_within_limits
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, RobotState

#: A twist.
AMPLITUDE_RAD = math.radians(5.0)
FREQUENCY_HZ = 0.7
DURATION_S = 4.0

#: Share of the duration in which the twist fades in, and out.
FADING = 0.2


def wiggle_yaw_rad(times_s: FloatArray) -> FloatArray:
    """Yaw at times, in their shape: a sine within raised cosines, 0 before and afterwards."""
    share = np.clip(np.asarray(times_s, dtype=float) / DURATION_S, 0.0, 1.0)
    edge = np.minimum(np.minimum(share, 1 - share) / FADING, 1.0)
    envelope = (1 - np.cos(np.pi * edge)) / 2
    return np.asarray(AMPLITUDE_RAD * envelope * np.sin(math.tau * FREQUENCY_HZ * DURATION_S * share))


def wiggle_targets_rad(robot: Robot, times_s: FloatArray) -> FloatArray:
    """Joint angles (T, 18) of a twist from the stance at times (T,), as `wiggle_yaw_rad`.

    Raises ReachError or LimitError, naming leg and joint.
    """
    yaw_rad = wiggle_yaw_rad(times_s)
    cos, sin, zero = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)
    one = np.ones_like(yaw_rad)
    back = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
    # Row vectors: a fixed foot rotates backwards in the frame of the body.
    return solve_legs_within_limits(robot, robot.stance_feet_body @ back)


class BodyWiggle(Controller):
    """Twists the body of a robot in its stance about its middle; raises what `wiggle_targets_rad` raises."""

    def __init__(self, robot: Robot, *, period_s: float) -> None:
        steps = np.arange(math.ceil(DURATION_S / period_s) + 1)
        self._targets_rad = wiggle_targets_rad(robot, np.asarray(steps * period_s, dtype=float))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at a step, (18,); the start pose after the end."""
        return np.asarray(self._targets_rad[min(step, len(self._targets_rad) - 1)])

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the twist is over."""
        return step >= len(self._targets_rad) - 1
