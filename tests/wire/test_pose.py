"""Poses on the wire, whole and by halves, and orientations of a robot's own."""

import numpy as np
import pytest

from hexctl.errors import MessageError
from hexctl.wire import ros_cdr
from hexctl.wire.pose import decode_orientation, decode_pose, encode_pose, odometry
from hexctl.wire.ros.telemetry import imu
from tests.wire.ros.decoding import decoded

STAMP_NS = 1_700_000_001_000_000_002


POSITION, QUATERNION = np.array([1.0, -2.0, 0.5]), np.array([0.6, 0.0, 0.0, 0.8])


def test_a_pose_or_half_of_one_comes_back_as_it_was() -> None:
    for sent in ((POSITION, QUATERNION), (POSITION, None), (None, QUATERNION), (None, None)):
        for back, half in zip(decode_pose(encode_pose(*sent)), sent, strict=True):
            assert back is None if half is None else back is not None and np.allclose(back, half, atol=1e-15)


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


def sent_with(
    variances: dict[int, float], position: list[float] | None = None, quaternion: list[float] | None = None
) -> bytes:
    """A pose with variances by their places among the 36 of its covariance."""
    estimate = ros_cdr.decode(
        ros_cdr.ODOMETRY,
        encode_pose(
            POSITION if position is None else np.array(position, float),
            QUATERNION if quaternion is None else np.array(quaternion, float),
        ),
    )
    covariance = np.array(estimate.pose.covariance)
    covariance[[*variances]] = [*variances.values()]
    estimate.pose.covariance = covariance
    return ros_cdr.encode(estimate)


def test_planar_odometry_knows_position_and_yaw_as_ros_robots_send_it() -> None:
    position, quaternion = decode_pose(sent_with({14: 1e6, 21: 1e6, 28: 1e6}))
    assert position is not None
    assert quaternion is not None
    np.testing.assert_array_equal(position, POSITION)
    np.testing.assert_allclose(quaternion, QUATERNION, atol=1e-15)


@pytest.mark.parametrize(("place", "known"), [(0, (False, True)), (7, (False, True)), (35, (True, False))])
def test_without_a_coordinate_of_the_plane_that_half_is_not_measured(
    place: int, known: tuple[bool, bool]
) -> None:
    assert tuple(half is not None for half in decode_pose(sent_with({place: 1e6}))) == known


def test_what_is_declared_unknown_may_hold_anything() -> None:
    position, quaternion = decode_pose(sent_with({35: 1e6}, quaternion=[0, 0, 0, 0]))
    np.testing.assert_array_equal(position, POSITION)
    assert quaternion is None
    position, quaternion = decode_pose(sent_with({0: 1e6, 7: 1e6}, position=[np.nan, 0, 0]))
    assert position is None
    assert quaternion is not None


def test_a_camera_says_how_sure_it_is_and_that_it_sees_no_tilt() -> None:
    sent = encode_pose(POSITION, QUATERNION, position_variance_m2=4e-6, yaw_variance_rad2=1e-4, stamp_ns=5)
    message = ros_cdr.decode(ros_cdr.ODOMETRY, sent)
    variances = np.diag(np.reshape(message.pose.covariance, (6, 6))).tolist()
    assert variances == [4e-6, 4e-6, 4e-6, 1e6, 1e6, 1e-4]
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 5)
    position, quaternion = decode_pose(sent)
    np.testing.assert_array_equal(position, POSITION)
    assert quaternion is not None


def test_odometry() -> None:
    numbers = np.linspace(0.5, 84.5, 85)
    message = decoded(ros_cdr.ODOMETRY, odometry().encode(STAMP_NS, numbers))
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_001, 2)
    place, turned = message.pose.pose.position, message.pose.pose.orientation
    assert [place.x, place.y, place.z, turned.x, turned.y, turned.z, turned.w] == numbers[:7].tolist()
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == numbers[7:13].tolist()
    assert list(message.pose.covariance) == numbers[13:49].tolist()
    assert list(message.twist.covariance) == numbers[49:].tolist()
    payload = odometry().encode(STAMP_NS, numbers)
    np.testing.assert_array_equal(odometry().decode(payload), numbers)
    assert odometry().decode(payload.replace(b"base_link", b"base_lynk")) is None
    assert odometry().decode(payload[:-1]) is None


#: As ROS orders it: x, y, z, w.
TURNED = np.array([0.1, -0.2, 0.3, np.sqrt(1 - 0.14)])


def test_an_orientation_comes_back_as_it_was_and_an_imu_without_one_has_none() -> None:
    turned = decode_orientation(imu().encode(1, TURNED))
    assert turned is not None
    np.testing.assert_allclose(turned, [TURNED[3], *TURNED[:3]], atol=1e-15)
    message = ros_cdr.decode(ros_cdr.IMU, imu().encode(1, np.zeros(4)))
    message.orientation_covariance = np.array([-1.0] + 8 * [0.0])
    assert decode_orientation(ros_cdr.encode(message)) is None


def test_what_is_no_orientation_is_refused() -> None:
    numbers = ([0, 0, 0, 0], [np.nan, 0, 0, 1], [0, 0, 0, 2], [np.inf, 0, 0, 0])
    payloads = [imu().encode(1, np.array(each, float)) for each in numbers]
    cut_off = imu().encode(1, TURNED)[:200]
    for payload in (*payloads, b"", b"\0\1\0\0", bytes(50), cut_off, bytes(70_000)):
        with pytest.raises(MessageError):
            decode_orientation(payload)
