"""Commands, states, poses and tags on the wire: byte-exact, complete, and nothing else."""

import struct
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import MessageError
from hexctl.types import JOINT_NAMES, FloatArray, RobotState
from hexctl.wire import MAX_PAYLOAD_BYTES, ros_cdr
from hexctl.wire.pose import decode_orientation, decode_pose, encode_pose, odometry
from hexctl.wire.ros.telemetry import encode_imu
from hexctl.wire.zenoh_messages import (
    CommandTag,
    StateTag,
    decode_battery,
    decode_command,
    decode_joints,
    decode_positions,
    encode_battery,
    encode_positions,
    tag_of,
)
from tests.wire.ros.decoding import decoded

COMMAND = CommandTag(
    sequence=7, stamp_ns=1_500_000_000, time_to_live_ms=200, lease_id=bytes(range(16)), lease_sequence=3
)
#: The example of docs/reference/zenoh.md.
COMMAND_BYTES = bytes.fromhex(
    "48584363010700000000000000002f685900000000c8000000000102030405060708090a0b0c0d0e0f03000000"
)
STATE = StateTag(
    sequence=9,
    stamp_ns=2_000_000_000,
    age_us=1500,
    command_sequence=7,
    measured=True,
    healthy=False,
    contacts=np.array([True, False, True, True, False, True]),
    fault="low battery",
    stopped=None,
)
STATE_BYTES = bytes.fromhex(
    "485843730109000000000000000094357700000000dc0500000700000000000000052d0b6c6f77206261747465727900"
)

#: Characters of one to four bytes.
texts = st.none() | st.text("a ,ä€🙂", min_size=1, max_size=30)
u32, u64 = st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
i64 = st.integers(-(2**63), 2**63 - 1)


@pytest.mark.parametrize(("tag", "data"), [(COMMAND, COMMAND_BYTES), (STATE, STATE_BYTES)])
def test_the_bytes_of_a_tag(tag: CommandTag | StateTag, data: bytes) -> None:
    assert tag.packed() == data
    assert type(tag).unpacked(data) == tag


@given(
    sequence=u64,
    stamp_ns=i64,
    age_us=u32,
    command_sequence=u64,
    measured=st.booleans(),
    healthy=st.booleans(),
    contacts=st.none() | st.lists(st.booleans(), min_size=6, max_size=6).map(np.array),
    fault=texts,
    stopped=texts,
    stale_joints=st.none()
    | st.sets(st.integers(0, 17), min_size=1).map(lambda some: np.isin(range(18), [*some])),
)
def test_a_states_tag_comes_back_as_it_was(**values: Any) -> None:
    tag = StateTag(**values)
    assert StateTag.unpacked(tag.packed()) == tag


@given(
    sequence=u64,
    stamp_ns=i64,
    time_to_live_ms=u32,
    lease_id=st.binary(min_size=16, max_size=16),
    lease_sequence=u32,
)
def test_a_commands_tag_comes_back_as_it_was(**values: Any) -> None:
    tag = CommandTag(**values)
    assert CommandTag.unpacked(tag.packed()) == tag


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("ä" * 200, "ä" * 58 + "..."),
        ("a" * 100 + " " + "b" * 19, "a" * 100 + " " + "b" * 19),
        ("a" * 100 + ", " + "b" * 19, "a" * 100 + "..."),
        ("a" * 110 + " " + "b" * 6 + " " + "c" * 9, "a" * 110 + " " + "b" * 6 + "..."),
    ],
)
def test_a_text_that_is_too_long_is_cut_at_a_word(fault: str, told: str) -> None:
    assert StateTag.unpacked(replace(STATE, fault=fault).packed()).fault == told


STALE_BYTES = replace(STATE, stale_joints=np.isin(range(18), [0, 17])).packed()


@pytest.mark.parametrize("good", [COMMAND_BYTES, STATE_BYTES, STALE_BYTES])
def test_every_cut_and_every_other_version_is_refused(good: bytes) -> None:
    kind = CommandTag if good is COMMAND_BYTES else StateTag
    for end in range(len(good)):
        with pytest.raises(MessageError):
            kind.unpacked(good[:end])
    with pytest.raises(MessageError):
        kind.unpacked(good + b"\x00")
    with pytest.raises(MessageError, match="version 2"):
        kind.unpacked(good[:4] + b"\x02" + good[5:])


POSITIONS = np.arange(18) / 8
TORQUES = np.linspace(-1.5, 2.0, 18)


