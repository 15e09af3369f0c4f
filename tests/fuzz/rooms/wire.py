"""Targets on the network: messages of robots, controllers and ROS 2, and datagrams of a stop."""

import hmac
from contextlib import suppress

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import N_JOINTS
from hexctl.wire import ros_cdr
from hexctl.wire.pose import decode_orientation, decode_pose, encode_pose
from hexctl.wire.ros.motion_commands import TWIST, TWIST_STAMPED, decode_velocity
from hexctl.wire.ros.ros_session import Attachment
from hexctl.wire.ros.telemetry import encode_imu
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
from tests.fuzz.target import BINARY_NUMBERS, target
from tests.wire.ros.test_telemetry import twist
from tests.wire.test_zenoh_messages import COMMAND_BYTES, STATE_BYTES

SECRET = bytes(range(32))
STANDING = np.linspace(-1.0, 1.0, N_JOINTS)
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def _other_order() -> bytes:
    """Joints by name, the last first."""
    whole = ros_cdr.decode(ros_cdr.JOINT_STATE, encode_positions(np.zeros(N_JOINTS), 0))
    whole.name = whole.name[::-1]
    return ros_cdr.encode(whole)


@target(
    encode_positions(STANDING, 1),
    encode_positions(STANDING, 1, STANDING),
    encode_positions(STANDING, 1, STANDING, STANDING),
    _other_order(),
    b"",
    words=(*BINARY_NUMBERS, b"leg1_coxa\0", b"\0\1\0\0", b"\0\0\0\0"),
)
def read_joints(data: bytes) -> None:
    joint_positions_rad, *more = decode_joints(data)
    assert joint_positions_rad.shape == (N_JOINTS,)
    again, *same = decode_joints(encode_positions(joint_positions_rad, 0, *more))
    assert np.array_equal(again, joint_positions_rad)
    assert [one is None for one in same] == [one is None for one in more]


@target(COMMAND_BYTES + encode_positions(STANDING, 1), COMMAND_BYTES, words=(*BINARY_NUMBERS, b"HXCc"))
def read_command(data: bytes) -> None:
    attachment, payload = data[: len(COMMAND_BYTES)], data[len(COMMAND_BYTES) :]
    CommandTag.lease_in(attachment)
    tag = CommandTag.unpacked(attachment)
    assert tag.packed() == attachment
    joint_positions_rad, _ = decode_command(payload, attachment)
    assert np.isfinite(joint_positions_rad).all()


OTHER_STATE = StateTag(
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
)


@target(STATE_BYTES, OTHER_STATE.packed(), words=(b"HXCs", b"\xf0\x9f\x92\xa5", b"\xff"))
def read_state_tag(data: bytes) -> None:
    tag = StateTag.unpacked(data)
    again = StateTag.unpacked(tag.packed())
    assert again.packed() == tag.packed()


@target(
    encode_pose(np.zeros(3), UPRIGHT, stamp_ns=1), encode_pose(None, None, stamp_ns=1), words=BINARY_NUMBERS
)
def read_pose(data: bytes) -> None:
    position, quaternion = decode_pose(data)
    if position is not None:
        again, turned = decode_pose(encode_pose(position, quaternion, stamp_ns=0))
        assert again is not None
        assert np.array_equal(again, position)
        assert (turned is None) == (quaternion is None)


@target(encode_battery(11.1, 0.5), encode_battery(None, None), words=BINARY_NUMBERS)
def read_battery(data: bytes) -> None:
    voltage_v, share = decode_battery(data)
    assert decode_battery(encode_battery(voltage_v, share)) == (voltage_v, share)


@target(encode_imu(0, np.array([1.0, 0.0, 0.0, 0.0])), words=BINARY_NUMBERS)
def read_orientation(data: bytes) -> None:
    decode_orientation(data)


@target(*(twist(kind, np.array([0.1, 0.0, 0.2])) for kind in (TWIST, TWIST_STAMPED)), words=BINARY_NUMBERS)
def read_velocity(data: bytes) -> None:
    with suppress(MessageError):
        decode_velocity(TWIST, data)
    decode_velocity(TWIST_STAMPED, data)


@target(Attachment(1, 2, bytes(16)).packed())
def read_ros_attachment(data: bytes) -> None:
    assert Attachment.unpacked(data).packed() == data


@target(
    StopDatagram(kind=Kind.ASK, nonce=bytes(8)).packed(SECRET),
    StopDatagram(kind=Kind.STOP, nonce=bytes(8), request=b"12345678").packed(SECRET)[MARK_BYTES:],
    StopDatagram(
        kind=Kind.STATE, nonce=bytes(8), reason="fault: hot", robot="ant", stopped=True, on_disk=True
    ).packed(SECRET)[MARK_BYTES:],
    words=(b"\xf0\x9f\x92\xa5", b"\1", b"\2", b"\3"),
)
def read_stop_datagram(data: bytes) -> None:
    """Read bytes as they are, and as the content of a datagram with our mark and signature."""
    with suppress(MessageError):
        StopDatagram.unpacked(data, SECRET)
    inside = data[: DATAGRAM_BYTES - MAC_BYTES - MARK_BYTES]
    content = mark_of(SECRET) + inside.ljust(DATAGRAM_BYTES - MAC_BYTES - MARK_BYTES, b"\0")
    read = StopDatagram.unpacked(content + hmac.digest(SECRET, content, "sha256"), SECRET)
    packed = read.packed(SECRET)
    assert len(packed) == DATAGRAM_BYTES
    again = StopDatagram.unpacked(packed, SECRET)
    for name in ("kind", "nonce", "epoch", "stopped"):
        assert getattr(again, name) == getattr(read, name)
