"""What a robot says of its pose besides `odom`."""

import math

import numpy as np

from hexctl.server.served_poses import ServedPoses
from hexctl.wire.pose import decode_orientation, decode_pose

TURNED = np.array([math.cos(0.4), 0.0, 0.0, math.sin(0.4)])


def test_what_is_not_known_is_not_said() -> None:
    assert list(ServedPoses().messages(None, None)) == []


def test_orientation_and_truth_arrive_as_they_are() -> None:
    position = np.array([1.0, -2.0, 0.12])
    messages = dict(ServedPoses().messages(TURNED, (position, TURNED[[0, 3, 1, 2]])))
    own = decode_orientation(messages["imu"])
    assert own is not None
    np.testing.assert_allclose(own, TURNED, atol=1e-15)
    there, turned = decode_pose(messages["truth"])
    assert turned is not None
    np.testing.assert_array_equal(there, position)
    np.testing.assert_allclose(turned, TURNED[[0, 3, 1, 2]], atol=1e-15)
