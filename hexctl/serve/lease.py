"""Who may command a robot: one controller at a time, for as long as it says that it is there."""

import secrets
from dataclasses import dataclass, replace

from hexctl.errors import HexctlError
from hexctl.wire.tags import LEASE_ID_BYTES

#: A controller that says nothing for this long has lost the robot; it says something every third of it.
LEASE_S = 1.0

#: Longest name of a controller.
MAX_OWNER = 80


class LeaseRefusedError(HexctlError, PermissionError):
    """Somebody else holds the robot, or the lease is an old one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease:
    """The right to command.

    Attributes:
        lease_id: 16 random bytes that nobody else knows.
        sequence: number of this lease; later ones are higher.
        owner: who holds it, for people.
        since_s: when it was given.
        until_s: when it ends unless renewed.
    """

    lease_id: bytes
    sequence: int
    owner: str
    since_s: float
    until_s: float


class LeaseDesk:
    """Gives, renews and takes back the one lease of a robot. Times are on any clock that never jumps.

    Attributes:
        duration_s: how long a lease lasts unless renewed.
        refused: how often somebody was refused so far.
    """

    def __init__(self, *, duration_s: float = LEASE_S) -> None:
        self.duration_s = duration_s
        self.refused = 0
        self._held: Lease | None = None
        self._given = 0

    def holder(self, now_s: float) -> Lease | None:
        """Return the lease in force, or None."""
        held = self._held
        return held if held is not None and now_s <= held.until_s else None

    def acquire(self, owner: str, now_s: float) -> Lease:
        """Give a new lease.

        Raises LeaseRefusedError that says who holds the robot.
        """
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
            until_s=now_s + self.duration_s,
        )
        return self._held

    def renew(self, lease_id: bytes, now_s: float) -> Lease:
        """Prolong a lease.

        Raises LeaseRefusedError for one that has ended or been replaced.
        """
        held = self._require(lease_id, now_s)
        self._held = replace(held, until_s=now_s + self.duration_s)
        return self._held

    def release(self, lease_id: bytes, now_s: float) -> None:
        """Give a lease back.

        Raises LeaseRefusedError for one that is not in force.
        """
        self._require(lease_id, now_s)
        self._held = None

    def revoke(self) -> None:
        """Take the lease away from whoever holds it."""
        self._held = None

    def _require(self, lease_id: bytes, now_s: float) -> Lease:
        holder = self.holder(now_s)
        if holder is None or not secrets.compare_digest(holder.lease_id, lease_id):
            self.refused += 1
            now = "nobody holds the robot" if holder is None else f"{holder.owner} holds the robot"
            raise LeaseRefusedError(f"this lease has ended and {now} now")
        return holder
