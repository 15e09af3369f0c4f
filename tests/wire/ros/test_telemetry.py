"""Messages to and from ROS, read by a decoder of others; velocities that are refused."""

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.msg import get_types_from_msg

from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.motion_commands import TWIST, TWIST_STAMPED
from hexctl.wire.ros.telemetry import DiagnosticStatus, Level
from tests.wire.ros.decoding import decoded

STAMP_NS = 1_700_000_001_000_000_002


def test_transforms_have_all_one_stamp() -> None:
    frames = [("odom", "base_link"), ("base_link", "a"), ("a", "tip")]
    numbers = np.random.default_rng(1).normal(size=21)
    message = decoded(telemetry.TRANSFORMS, telemetry.transforms(frames).encode(STAMP_NS, numbers))
    got = message.transforms
    assert [(one.header.frame_id, one.child_frame_id) for one in got] == frames
    assert {(one.header.stamp.sec, one.header.stamp.nanosec) for one in got} == {(1_700_000_001, 2)}
    for one, row in zip(got, numbers.reshape(3, 7), strict=True):
        place, turned = one.transform.translation, one.transform.rotation
        assert [place.x, place.y, place.z, turned.x, turned.y, turned.z, turned.w] == row.tolist()


def test_what_an_imu_does_not_measure_is_marked() -> None:
    message = decoded(ros_cdr.IMU, telemetry.imu().encode(STAMP_NS, np.array([0.1, 0.2, 0.3, 0.9])))
    turned = message.orientation
    assert [turned.x, turned.y, turned.z, turned.w] == [0.1, 0.2, 0.3, 0.9]
    assert message.orientation_covariance[0] == 0
    assert message.angular_velocity_covariance[0] == -1
    assert message.linear_acceleration_covariance[0] == -1


def test_diagnostics() -> None:
    found = [DiagnosticStatus(Level.WARN, "hexctl: robot", "warm", {"battery (V)": "11.1"})]
    payload = telemetry.encode_diagnostics(found, "ant", STAMP_NS)
    (status,) = decoded(telemetry.DIAGNOSTICS, payload).status
    assert (status.level, status.name, status.message, status.hardware_id) == (
        1,
        "hexctl: robot",
        "warm",
        "ant",
    )
    assert [(one.key, one.value) for one in status.values] == [("battery (V)", "11.1")]


def test_an_answer_of_a_trigger() -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("bool success\nstring message", "a/msg/Answer"))
    for success, text in ((True, ""), (False, "stopped: estop"), (True, "é")):
        message = store.types["a/msg/Answer"](success, text)
        payload = telemetry.encode_trigger_answer(success, text)
        assert payload == bytes(store.serialize_cdr(message, "a/msg/Answer"))


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