def joint_state_by_hand(positions: np.ndarray, stamp_s: int, stamp_ns: int) -> bytes:
    """Sensor_msgs/JointState as little-endian CDR, laid out with nothing but struct."""
    out = struct.pack("<IIIB", stamp_s, stamp_ns, 1, 0)
    out += b"\x00" * (-len(out) % 4) + struct.pack("<I", len(JOINT_NAMES))
    for name in JOINT_NAMES:
        out += b"\x00" * (-len(out) % 4) + struct.pack("<I", len(name) + 1) + name.encode() + b"\x00"
    out += b"\x00" * (-len(out) % 4) + struct.pack("<I", positions.size)
    out += b"\x00" * (-len(out) % 8) + positions.astype("<f8").tobytes()
    return b"\x00\x01\x00\x00" + out + struct.pack("<II", 0, 0)


def test_joint_angles_are_the_bytes_of_a_ros_joint_state() -> None:
    assert encode_positions(POSITIONS, 3_000_000_005) == joint_state_by_hand(POSITIONS, 3, 5)


def joint_state(names: Sequence[str], positions: np.ndarray, effort: np.ndarray | None = None) -> bytes:
    """A joint state as other programs send it."""
    none = np.zeros(0)
    return ros_cdr.encode(
        ros_cdr.make(
            ros_cdr.JOINT_STATE,
            header=ros_cdr.header(0),
            name=list(names),
            position=positions,
            velocity=none,
            effort=none if effort is None else effort,
        )
    )


def test_joints_named_in_another_order_are_put_in_ours() -> None:
    order = np.random.default_rng(0).permutation(18)
    payload = joint_state([JOINT_NAMES[joint] for joint in order], POSITIONS[order], TORQUES[order])
    np.testing.assert_array_equal(decode_positions(payload), POSITIONS)
    np.testing.assert_array_equal(decode_joints(payload)[1], TORQUES)


@pytest.mark.parametrize(
    ("names", "n_positions"),
    [
        (JOINT_NAMES, 17),
        (JOINT_NAMES, 19),
        (JOINT_NAMES[:17], 18),
        ([], 18),
        (["leg1_coxa"] * 18, 18),
        ([*JOINT_NAMES[:17], "tail"], 18),
    ],
)
def test_a_joint_state_of_other_joints_is_refused(names: Sequence[str], n_positions: int) -> None:
    with pytest.raises(MessageError, match="joints"):
        decode_positions(joint_state(names, np.zeros(n_positions)))


VELOCITIES = np.linspace(2.0, -3.0, 18)


def test_torques_and_velocities_are_those_of_a_ros_joint_state() -> None:
    payload = encode_positions(POSITIONS, 0, TORQUES, VELOCITIES)
    message = ros_cdr.decode(ros_cdr.JOINT_STATE, payload)  # as peers read it that know of no torques
    np.testing.assert_array_equal(message.position, POSITIONS)
    np.testing.assert_array_equal(message.effort, TORQUES)
    np.testing.assert_array_equal(message.velocity, VELOCITIES)
    for more in ((TORQUES, VELOCITIES), (TORQUES, None), (None, VELOCITIES), (None, None)):
        for got, sent in zip(
            decode_joints(encode_positions(POSITIONS, 0, *more)), (POSITIONS, *more), strict=True
        ):
            np.testing.assert_array_equal(got, sent)
    for end in range(len(payload) - 150, len(payload) - 8):
        with pytest.raises(MessageError):
            decode_joints(payload[:end])


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_torques_and_velocities_are_unknown_joint_by_joint(unknown: float) -> None:
    sent = np.stack([TORQUES, VELOCITIES])
    sent[0, 17] = sent[1, 7] = unknown
    _, *got = decode_joints(encode_positions(POSITIONS, 0, *sent))
    np.testing.assert_array_equal(got, np.where(np.isfinite(sent), sent, np.nan))


@pytest.mark.parametrize("efforts", [np.zeros(17), np.full(18, np.nan), np.full(18, np.inf)])
def test_efforts_that_are_no_torques_are_unknown(efforts: np.ndarray) -> None:
    payload = joint_state(JOINT_NAMES, POSITIONS, efforts)
    positions, torques, _ = decode_joints(payload)
    np.testing.assert_array_equal(positions, POSITIONS)
    assert torques is None


@pytest.mark.parametrize(("bad", "joint"), [(np.nan, 0), (np.inf, 17), (-np.inf, 5)])
def test_angles_that_are_not_finite_are_refused(bad: float, joint: int) -> None:
    positions = POSITIONS.copy()
    positions[joint] = bad
    with pytest.raises(MessageError, match="finite"):
        decode_positions(encode_positions(positions))


def test_every_cut_of_a_command_one_without_an_attachment_and_one_too_long_are_refused() -> None:
    payload = encode_positions(POSITIONS)
    for end in range(len(payload) - 8):
        with pytest.raises(MessageError):
            decode_command(payload[:end], COMMAND_BYTES)
    with pytest.raises(MessageError, match="attachment"):
        decode_command(payload, None)
    with pytest.raises(MessageError, match=f"{MAX_PAYLOAD_BYTES}"):
        decode_positions(b"\x00\x01\x00\x00" + bytes(8_000_000))


