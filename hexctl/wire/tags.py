"""What travels beside a payload, as a Zenoh attachment: sequence, time, lease, and the state's flags.

Layouts are little-endian without padding; docs/protocol.md tells them byte by byte.
"""

import struct
from dataclasses import dataclass
from typing import Any

from hexctl.errors import MessageError
from hexctl.wire.protocol import PROTOCOL_VERSION

LEASE_ID_BYTES = 16

_COMMAND = struct.Struct("<4sBQqI16sI")
_STATE = struct.Struct("<4sBQqIQBB")
_COMMAND_MAGIC = b"HXCc"
_STATE_MAGIC = b"HXCs"
_MEASURED, _HEALTHY, _CONTACTS_KNOWN = 1, 2, 4

#: Longest text of a fault or a stop.
MAX_TEXT_BYTES = 120


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandTag:
    """Beside a command.

    Attributes:
        sequence: 1 for the first command of a lease, then growing by one.
        stamp_ns: when it was made, on a clock of the sender that never jumps; only differences count.
        time_to_live_ms: how long it is good for.
        lease_id: of the lease that it is sent under, 16 bytes.
        lease_sequence: number of that lease; a robot's leases are numbered as it gives them.
    """

    sequence: int
    stamp_ns: int
    time_to_live_ms: int
    lease_id: bytes
    lease_sequence: int

    def packed(self) -> bytes:
        """Return the 45 bytes of the attachment."""
        return _COMMAND.pack(
            _COMMAND_MAGIC,
            PROTOCOL_VERSION,
            self.sequence,
            self.stamp_ns,
            self.time_to_live_ms,
            self.lease_id,
            self.lease_sequence,
        )

    @classmethod
    def unpacked(cls, attachment: bytes) -> "CommandTag":
        """Return the tag that an attachment holds.

        Raises MessageError for anything else.
        """
        magic, version, sequence, stamp_ns, ttl_ms, lease_id, lease_sequence = _unpacked(_COMMAND, attachment)
        _check(magic, _COMMAND_MAGIC, version)
        return cls(
            sequence=sequence,
            stamp_ns=stamp_ns,
            time_to_live_ms=ttl_ms,
            lease_id=lease_id,
            lease_sequence=lease_sequence,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StateTag:
    """Beside a state.

    Attributes:
        sequence: grows by one with each state.
        stamp_ns: when it was sent, on a clock of the robot that never jumps.
        age_us: how old the measurement was then, in microseconds.
        command_sequence: of the newest command that reached the servos, 0 before the first of a lease.
        measured: True for joint angles from sensors, False for an echo of the targets.
        healthy: False when the robot reports a fault.
        contacts: bit i is set when foot i+1 touches the floor; None where unknown.
        fault: what is wrong, or None.
        stopped: why the robot's guard is stopped, or None.
    """

    sequence: int
    stamp_ns: int
    age_us: int
    command_sequence: int
    measured: bool
    healthy: bool
    contacts: int | None
    fault: str | None = None
    stopped: str | None = None

    def packed(self) -> bytes:
        """Return the 35 bytes of the attachment and the two texts, each with its length before it."""
        flags = self.measured * _MEASURED | self.healthy * _HEALTHY
        flags |= 0 if self.contacts is None else _CONTACTS_KNOWN
        fixed = _STATE.pack(
            _STATE_MAGIC,
            PROTOCOL_VERSION,
            self.sequence,
            self.stamp_ns,
            self.age_us,
            self.command_sequence,
            flags,
            self.contacts or 0,
        )
        return fixed + _text(self.fault) + _text(self.stopped)

    @classmethod
    def unpacked(cls, attachment: bytes) -> "StateTag":
        """Return the tag that an attachment holds.

        Raises MessageError for anything else.
        """
        values = _unpacked(_STATE, attachment[: _STATE.size])
        magic, version, sequence, stamp_ns, age_us, command_sequence, flags, contacts = values
        _check(magic, _STATE_MAGIC, version)
        fault, rest = _read_text(attachment[_STATE.size :])
        stopped, rest = _read_text(rest)
        if rest:
            raise MessageError(f"attachment: got {len(rest)} bytes too many; allowed: none")
        return cls(
            sequence=sequence,
            stamp_ns=stamp_ns,
            age_us=age_us,
            command_sequence=command_sequence,
            measured=bool(flags & _MEASURED),
            healthy=bool(flags & _HEALTHY),
            contacts=contacts if flags & _CONTACTS_KNOWN else None,
            fault=fault,
            stopped=stopped,
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
    """Return a text of at most 120 bytes with its length before it; None is an empty one."""
    data = (text or "").encode()[:MAX_TEXT_BYTES].decode(errors="ignore").encode()
    return bytes([len(data)]) + data


def _read_text(data: bytes) -> tuple[str | None, bytes]:
    if not data or len(data) < 1 + data[0]:
        raise MessageError("attachment: got a text that is cut off; allowed: its length and its bytes")
    end = 1 + data[0]
    return data[1:end].decode(errors="replace") or None, data[end:]
