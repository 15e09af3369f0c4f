"""Orientations of a robot's own on the wire."""

import numpy as np
import pytest

from hexctl.errors import MessageError
from hexctl.wire import ros_cdr
from hexctl.wire.orientation import decode_orientation
from hexctl.wire.ros.telemetry import IMU, imu

#: As ROS orders it: x, y, z, w.
TURNED = np.array([0.1, -0.2, 0.3, np.sqrt(1 - 0.14)])


def test_an_orientation_comes_back_as_it_was() -> None:
    turned = decode_orientation(imu().encode(1, TURNED))
    assert turned is not None
    np.testing.assert_allclose(turned, [TURNED[3], *TURNED[:3]], atol=1e-15)


def test_an_imu_that_knows_no_orientation_has_none() -> None:
    message = ros_cdr.decode(IMU, imu().encode(1, np.zeros(4)))
    message.orientation_covariance = np.array([-1.0] + 8 * [0.0])
    assert decode_orientation(ros_cdr.encode(message)) is None


@pytest.mark.parametrize("numbers", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [0, 0, 0, 2], [np.inf, 0, 0, 0]])
def test_what_is_no_orientation_is_refused(numbers: list[float]) -> None:
    with pytest.raises(MessageError, match="orientation"):
        decode_orientation(imu().encode(1, np.array(numbers, float)))


@pytest.mark.parametrize(
    "payload", [b"", b"\0\1\0\0", bytes(50), imu().encode(1, TURNED)[:200], bytes(70_000)]
)
def test_what_is_no_imu_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError):
        decode_orientation(payload)
