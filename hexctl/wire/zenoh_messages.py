"""Messages between a robot and its controllers: commands and states as ROS 2 payloads with a tag.

A tag is a Zenoh attachment with what the ROS 2 message lacks; docs/reference/zenoh.md lists its bytes.
"""

import math
import struct
import time
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import JOINT_NAMES, N_JOINTS, N_LEGS, ArrayFields, BoolArray, FloatArray, RobotState
from hexctl.wire import PROTOCOL_VERSION, ros_cdr
from hexctl.wire.pose import decode_pose, encode_pose
from hexctl.wire.ros_cdr import FixedMessage

LEASE_ID_BYTES = 16

_COMMAND = struct.Struct("<4sBQqI16sI")

#: The end of a command's tag.
_LEASE = struct.Struct("<16sI")
_STATE = struct.Struct("<4sBQqIQBB")
_STALE = struct.Struct("<I")
_COMMAND_MAGIC = b"HXCc"
_STATE_MAGIC = b"HXCs"
_MEASURED, _HEALTHY, _CONTACTS_KNOWN, _STALE_JOINTS = 1, 2, 4, 8

#: Longest text of a fault or a stop.
MAX_TEXT_BYTES = 120

#: End of a cut text.
CUT = "..."

#: Fault in the last state of a server that ends.
SERVER_ENDED = "hexctl serve has ended"


