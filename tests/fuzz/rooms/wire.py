"""Targets on the network: messages of robots, controllers and ROS 2, and datagrams of a stop."""

import hmac
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import N_JOINTS
from hexctl.wire import ros_cdr
from hexctl.wire.pose import decode_orientation, decode_pose, encode_pose
from hexctl.wire.ros.motion_commands import TWIST, TWIST_STAMPED, decode_velocity
from hexctl.wire.ros.ros_session import Attachment
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, MAC_BYTES, MARK_BYTES, Kind, StopDatagram, mark_of
from hexctl.wire.zenoh_messages import (
    CommandTag,
    StateTag,
    decode_battery,
    decode_command,
    decode_joints,
    encode_battery,
    encode_positions,
)
from tests.fuzz.target import Target
from tests.wire.test_zenoh_messages import COMMAND_BYTES, STATE_BYTES

SECRET = bytes(range(32))


def _only(decode: Callable[..., object], *before: object) -> Callable[[bytes], object]:
    return lambda data: decode(*before, data)


def _joints(data: bytes) -> None:
    joint_positions_rad, torques_nm = decode_joints(data)
    assert joint_positions_rad.shape == (N_JOINTS,)
    again, torques = decode_joints(encode_positions(joint_positions_rad, 0, torques_nm))
    assert np.array_equal(again, joint_positions_rad)
    assert (torques is None) == (torques_nm is None)


def _command(data: bytes) -> None:
    attachment, payload = data[: len(COMMAND_BYTES)], data[len(COMMAND_BYTES) :]
    CommandTag.lease_in(attachment)
    tag = CommandTag.unpacked(attachment)
    assert tag.packed() == attachment
    joint_positions_rad, _ = decode_command(payload, attachment)
    assert np.isfinite(joint_positions_rad).all()


def _state_tag(data: bytes) -> None:
    tag = StateTag.unpacked(data)
    again = StateTag.unpacked(tag.packed())
    assert again.packed() == tag.packed()


def _pose(data: bytes) -> None:
    position, quaternion = decode_pose(data)
    if position is not None:
        again, turned = decode_pose(encode_pose(position, quaternion, stamp_ns=0))
        assert again is not None
        assert np.array_equal(again, position)
        assert (turned is None) == (quaternion is None)


def _battery(data: bytes) -> None:
    voltage_v, share = decode_battery(data)
    assert decode_battery(encode_battery(voltage_v, share)) == (voltage_v, share)


def _velocity(data: bytes) -> None:
    with suppress(MessageError):
        decode_velocity(TWIST, data)
    decode_velocity(TWIST_STAMPED, data)


def _attachment(data: bytes) -> None:
    assert Attachment.unpacked(data).packed() == data


def _stop(data: bytes) -> None:
    """Read bytes as they are, and as the content of a datagram with our mark and signature."""
    with suppress(MessageError):
        StopDatagram.unpacked(data, SECRET)
    inside = data[: DATAGRAM_BYTES - MAC_BYTES - MARK_BYTES]
    content = mark_of(SECRET) + inside.ljust(DATAGRAM_BYTES - MAC_BYTES - MARK_BYTES, b"\0")
    read = StopDatagram.unpacked(content + hmac.digest(SECRET, content, "sha256"), SECRET)
    packed = read.packed(SECRET)
    assert len(packed) == DATAGRAM_BYTES
    again = StopDatagram.unpacked(packed, SECRET)
    assert (again.kind, again.nonce, again.epoch, again.stopped) == (
        read.kind,
        read.nonce,
        read.epoch,
        read.stopped,
    )


def _imu() -> bytes:
    """A sensor_msgs/Imu."""
    vector = ros_cdr.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    turned = ros_cdr.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return ros_cdr.encode(
        ros_cdr.make(
            ros_cdr.IMU,
            header=ros_cdr.header(0, "imu"),
            orientation=turned,
            orientation_covariance=np.zeros(9),
            angular_velocity=vector,
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector,
            linear_acceleration_covariance=np.zeros(9),
        )
    )


