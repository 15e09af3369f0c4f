"""Velocities from ROS: both types, and what is refused."""

import random

import numpy as np
import pytest

from hexctl.errors import MessageError
from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.ros.velocity import TWIST, TWIST_STAMPED, decode_velocity
from tests.server.test_hostile_input import spoiled


def twist(kind: str, velocity: FloatArray) -> bytes:
    """A velocity as a message of a type."""
    forward, left, turn = velocity.tolist()
    message = ros_cdr.make(
        TWIST,
        linear=ros_cdr.make("geometry_msgs/msg/Vector3", x=forward, y=left, z=7.0),
        angular=ros_cdr.make("geometry_msgs/msg/Vector3", x=7.0, y=7.0, z=turn),
    )
    if kind == TWIST_STAMPED:
        message = ros_cdr.make(TWIST_STAMPED, header=ros_cdr.header(0, "base_link"), twist=message)
    return ros_cdr.encode(message)


KINDS = pytest.mark.parametrize("kind", [TWIST, TWIST_STAMPED])


@KINDS
def test_forward_left_and_turn(kind: str) -> None:
    wanted = np.array([0.1, -0.05, 0.3])
    np.testing.assert_array_equal(decode_velocity(kind, twist(kind, wanted)), wanted)


@KINDS
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_velocity_that_is_not_finite_is_refused(kind: str, bad: float) -> None:
    with pytest.raises(MessageError, match="finite"):
        decode_velocity(kind, twist(kind, np.array([0.0, 0.0, bad])))


@KINDS
def test_spoiled_messages_are_refused_or_finite(kind: str) -> None:
    chance, good, refused = random.Random(kind), twist(kind, np.array([0.1, 0.0, 0.0])), 0
    for _ in range(3000):
        try:
            assert np.isfinite(decode_velocity(kind, spoiled(good, chance))).all()
        except MessageError:
            refused += 1
    assert refused > 1000