@pytest.mark.parametrize(("voltage_v", "share"), [(11.5, 0.25), (None, 0.5), (12.0, None), (None, None)])
def test_a_battery_comes_back_as_it_was(voltage_v: float | None, share: float | None) -> None:
    assert decode_battery(encode_battery(voltage_v, share)) == (voltage_v, share)


def test_stale_joints_and_contacts_travel_in_the_tag() -> None:
    stale = np.arange(18) % 5 == 3
    contacts = np.array([True, False, True, True, False, True])
    state = RobotState(POSITIONS, 0.0, True, stale_joints=stale, foot_contacts=contacts)
    tag = tag_of(state, sequence=1, stamp_ns=0, command_sequence=0)
    assert tag.packed().endswith((0b10000100001000).to_bytes(4, "little"))
    assert StateTag.unpacked(tag.packed()) == tag


def test_a_prepared_codec_loads_nothing_more_in_a_tick() -> None:
    """The first message of a robot must not cost its controller a tenth of a second."""
    program = """
import sys
import numpy as np
from hexctl.wire import zenoh_messages as messages
assert "rosbags" not in sys.modules
messages.prepare_codec()
before = set(sys.modules)
messages.decode_positions(messages.encode_positions(np.ones(18)))
messages.decode_pose(messages.encode_pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
assert "rosbags" in before and set(sys.modules) == before, set(sys.modules) - before
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


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


@pytest.mark.parametrize(
    ("unknown", "position", "quaternion", "known"),
    [
        ((14, 21, 28), POSITION, QUATERNION, (True, True)),
        ((0,), POSITION, QUATERNION, (False, True)),
        ((7,), POSITION, QUATERNION, (False, True)),
        ((35,), POSITION, QUATERNION, (True, False)),
        ((35,), POSITION, np.zeros(4), (True, False)),
        ((0, 7), np.full(3, np.nan), QUATERNION, (False, True)),
    ],
    ids=["planar odometry", "no x", "no y", "no yaw", "no yaw nor a number", "no plane nor a number"],
)
def test_a_half_without_a_coordinate_of_the_plane_is_not_measured_and_may_hold_anything(
    unknown: tuple[int, ...], position: FloatArray, quaternion: FloatArray, known: tuple[bool, bool]
) -> None:
    message = ros_cdr.decode(ros_cdr.ODOMETRY, encode_pose(position, quaternion))
    covariance = np.array(message.pose.covariance)
    covariance[[*unknown]] = 1e6
    message.pose.covariance = covariance
    back = decode_pose(ros_cdr.encode(message))
    assert tuple(half is not None for half in back) == known
    for half, sent in zip(back, (position, quaternion), strict=True):
        assert half is None or np.allclose(half, sent, atol=1e-15)


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
    payload = odometry().encode(1_700_000_001_000_000_002, numbers)
    message = decoded(ros_cdr.ODOMETRY, payload)
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_001, 2)
    place, turned = message.pose.pose.position, message.pose.pose.orientation
    assert [place.x, place.y, place.z, turned.x, turned.y, turned.z, turned.w] == numbers[:7].tolist()
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    assert [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z] == numbers[7:13].tolist()
    assert list(message.pose.covariance) == numbers[13:49].tolist()
    assert list(message.twist.covariance) == numbers[49:].tolist()
    np.testing.assert_array_equal(odometry().decode(payload), numbers)
    assert odometry().decode(payload.replace(b"base_link", b"base_lynk")) is None
    assert odometry().decode(payload[:-1]) is None


TURNED = np.array([np.sqrt(1 - 0.14), 0.1, -0.2, 0.3])


def test_an_orientation_comes_back_as_it_was_and_an_imu_without_one_has_none() -> None:
    turned = decode_orientation(encode_imu(1, TURNED))
    assert turned is not None
    np.testing.assert_allclose(turned, TURNED, atol=1e-15)
    assert decode_orientation(encode_imu(1, None, np.ones(3))) is None


def test_what_is_no_orientation_is_refused() -> None:
    numbers = ([0, 0, 0, 0], [1, np.nan, 0, 0], [2, 0, 0, 0], [0, np.inf, 0, 0])
    payloads = [encode_imu(1, np.array(each, float)) for each in numbers]
    cut_off = encode_imu(1, TURNED)[:200]
    for payload in (*payloads, b"", b"\0\1\0\0", bytes(50), cut_off, bytes(70_000)):
        with pytest.raises(MessageError):
            decode_orientation(payload)
