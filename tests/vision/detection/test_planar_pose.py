import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.robot.rotations import wrapped_rad
from hexctl.vision.detection.planar_pose import PlanarPose, tag_pose
from hexctl.vision.detection.tags import UNIT_CORNERS
from tests.vision.scenes import CAMERA

POSES = st.builds(PlanarPose, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.1, 3.1))


@given(POSES, POSES)
def test_a_motion_and_its_inverse_lead_back(pose: PlanarPose, motion: PlanarPose) -> None:
    back = pose.after(motion).after(motion.inverse())
    assert (back.x_m, back.y_m) == pytest.approx((pose.x_m, pose.y_m), abs=1e-9)
    assert wrapped_rad(back.yaw_rad - pose.yaw_rad) == pytest.approx(0, abs=1e-9)


def test_a_motion_is_in_the_frame_of_the_pose() -> None:
    ahead = PlanarPose(1.0, 2.0, math.pi / 2).after(PlanarPose(0.5, 0.1, 0.2))
    assert (ahead.x_m, ahead.y_m, ahead.yaw_rad) == pytest.approx((0.9, 2.5, math.pi / 2 + 0.2))


@given(
    pose=st.builds(PlanarPose, st.floats(-0.8, 1), st.floats(-0.8, 0.8), st.floats(-3.1, 3.1)),
    height_m=st.floats(0, 0.3),
)
def test_a_tag_is_where_its_corners_are_seen(pose: PlanarPose, height_m: float) -> None:
    corners = np.column_stack([pose.of_points(0.1 * UNIT_CORNERS), np.full(4, height_m)])
    seen = tag_pose(CAMERA, CAMERA.pixels(corners), height_m)
    assert seen is not None
    assert (seen.pose.x_m, seen.pose.y_m) == pytest.approx((pose.x_m, pose.y_m), abs=1e-4)
    assert abs(wrapped_rad(seen.pose.yaw_rad - pose.yaw_rad)) < 1e-3
    assert seen.scale == pytest.approx(0.1, abs=1e-4)
    assert seen.residual_m < 1e-4


def test_a_tag_that_lies_lower_than_believed_looks_smaller() -> None:
    corners = np.column_stack([0.1 * UNIT_CORNERS, np.zeros(4)])
    seen = tag_pose(CAMERA, CAMERA.pixels(corners), 0.15)
    assert seen is not None
    assert seen.scale < 0.095


def test_a_tag_above_the_horizon_has_no_pose() -> None:
    assert tag_pose(CAMERA, np.full((4, 2), [640.0, -2000.0]), 0.0) is None
