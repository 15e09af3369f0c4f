"""Leases of a robot: one controller at a time."""

import secrets
from dataclasses import dataclass, replace

from hexctl.errors import HexctlError
from hexctl.wire.zenoh_messages import LEASE_ID_BYTES

#: Lifetime of a lease without renewal; clients renew it every third of it.
LEASE_S = 1.0

#: Longest name of a controller.
MAX_OWNER = 80


class LeaseRefusedError(HexctlError, PermissionError):
    """Another client holds the robot, or the lease has expired."""


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
        self._held: Lease | None = None
        self._last_id = b""
        self._given = 0

    def holder(self, now_s: float) -> Lease | None:
        """Current lease, or None."""
        held = self._held
        return held if held is not None and now_s <= held.deadline_s else None

    def acquire(self, owner: str, now_s: float, duration_s: float = LEASE_S) -> Lease:
        """Grant a new lease; raises LeaseRefusedError if the robot is held."""
        holder = self.holder(now_s)
        if holder is not None:
            self.refused += 1
            raise LeaseRefusedError(
                f"the robot is held by {holder.owner} for {now_s - holder.since_s:.0f} s; "
                "end that controller first, or stop the robot with hexctl estop"
            )
        self._given += 1
        self._held = Lease(
            lease_id=secrets.token_bytes(LEASE_ID_BYTES),
            sequence=self._given,
            owner=owner[:MAX_OWNER],
            since_s=now_s,
            deadline_s=now_s + duration_s,
        )
        self._last_id, self.last_owner = self._held.lease_id, self._held.owner
        return self._held

    def renew(self, lease_id: bytes, now_s: float, duration_s: float = LEASE_S) -> Lease:
        """Renew a lease; raises LeaseRefusedError if it has expired or was replaced."""
        held = self._require(lease_id, now_s)
        self._held = replace(held, deadline_s=now_s + duration_s)
        return self._held

    def heard(self, at_s: float) -> None:
        """Extend the lease on a command: on a bad link renewals may be lost while commands arrive."""
        held = self.holder(at_s)
        if held is not None and held.deadline_s < at_s + LEASE_S:
            self._held = replace(held, deadline_s=at_s + LEASE_S)

    def release(self, lease_id: bytes, now_s: float) -> None:
        """Give a lease back; raises LeaseRefusedError if it is not current."""
        self._require(lease_id, now_s)
        self._held = None

    def revoke(self) -> None:
        """Revoke the current lease, if any."""
        self._held = None

    def _require(self, lease_id: bytes, now_s: float) -> Lease:
        holder = self.holder(now_s)
        if holder is None or not secrets.compare_digest(holder.lease_id, lease_id):
            self.refused += not secrets.compare_digest(self._last_id, lease_id)
            now = "no client holds the robot" if holder is None else f"{holder.owner} holds the robot"
            raise LeaseRefusedError(f"this lease has ended, {now} now")
        return holder
