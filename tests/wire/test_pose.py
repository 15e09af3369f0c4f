"""Poses on the wire, whole and by halves."""

import numpy as np
import pytest

from hexctl.errors import MessageError
from hexctl.wire import ros_cdr
from hexctl.wire.pose import decode_pose, encode_pose


def test_a_pose_comes_back_as_it_was() -> None:
    position, quaternion = np.array([1.0, -2.0, 0.5]), np.array([0.5, -0.5, 0.5, 0.5])
    back, turned = decode_pose(encode_pose(position, quaternion))
    assert turned is not None
    np.testing.assert_array_equal(back, position)
    np.testing.assert_allclose(turned, quaternion, atol=1e-15)


POSITION, QUATERNION = np.array([1.0, -2.0, 0.5]), np.array([0.6, 0.0, 0.0, 0.8])


@pytest.mark.parametrize(("position", "quaternion"), [(POSITION, None), (None, QUATERNION), (None, None)])
def test_half_a_pose_comes_back_as_it_was(position: np.ndarray | None, quaternion: np.ndarray | None) -> None:
    for back, sent in zip(
        decode_pose(encode_pose(position, quaternion)), (position, quaternion), strict=True
    ):
        assert back is None if sent is None else back is not None and np.allclose(back, sent, atol=1e-15)


def test_what_is_not_measured_of_a_pose_has_a_large_variance_for_ros_tools() -> None:
    pose = ros_cdr.decode(ros_cdr.ODOMETRY, encode_pose(POSITION, None)).pose
    assert np.diag(np.reshape(pose.covariance, (6, 6))).tolist() == [0, 0, 0, 1e6, 1e6, 1e6]
    turned = pose.pose.orientation
    assert (turned.w, turned.x, turned.y, turned.z) == (1, 0, 0, 0)
    pose = ros_cdr.decode(ros_cdr.ODOMETRY, encode_pose(None, QUATERNION)).pose
    assert np.diag(np.reshape(pose.covariance, (6, 6))).tolist() == [1e6, 1e6, 1e6, 0, 0, 0]


@pytest.mark.parametrize(
    ("position", "quaternion"),
    [
        ([np.nan, 0, 0], [1, 0, 0, 0]),
        ([0, np.inf, 0], [1, 0, 0, 0]),
        ([0, 0, 0], [np.nan, 0, 0, 0]),
        ([0, 0, 0], [0, 0, 0, 0]),
        ([0, 0, 0], [3, 0, 0, 0]),
    ],
)
def test_a_pose_that_is_none_is_refused(position: list[float], quaternion: list[float]) -> None:
    with pytest.raises(MessageError, match="pose"):
        decode_pose(encode_pose(np.array(position, float), np.array(quaternion, float)))