class CommandTag(NamedTuple):
    """Attachment of a command, in the order of its bytes.

    Attributes:
        sequence: counts the commands of a lease from 1.
        stamp_ns: time of creation, on a monotonic clock of the sender; only differences count.
        lease_id: 16 bytes.
        lease_sequence: number that the robot gave the lease.
    """

    sequence: int
    stamp_ns: int
    time_to_live_ms: int
    lease_id: bytes
    lease_sequence: int

    def packed(self) -> bytes:
        """Attachment, 45 bytes."""
        return _COMMAND.pack(_COMMAND_MAGIC, PROTOCOL_VERSION, *self)

    @staticmethod
    def lease_in(attachment: bytes | None) -> tuple[bytes, int] | None:
        """Identifier and number of the lease in an attachment, or None. Cheap, because it filters floods."""
        if attachment is None or len(attachment) != _COMMAND.size:
            return None
        lease_id, lease_sequence = _LEASE.unpack(attachment[-_LEASE.size :])
        return lease_id, lease_sequence

    @classmethod
    def unpacked(cls, attachment: bytes) -> "CommandTag":
        """Tag of an attachment; raises MessageError for anything else."""
        magic, version, *values = _unpacked(_COMMAND, attachment)
        _check(magic, _COMMAND_MAGIC, version)
        return cls(*values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateTag(ArrayFields):
    """Attachment of a state.

    Attributes:
        stamp_ns: time of sending, on a monotonic clock of the robot.
        age_us: age of the measurement at that time, in microseconds.
        command_sequence: of the newest command that reached the servos, 0 before the first of a lease.
        measured: True for joint angles from sensors, False for an echo of the targets.
        contacts: whether each foot touches the floor, (6,); None if unknown.
        stopped: why the robot's guard is stopped, or None.
        stale_joints: whether the servo of each joint has been silent for longer than usual, (18,); None if
            none has.
    """

    sequence: int
    stamp_ns: int
    age_us: int
    command_sequence: int
    measured: bool
    healthy: bool
    contacts: BoolArray | None
    fault: str | None = None
    stopped: str | None = None
    stale_joints: BoolArray | None = None

    def packed(self) -> bytes:
        """Attachment: 35 bytes, two texts with their lengths, and stale joints if any."""
        stale = 0 if self.stale_joints is None else _bits(self.stale_joints)
        flags = self.measured * _MEASURED | self.healthy * _HEALTHY | bool(stale) * _STALE_JOINTS
        flags |= 0 if self.contacts is None else _CONTACTS_KNOWN
        fixed = _STATE.pack(
            _STATE_MAGIC,
            PROTOCOL_VERSION,
            self.sequence,
            self.stamp_ns,
            self.age_us,
            self.command_sequence,
            flags,
            0 if self.contacts is None else _bits(self.contacts),
        )
        texts = _text(self.fault) + _text(self.stopped)
        return fixed + texts + (_STALE.pack(stale) if stale else b"")

    @classmethod
    def unpacked(cls, attachment: bytes) -> "StateTag":
        """Tag of an attachment; raises MessageError for anything else."""
        values = _unpacked(_STATE, attachment[: _STATE.size])
        magic, version, sequence, stamp_ns, age_us, command_sequence, flags, contacts = values
        _check(magic, _STATE_MAGIC, version)
        fault, rest = _read_text(attachment[_STATE.size :])
        stopped, rest = _read_text(rest)
        stale_joints = None
        if flags & _STALE_JOINTS:
            (bits,) = _unpacked(_STALE, rest[: _STALE.size])
            stale_joints = _of_bits(bits, N_JOINTS)
            rest = rest[_STALE.size :]
        if rest:
            raise MessageError(f"attachment: got {len(rest)} bytes too many; allowed: none")
        return cls(
            sequence=sequence,
            stamp_ns=stamp_ns,
            age_us=age_us,
            command_sequence=command_sequence,
            measured=bool(flags & _MEASURED),
            healthy=bool(flags & _HEALTHY),
            contacts=_of_bits(contacts, N_LEGS) if flags & _CONTACTS_KNOWN else None,
            fault=fault,
            stopped=stopped,
            stale_joints=stale_joints,
        )


def _unpacked(layout: struct.Struct, data: bytes) -> tuple[Any, ...]:
    if len(data) != layout.size:
        raise MessageError(f"attachment: got {len(data)} bytes; allowed: {layout.size}")
    return layout.unpack(data)


def _check(magic: bytes, expected: bytes, version: int) -> None:
    if magic != expected or version != PROTOCOL_VERSION:
        raise MessageError(
            f"attachment: got {magic!r} of version {version}; "
            f"allowed: {expected!r} of version {PROTOCOL_VERSION}"
        )


def _text(text: str | None) -> bytes:
    """Text of at most 120 bytes, preceded by its length; a longer one ends at a word, with `...`."""
    data = (text or "").encode()
    if len(data) > MAX_TEXT_BYTES:
        cut = data[: MAX_TEXT_BYTES - len(CUT)].decode(errors="ignore")
        whole = cut if data[len(cut.encode()) :].startswith(b" ") else cut.rpartition(" ")[0]
        data = ((whole or cut).rstrip(" ,;:(") + CUT).encode()
    return bytes([len(data)]) + data


def _read_text(data: bytes) -> tuple[str | None, bytes]:
    if not data or len(data) < 1 + data[0]:
        raise MessageError("attachment: got a truncated text; allowed: its length and its bytes")
    end = 1 + data[0]
    return data[1:end].decode(errors="replace") or None, data[end:]


_NAMES = list(JOINT_NAMES)
_NONE = np.zeros(0)


@cache
def _joint_message(*more: str) -> FixedMessage:
    """Encoder of positions and more fields of a JointState.

    Not the general encoder: out of cache at each tick, it takes a fifth of a round trip.
    """

    def make(stamp_ns: int, numbers: FloatArray) -> Any:
        known = dict(zip(("position", *more), numbers.reshape(-1, N_JOINTS), strict=True))
        header = ros_cdr.header(stamp_ns)
        fields = {"velocity": _NONE, "effort": _NONE, **known}
        return ros_cdr.make(ros_cdr.JOINT_STATE, header=header, name=_NAMES, **fields)

    return FixedMessage(make, N_JOINTS * (1 + len(more)))


@cache
def prepare_codec() -> None:
    """Load and build the encoders of a robot's messages, about 0.1 s, before it must keep time."""
    decode_joints(encode_positions(np.zeros(N_JOINTS)))
    decode_pose(encode_pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
    decode_battery(encode_battery(None, None))


def encode_positions(
    joint_positions_rad: FloatArray,
    stamp_ns: int | None = None,
    torques_nm: FloatArray | None = None,
    velocities_rad_s: FloatArray | None = None,
) -> bytes:
    """Joint angles (18,), leg-major order, as sensor_msgs/JointState.

    Args:
        stamp_ns: nanoseconds since 1970; now unless given.
        torques_nm: efforts, (18,); None leaves them empty, as in a command.
        velocities_rad_s: (18,) or None.
    """
    stamp_ns = time.time_ns() if stamp_ns is None else stamp_ns
    given = {"velocity": velocities_rad_s, "effort": torques_nm}
    known = {name: values for name, values in given.items() if values is not None}
    return _joint_message(*known).encode(stamp_ns, np.concatenate([joint_positions_rad, *known.values()]))


def decode_positions(payload: bytes) -> FloatArray:
    """Joint angles of a sensor_msgs/JointState in leg-major order, (18,), all finite.

    It names each joint once, in any order. Raises MessageError for anything else.
    """
    return decode_joints(payload)[0]


#: Fields beside positions in messages of hexctl; others take longer to decode.
_USUAL = ((), ("effort",), ("velocity", "effort"))


def decode_joints(payload: bytes) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Joint angles like `decode_positions`, torques in N m, and velocities in rad/s, (18,) each.

    Other numbers are NaN unless finite, None if none is. Raises MessageError as `decode_positions` does.
    """
    for more in _USUAL:
        if (numbers := _joint_message(*more).decode(payload)) is not None:
            found = dict(zip(("position", *more), numbers.reshape(-1, N_JOINTS), strict=True))
            break
    else:
        found = _decode_any(payload)
    if not np.isfinite(found["position"]).all():
        raise MessageError("joints: got a non-finite angle; allowed: finite angles in rad")
    gapped = {name: np.where(np.isfinite(values), values, np.nan) for name, values in found.items()}
    known = {name: values for name, values in gapped.items() if not np.isnan(values).all()}
    return found["position"], known.get("effort"), known.get("velocity")


def decode_command(payload: bytes, attachment: bytes | None) -> tuple[FloatArray, CommandTag]:
    """Joint angles (18,), leg-major order, and tag of a command; raises MessageError for anything else."""
    if attachment is None:
        raise MessageError("command: got no attachment; allowed: one with sequence, time to live and lease")
    return decode_positions(payload), CommandTag.unpacked(attachment)


def _decode_any(payload: bytes) -> dict[str, FloatArray]:
    """Fields of a JointState that have a number for each joint, in leg-major order."""
    message = ros_cdr.decode(ros_cdr.JOINT_STATE, payload)
    every = {name: np.asarray(getattr(message, name), dtype=float) for name in ("position", *_USUAL[-1])}
    found = {name: values for name, values in every.items() if values.shape == (N_JOINTS,)}
    if "position" not in found or len(message.name) != N_JOINTS:
        got = f"{len(message.name)} names and {every['position'].size} positions"
        raise MessageError(f"joints: got {got}; allowed: {N_JOINTS} each")
    if message.name == _NAMES:
        return found
    order = _order(message.name)
    return {name: values[order] for name, values in found.items()}


def _order(names: list[str]) -> list[int]:
    places = {name: place for place, name in enumerate(names)}
    try:
        return [places[name] for name in JOINT_NAMES]
    except KeyError as error:
        raise MessageError(
            f"joints: got no {error.args[0]}; allowed: {JOINT_NAMES[0]} ... {JOINT_NAMES[-1]}"
        ) from error


MAX_AGE_US = 0xFFFFFFFF

_NAN = math.nan


def tag_of(state: RobotState, *, sequence: int, stamp_ns: int, command_sequence: int) -> StateTag:
    """Tag of a state; `stamp_ns` is the sender's clock, `command_sequence` of the newest executed command."""
    return StateTag(
        sequence=sequence,
        stamp_ns=stamp_ns,
        age_us=_microseconds(state.age_s),
        command_sequence=command_sequence,
        measured=state.measured,
        healthy=state.healthy,
        contacts=state.foot_contacts,
        fault=state.fault,
        stopped=state.stopped,
        stale_joints=state.stale_joints,
    )


def encode_battery(voltage_v: float | None, share: float | None, stamp_ns: int | None = None) -> bytes:
    """Battery as sensor_msgs/BatteryState; NaN if unknown, as that message requires.

    `stamp_ns` is nanoseconds since 1970; now unless given.
    """
    return ros_cdr.encode(
        ros_cdr.make(
            ros_cdr.BATTERY_STATE,
            header=ros_cdr.header(time.time_ns() if stamp_ns is None else stamp_ns),
            voltage=_NAN if voltage_v is None else voltage_v,
            temperature=_NAN,
            current=_NAN,
            charge=_NAN,
            capacity=_NAN,
            design_capacity=_NAN,
            percentage=_NAN if share is None else share,
            power_supply_status=0,
            power_supply_health=0,
            power_supply_technology=0,
            present=voltage_v is not None or share is not None,
            cell_voltage=np.zeros(0, np.float32),
            cell_temperature=np.zeros(0, np.float32),
            location="",
            serial_number="",
        )
    )


def decode_battery(payload: bytes) -> tuple[float | None, float | None]:
    """Voltage in V and charge, 0 to 1, or None, of a sensor_msgs/BatteryState; raises MessageError."""
    message = ros_cdr.decode(ros_cdr.BATTERY_STATE, payload)
    voltage, share = float(message.voltage), float(message.percentage)
    return voltage if math.isfinite(voltage) else None, share if math.isfinite(share) else None


def _microseconds(age_s: float) -> int:
    """An infinite or NaN age becomes the maximum."""
    return min(max(0, round(age_s * 1e6)), MAX_AGE_US) if math.isfinite(age_s) else MAX_AGE_US


def _bits(values: BoolArray) -> int:
    return sum(1 << place for place, value in enumerate(values.tolist()) if value)


def _of_bits(bits: int, count: int) -> BoolArray:
    return np.array([bool(bits >> place & 1) for place in range(count)])