def _twists() -> tuple[bytes, bytes]:
    vector = ros_cdr.make("geometry_msgs/msg/Vector3", x=0.1, y=0.0, z=0.2)
    twist = ros_cdr.make(TWIST, linear=vector, angular=vector)
    stamped = ros_cdr.make(TWIST_STAMPED, header=ros_cdr.header(5, "base_link"), twist=twist)
    return ros_cdr.encode(twist), ros_cdr.encode(stamped)


def _other_order() -> bytes:
    """Joints by name, the last first."""
    whole = ros_cdr.decode(ros_cdr.JOINT_STATE, encode_positions(np.zeros(N_JOINTS), 0))
    whole.name = whole.name[::-1]
    return ros_cdr.encode(whole)


STANDING = np.linspace(-1.0, 1.0, N_JOINTS)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
NUMBERS = tuple(
    np.array([value], kind).tobytes()
    for kind, value in (("<f8", np.nan), ("<f8", np.inf), ("<f8", 1e308), ("<u4", 2**32 - 1), ("<u4", 18))
)

TARGETS = (
    Target(
        name="joints",
        read=_joints,
        seeds=(
            encode_positions(STANDING, 1),
            encode_positions(STANDING, 1, STANDING),
            _other_order(),
            b"",
        ),
        words=(*NUMBERS, b"leg1_coxa\0", b"\0\1\0\0", b"\0\0\0\0"),
        most_bytes=1200,
    ),
    Target(
        name="command",
        read=_command,
        seeds=(COMMAND_BYTES + encode_positions(STANDING, 1), COMMAND_BYTES),
        words=(*NUMBERS, b"HXCc"),
        most_bytes=1000,
    ),
    Target(
        name="state-tag",
        read=_state_tag,
        seeds=(
            STATE_BYTES,
            StateTag(
                sequence=1,
                stamp_ns=2,
                age_us=3,
                command_sequence=4,
                measured=True,
                healthy=False,
                contacts=np.full(6, True),
                fault="hot",
                stopped="fault: hot",
                stale_joints=np.arange(18) == 5,
            ).packed(),
        ),
        words=(b"HXCs", b"\xf0\x9f\x92\xa5", b"\xff"),
        most_bytes=400,
    ),
    Target(
        name="pose",
        read=_pose,
        seeds=(encode_pose(np.zeros(3), UPRIGHT, stamp_ns=1), encode_pose(None, None, stamp_ns=1)),
        words=NUMBERS,
        most_bytes=1000,
    ),
    Target(
        name="battery",
        read=_battery,
        seeds=(encode_battery(11.1, 0.5), encode_battery(None, None)),
        words=NUMBERS,
        most_bytes=300,
    ),
    Target(
        name="orientation",
        read=_only(decode_orientation),
        seeds=(_imu(),),
        words=NUMBERS,
        most_bytes=500,
    ),
    Target(name="velocity", read=_velocity, seeds=_twists(), words=NUMBERS, most_bytes=300),
    Target(
        name="ros-attachment",
        read=_attachment,
        seeds=(Attachment(1, 2, bytes(16)).packed(),),
        most_bytes=60,
    ),
    Target(
        name="stop-datagram",
        read=_stop,
        seeds=(
            StopDatagram(kind=Kind.ASK, nonce=bytes(8)).packed(SECRET),
            StopDatagram(kind=Kind.STOP, nonce=bytes(8), request=b"12345678").packed(SECRET)[MARK_BYTES:],
            StopDatagram(
                kind=Kind.STATE, nonce=bytes(8), reason="fault: hot", robot="ant", stopped=True, kept=True
            ).packed(SECRET)[MARK_BYTES:],
        ),
        words=(b"\xf0\x9f\x92\xa5", b"\1", b"\2", b"\3"),
        most_bytes=200,
    ),
)
