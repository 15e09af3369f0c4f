"""Leases of a robot: one controller at a time, and which of its commands the robot accepts."""

import secrets
from dataclasses import dataclass, replace
from threading import Lock

from hexctl.control.guard import EXPIRY_S
from hexctl.errors import HexctlError, MessageError
from hexctl.types import FloatArray
from hexctl.wire.transit_delay import TransitDelay
from hexctl.wire.zenoh_messages import LEASE_ID_BYTES, CommandTag, decode_command

#: Lifetime of a lease without renewal; clients renew it every third of it.
LEASE_S = 1.0

#: Longest name of a controller.
MAX_OWNER = 80


class LeaseRefusedError(HexctlError, PermissionError):
    """Another client has the lease, or the lease has expired."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """The right to command.

    Attributes:
        lease_id: 16 random bytes that only its owner knows.
        owner: name of the client, for display.
        deadline_s: when it expires unless renewed.
    """

    lease_id: bytes
    sequence: int
    owner: str
    since_s: float
    deadline_s: float


class LeaseManager:
    """Grants, renews and revokes the one lease of a robot. Times are on any monotonic clock."""

    def __init__(self) -> None:
        self.refused = 0
        self.last_owner: str | None = None
        self._current: Lease | None = None
        self._last_id = b""
        self._given = 0

    def current(self, now_s: float) -> Lease | None:
        """Current lease, or None."""
        lease = self._current
        return lease if lease is not None and now_s <= lease.deadline_s else None

    def acquire(self, owner: str, now_s: float, duration_s: float = LEASE_S) -> Lease:
        """Grant a new lease; raises LeaseRefusedError if another lease is current."""
        current = self.current(now_s)
        if current is not None:
            self.refused += 1
            raise LeaseRefusedError(
                f"the robot is leased to {current.owner} for {now_s - current.since_s:.0f} s; "
                "end that controller first, or stop the robot with hexctl estop"
            )
        self._given += 1
        self._current = Lease(
            lease_id=secrets.token_bytes(LEASE_ID_BYTES),
            sequence=self._given,
            owner=owner[:MAX_OWNER],
            since_s=now_s,
            deadline_s=now_s + duration_s,
        )
        self._last_id, self.last_owner = self._current.lease_id, self._current.owner
        return self._current

    def renew(self, lease_id: bytes, now_s: float, duration_s: float = LEASE_S) -> Lease:
        """Renew a lease; raises LeaseRefusedError if it has expired or was replaced."""
        lease = self._require(lease_id, now_s)
        self._current = replace(lease, deadline_s=now_s + duration_s)
        return self._current

    def heard(self, at_s: float) -> None:
        """Extend the lease on a command: on a bad link renewals may be lost while commands arrive."""
        lease = self.current(at_s)
        if lease is not None and lease.deadline_s < at_s + LEASE_S:
            self._current = replace(lease, deadline_s=at_s + LEASE_S)

    def release(self, lease_id: bytes, now_s: float) -> None:
        """Give a lease back; raises LeaseRefusedError if it is not current."""
        self._require(lease_id, now_s)
        self._current = None

    def revoke(self) -> None:
        """Revoke the current lease, if any."""
        self._current = None

    def _require(self, lease_id: bytes, now_s: float) -> Lease:
        current = self.current(now_s)
        if current is None or not secrets.compare_digest(current.lease_id, lease_id):
            self.refused += not secrets.compare_digest(self._last_id, lease_id)
            now = "no client has a lease" if current is None else f"{current.owner} has the lease"
            raise LeaseRefusedError(f"this lease has ended, {now} now")
        return current


@dataclass(slots=True)
class CommandCounters:
    """Counts of the commands that arrived since the server began.

    Attributes:
        stale_owner: without the current lease.
        late: older than their time to live.
        lost: sequence numbers that never arrived.
        overflowed: messages of any kind that a full inbox dropped.
    """

    accepted: int = 0
    refused: int = 0
    malformed: int = 0
    stale_owner: int = 0
    out_of_order: int = 0
    late: int = 0
    lost: int = 0
    overflowed: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """A command to execute: joint angles (18,), delay behind the fastest one, and remaining validity."""

    joint_positions_rad: FloatArray
    sequence: int
    delay_s: float
    good_for_s: float


class CommandHandler:
    """Checks every command that arrives, and counts the ones it drops."""

    def __init__(self) -> None:
        self.counters = CommandCounters()
        self._counting = Lock()
        self.newest_sequence = 0
        self._lease_sequence = 0
        self._transit = TransitDelay()

    def admits(self, attachment: bytes | None, lease: Lease | None) -> bool:
        """Whether a new command has the current lease; others are counted. Thread-safe."""
        carried = CommandTag.lease_in(attachment)
        if carried is not None and lease is not None and carried == (lease.lease_id, lease.sequence):
            return True
        self._count("malformed" if carried is None else "stale_owner")
        return False

    def check(
        self, payload: bytes, attachment: bytes | None, lease: Lease | None, at_s: float
    ) -> Checked | None:
        """Command in order and on time; None for any other, which is counted."""
        try:
            joint_positions_rad, tag = decode_command(payload, attachment)
        except MessageError:
            self._count("malformed")
            return None
        if lease is None or tag.lease_id != lease.lease_id or tag.lease_sequence != lease.sequence:
            self._count("stale_owner")
            return None
        if lease.sequence != self._lease_sequence:
            self._lease_sequence, self.newest_sequence, self._transit = lease.sequence, 0, TransitDelay()
        delay_s = self._transit.delay_s(tag.stamp_ns / 1e9, at_s)
        if tag.sequence <= self.newest_sequence:
            self._count("out_of_order")
            return None
        self.counters.lost += tag.sequence - self.newest_sequence - 1
        self.newest_sequence = tag.sequence
        good_for_s = min(tag.time_to_live_ms / 1000, EXPIRY_S) - delay_s
        if good_for_s < 0:
            self._count("late")
            return None
        return Checked(joint_positions_rad, tag.sequence, delay_s, good_for_s)

    def _count(self, dropped: str) -> None:
        with self._counting:  # several threads count these
            setattr(self.counters, dropped, getattr(self.counters, dropped) + 1)
