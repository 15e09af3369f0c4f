"""Slip is made good by what is measured, and what is not measured moves nothing."""

import math
from typing import Any

import numpy as np
import pytest

from hexctl.control.drive.velocity_hold import MOST, VelocityHold
from hexctl.types import FloatArray, RobotState

PERIOD_S = 0.02
MOST_BODY = np.array([0.2, 0.2, 1.0])


class Slipping:
    """A robot whose feet lose a share of each velocity, and what it measures of itself.

    Attributes:
        measures: what it tells: `pose`, `yaw` or nothing.
        frozen: whether what it tells stays as it is.
    """

    def __init__(self, slip: FloatArray, measures: str = "pose") -> None:
        self.hold, self.slip, self.measures = VelocityHold(), slip, measures
        self.position, self.yaw = np.zeros(2), 0.3
        self.told: RobotState | None = None
        self.frozen = False
        self.commanded: FloatArray = np.zeros(3)
        self._ticks = 0

    def state(self) -> RobotState:
        if self.frozen and self.told is not None:
            return self.told
        known: dict[str, Any] = {}
        # A step of a robot moves its sensors by more than their last bit.
        shake = 1e-9 * (self._ticks % 7)
        if self.measures != "nothing":
            half = self.yaw / 2
            known["base_quaternion_world"] = np.array([math.cos(half), shake, 0, math.sin(half)])
        if self.measures == "pose":
            known["base_position_world"] = np.array([*self.position, 0.1]) + shake
        self.told = RobotState(np.zeros(18), 0.0, True, **known)
        return self.told

    def walk(self, wanted: FloatArray, seconds: float) -> FloatArray:
        """Mean velocity of the body in a time."""
        total = np.zeros(3)
        ticks = round(seconds / PERIOD_S)
        for _ in range(ticks):
            self._ticks += 1
            self.commanded = self.hold.update(PERIOD_S, self.state(), wanted, self.commanded, MOST_BODY)
            velocity = self.slip * self.commanded
            cos, sin = math.cos(self.yaw), math.sin(self.yaw)
            x, y, turn = (PERIOD_S * velocity).tolist()
            self.position = self.position + np.array([cos * x - sin * y, sin * x + cos * y])
            self.yaw += turn
            total += velocity
        return np.asarray(total / ticks)


@pytest.mark.parametrize("slip", [0.8, 0.9, 1.13])
@pytest.mark.parametrize("wanted", [(0.1, 0, 0), (0, -0.1, 0), (0, 0, 0.5), (0.05, 0.03, -0.3)])
def test_a_slip_that_stays_costs_no_velocity(slip: float, wanted: tuple[float, float, float]) -> None:
    robot = Slipping(np.full(3, slip))
    robot.walk(np.array(wanted), 8.0)
    np.testing.assert_allclose(robot.walk(np.array(wanted), 4.0), wanted, atol=0.03 * np.abs(wanted).max())


def test_with_the_yaw_alone_only_the_turn_is_made_good() -> None:
    robot = Slipping(np.full(3, 0.8), "yaw")
    wanted = np.array([0.1, 0.0, 0.4])
    robot.walk(wanted, 8.0)
    np.testing.assert_allclose(robot.walk(wanted, 4.0), [0.08, 0.0, 0.4], atol=0.002)


def test_without_a_measurement_a_command_is_as_it_is() -> None:
    robot = Slipping(np.full(3, 0.8), "nothing")
    wanted = np.array([0.1, 0.0, 0.4])
    robot.walk(wanted, 3.0)
    np.testing.assert_array_equal(robot.commanded, wanted)


def test_a_stand_is_a_stand_whatever_was_left_to_make_good() -> None:
    robot = Slipping(np.full(3, 0.5))
    robot.walk(np.array([0.1, 0.0, 0.0]), 5.0)
    robot.walk(np.zeros(3), 0.02)
    np.testing.assert_array_equal(robot.commanded, np.zeros(3))


@pytest.mark.parametrize("what", ["position", "yaw"])
def test_a_jump_of_a_sensor_is_not_followed(what: str) -> None:
    robot = Slipping(np.ones(3))
    wanted = np.array([0.1, 0.0, 0.0])
    robot.walk(wanted, 3.0)
    if what == "position":
        robot.position = robot.position + 1.0
    else:
        robot.yaw += 1.0
    robot.walk(wanted, 0.5)
    np.testing.assert_allclose(robot.commanded, wanted, atol=0.005)


def test_a_pose_that_freezes_is_not_chased() -> None:
    robot = Slipping(np.ones(3))
    wanted = np.array([0.1, 0.0, 0.0])
    robot.walk(wanted, 3.0)
    robot.frozen = True
    robot.walk(wanted, 6.0)
    np.testing.assert_array_equal(robot.commanded, wanted)


def test_the_correction_has_a_bound() -> None:
    robot = Slipping(np.zeros(3))
    robot.walk(np.array([0.1, 0.0, 0.5]), 3.0)
    assert (np.abs(robot.hold.correction) <= MOST * MOST_BODY + 1e-12).all()


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-200, 1e-9, 1e3, 1e200, 1e308])
def test_velocities_of_any_size_give_finite_ones(size: float) -> None:
    robot = Slipping(np.array([0.1, 0.1, 0.1]))
    for _ in range(5):
        wanted = np.array([size, -size, size])
        commanded = np.clip(wanted, -MOST_BODY, MOST_BODY)
        with np.errstate(all="raise", under="ignore", over="ignore"):
            robot.hold.update(PERIOD_S, robot.state(), wanted, commanded, MOST_BODY)
        assert np.isfinite(robot.hold.correction).all()
