"""Commands, states and descriptions on the wire: byte-exact, whole, and nothing else."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from hexctl.errors import MessageError, RobotFaultError
from hexctl.types import JOINT_NAMES, RobotState
from hexctl.wire import ros
from hexctl.wire.command import decode_command, decode_positions, encode_positions
from hexctl.wire.describe import check_same_robot, decode_json, describe, encode_json, robot_of
from hexctl.wire.protocol import MAX_PAYLOAD_BYTES
from hexctl.wire.state import (
    contacts_of,
    decode_battery,
    decode_pose,
    encode_battery,
    encode_pose,
    tag_of,
)
from tests.robots import shipped
from tests.wire.test_tags import COMMAND_BYTES

POSITIONS = np.arange(18) / 8


def joint_state_by_hand(positions: np.ndarray, stamp_s: int, stamp_ns: int) -> bytes:
    """Return sensor_msgs/JointState as little-endian CDR, laid out with nothing but struct."""
    out = struct.pack("<IIIB", stamp_s, stamp_ns, 1, 0)
    out += b"\x00" * (-len(out) % 4) + struct.pack("<I", len(JOINT_NAMES))
    for name in JOINT_NAMES:
        out += b"\x00" * (-len(out) % 4) + struct.pack("<I", len(name) + 1) + name.encode() + b"\x00"
    out += b"\x00" * (-len(out) % 4) + struct.pack("<I", positions.size)
    out += b"\x00" * (-len(out) % 8) + positions.astype("<f8").tobytes()
    return b"\x00\x01\x00\x00" + out + struct.pack("<II", 0, 0)


def test_joint_angles_are_the_bytes_of_a_ros_joint_state() -> None:
    assert encode_positions(POSITIONS, 3_000_000_005) == joint_state_by_hand(POSITIONS, 3, 5)


def test_joint_angles_come_back_as_they_were() -> None:
    np.testing.assert_array_equal(decode_positions(encode_positions(POSITIONS)), POSITIONS)


def test_joints_named_in_another_order_are_put_in_ours() -> None:
    order = np.random.default_rng(0).permutation(18)
    payload = ros.encode(
        ros.make(
            ros.JOINT_STATE,
            header=ros.header(0),
            name=[JOINT_NAMES[joint] for joint in order],
            position=POSITIONS[order],
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
    )
    np.testing.assert_array_equal(decode_positions(payload), POSITIONS)


@pytest.mark.parametrize(
    ("names", "n_positions"),
    [
        (list(JOINT_NAMES), 17),
        (list(JOINT_NAMES), 19),
        (list(JOINT_NAMES[:17]), 18),
        ([], 18),
        (["leg1_coxa"] * 18, 18),
        ([*JOINT_NAMES[:17], "tail"], 18),
    ],
)
def test_a_joint_state_of_other_joints_is_refused(names: list[str], n_positions: int) -> None:
    payload = ros.encode(
        ros.make(
            ros.JOINT_STATE,
            header=ros.header(0),
            name=names,
            position=np.zeros(n_positions),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
    )
    with pytest.raises(MessageError, match="joints: got"):
        decode_positions(payload)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("joint", [0, 17])
def test_angles_that_are_not_finite_are_refused(bad: float, joint: int) -> None:
    positions = POSITIONS.copy()
    positions[joint] = bad
    with pytest.raises(MessageError, match="not finite"):
        decode_positions(encode_positions(positions))


def test_a_message_of_a_million_joints_is_refused_unread() -> None:
    with pytest.raises(MessageError, match=f"allowed: {MAX_PAYLOAD_BYTES}"):
        decode_positions(b"\x00\x01\x00\x00" + bytes(8_000_000))


def test_every_cut_of_a_command_is_refused() -> None:
    payload = encode_positions(POSITIONS)
    for end in range(len(payload) - 8):
        with pytest.raises(MessageError):
            decode_command(payload[:end], COMMAND_BYTES)


def test_a_command_without_an_attachment_is_refused() -> None:
    with pytest.raises(MessageError, match="no attachment"):
        decode_command(encode_positions(POSITIONS), None)


def test_a_pose_comes_back_as_it_was() -> None:
    position, quaternion = np.array([1.0, -2.0, 0.5]), np.array([0.5, -0.5, 0.5, 0.5])
    back = decode_pose(encode_pose(position, quaternion))
    np.testing.assert_array_equal(back[0], position)
    np.testing.assert_allclose(back[1], quaternion, atol=1e-15)


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


@pytest.mark.parametrize(("voltage_v", "share"), [(11.5, 0.25), (None, 0.5), (12.0, None), (None, None)])
def test_a_battery_comes_back_as_it_was(voltage_v: float | None, share: float | None) -> None:
    assert decode_battery(encode_battery(voltage_v, share)) == (voltage_v, share)


def test_contacts_travel_in_the_tag() -> None:
    contacts = np.array([True, False, True, True, False, True])
    state = RobotState(POSITIONS, 0.0, True, foot_contacts=contacts)
    tag = tag_of(state, sequence=1, stamp_ns=0, command_sequence=0)
    np.testing.assert_array_equal(contacts_of(tag), contacts)
    assert contacts_of(replace(tag, contacts=None)) is None


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_a_robot_recognises_its_own_description(name: str) -> None:
    answer = decode_json(encode_json(describe(shipped(name))))
    check_same_robot(answer, shipped(name))
    check_same_robot(answer, robot_of(answer))


def test_another_robot_is_refused_with_the_place_where_it_differs() -> None:
    answer = describe(shipped())
    answer["robot"]["mount_positions_body"][2][1] += 0.001
    with pytest.raises(RobotFaultError, match=r"mount_positions_body\[2\]\[1\] is .* there and .* here"):
        check_same_robot(answer, shipped())


def test_another_protocol_or_other_joints_are_refused() -> None:
    with pytest.raises(RobotFaultError, match="protocol 2"):
        check_same_robot({**describe(shipped()), "protocol": 2}, shipped())
    with pytest.raises(RobotFaultError, match="other joints"):
        check_same_robot({**describe(shipped()), "joints": list(JOINT_NAMES[::-1])}, shipped())
    with pytest.raises(RobotFaultError):
        check_same_robot({}, shipped())


@pytest.mark.parametrize("payload", [b"", b"{", b"[]", b"1", b"\xff", b"[" * 60_000, b"x" * 70_000])
def test_what_is_no_json_object_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError, match="JSON: got"):
        decode_json(payload)


@pytest.mark.parametrize("spoil", [{}, {"protocol": 1, "robot": {"name": "x"}}, {"protocol": 1, "robot": 5}])
def test_a_description_of_no_robot_is_refused(spoil: dict[str, object]) -> None:
    with pytest.raises(RobotFaultError, match="describes itself"):
        robot_of(spoil)
