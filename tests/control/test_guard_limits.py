"""Limits of a step for one robot and for a batch, and the same notion of a fall in both."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.guard import FALL_COS_TILT, StepLimits, leaning
from tests.robots import shipped

angle = st.floats(-4, 4)


@given(wanted=st.lists(angle, min_size=18, max_size=18), accepted=st.lists(angle, min_size=18, max_size=18))
def test_one_joint_at_a_time_it_is_range_first_and_then_speed(
    wanted: list[float], accepted: list[float]
) -> None:
    robot = shipped("phantomx")
    limits = StepLimits.of(robot, 0.02)
    got = limits.apply(np.array(wanted), np.array(accepted))
    for joint in range(18):
        step = float(robot.joint_max_speed_rad_s[joint]) * 0.02
        target = min(max(wanted[joint], robot.joint_lower_rad[joint]), robot.joint_upper_rad[joint])
        target = min(max(target, accepted[joint] - step), accepted[joint] + step)
        assert got[joint] == target


def test_many_robots_at_once_equal_each_alone() -> None:
    limits = StepLimits.of(shipped(), 0.02)
    rng = np.random.default_rng(0)
    wanted, accepted = rng.uniform(-2, 2, (2, 7, 18))
    together = limits.apply(wanted, accepted)
    alone = [limits.apply(*row) for row in zip(wanted, accepted, strict=True)]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize(("degrees", "leans"), [(0, False), (49, False), (51, True), (90, True), (180, True)])
def test_a_body_leans_beyond_fifty_degrees(degrees: float, leans: bool) -> None:
    half = np.radians(degrees) / 2
    around_x = np.array([np.cos(half), np.sin(half), 0, 0])
    around_y = np.array([np.cos(half), 0, np.sin(half), 0])
    assert leaning(np.stack([around_x, around_y])).tolist() == [leans, leans]
    assert np.cos(np.radians(50)) == pytest.approx(FALL_COS_TILT)
