"""Commands are scaled down to the envelope that `hexctl check` shows, their direction kept."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.assessment.speed_envelope import speed_envelope
from hexctl.control.drive.velocity_limits import VelocityLimits
from hexctl.gait.gait import make_gait
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_limits_are_those_of_the_envelope_for_any_order_of_the_legs(name: str) -> None:
    robot = shipped(name)
    gait = make_gait(robot, "wave")
    limits = VelocityLimits.of(robot, gait)
    envelope = speed_envelope(robot, gait)
    np.testing.assert_allclose(limits.speeds_m_s, envelope.speeds_m_s, rtol=0.05)
    np.testing.assert_allclose(limits.turn_rates_rad_s, envelope.turn_rates_rad_s, rtol=0.05)
    assert VelocityLimits.of(robot, make_gait(robot, "tripod")) is limits


def test_a_body_that_stands_as_high_as_it_can_walks_no_faster() -> None:
    robot = shipped("phantomx")
    gait = make_gait(robot, "tripod")
    high = replace(gait, posture=replace(gait.posture, body_raise=0.2))
    assert (VelocityLimits.of(robot, high).speeds_m_s <= VelocityLimits.of(robot, gait).speeds_m_s).all()


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-5, 5), st.sampled_from([(), (3,), (2, 5)]))
def test_a_velocity_keeps_its_direction_and_shares_the_strokes(
    forward: float, left: float, turn: float, failed: tuple[int, ...]
) -> None:
    limits = VelocityLimits.of(shipped(), make_gait(shipped(), "tripod"))
    velocity = np.array([forward, left, turn])
    limited = limits.limited(velocity, failed)
    speed, rate = math.hypot(*limited[:2]), abs(limited[2])
    most_m_s, most_rad_s = limits.speeds_m_s[0, 0], limits.turn_rates_rad_s[0]  # alike for all, of `ant`
    assert speed / most_m_s + rate / most_rad_s <= 1 + 1e-9
    share = float(np.linalg.norm(limited)) / max(float(np.linalg.norm(velocity)), 1e-300)
    np.testing.assert_allclose(limited, share * velocity, atol=1e-9)
    if math.hypot(forward, left) / most_m_s + abs(turn) / most_rad_s <= 1:
        np.testing.assert_array_equal(limited, velocity)


def test_a_gait_that_cannot_walk_stands() -> None:
    limits = VelocityLimits(np.zeros((7, 8)), np.zeros(7))
    np.testing.assert_array_equal(limits.limited(np.array([0.1, 0.0, 0.0])), np.zeros(3))
