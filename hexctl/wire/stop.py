"""A stop in force: its reason, its time, and who may clear it.

A client that asks for a stop may claim it: the name of its request is the hash of a clear key that only the
client knows. A client that presents the keys of all claims may clear the stop after `LOCKOUT_S`. Others have
to wait for `OTHERS_LOCKOUT_S`, twice as long with each repetition.

Guaranteed: a client with valid credentials that reads the id of a claimed stop from the status cannot clear
it before `OTHERS_LOCKOUT_S`, whatever its name or its number of sessions. It never can under the name under
which it commanded the robot before the stop. Under another name it can, because a person on another
computer has no other credentials. Programs of the user who asked for the stop can read the keys.
"""

import hashlib
import math
import re
import secrets
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from hexctl.wire.stop_datagram import ID_BYTES

#: Reason of a stop that a client requested.
ESTOP = "estop"

#: Reason of the stop that a new lease lifts; every other one is cleared explicitly.
LIFTED_BY_LEASE = "expired"

#: Minimum time from the last request of a stop until it can be cleared.
LOCKOUT_S = 1.0

#: The same without the keys of its claims.
OTHERS_LOCKOUT_S = 120.0

#: A stop requested again within this time after a clear without keys holds twice as long, up to
#: these bounds: with claims, and without.
REPEATED_WITHIN_S, MOST_OTHERS_LOCKOUT_S, MOST_UNCLAIMED_LOCKOUT_S = 600.0, 960.0, 60.0

#: Requester without a name, prefix of a datagram's address, and ROS 2.
UNNAMED, DATAGRAM_FROM, OVER_ROS = "an unnamed client", "a datagram from ", "ROS 2"

#: Longest name of a requester.
MAX_BY = 80

#: Bytes of a clear key, and hexadecimal digits of a claim: those of a request's name in a datagram.
CLEAR_KEY_BYTES, CLAIM_DIGITS = 16, 16

#: Most claims of one stop. With one more the keys become worthless, and only waiting is left.
MOST_CLAIMS, TOO_MANY = 16, "too many"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A stop in force.

    Attributes:
        stop_id: 16 hexadecimal digits, unique.
        reason: as in `Guard.stopped`.
        since_s: time of the last request, or of its detection, by the robot's time source.
        before_start_s: its age when this server started; it holds from the start, and is shown with it.
        by: name that the last requesting client reported, even for an older stop; None without a client.
        claims: hashes of the clear keys of the requesting clients.
        repeats: number of consecutive requests after a clear without keys.
        commander: client that commanded the robot last, or None. It never clears another client's stop
            without the keys.
    """

    stop_id: str
    reason: str
    since_s: float
    before_start_s: float = 0.0
    by: str | None = None
    claims: tuple[str, ...] = ()
    repeats: int = 0
    commander: str | None = None

    @property
    def stays(self) -> bool:
        """Whether only a clear ends it."""
        return self.reason != LIFTED_BY_LEASE

    def proved_by(self, keys: Collection[str]) -> bool:
        """Whether `keys` contains the keys of all its claims; False if it has none."""
        return bool(self.claims) and set(self.claims) <= {claim_of(key) for key in keys}

    def lockout_s(self, *, proved: bool) -> float:
        """Time in s until it may be cleared, with the keys of its claims or without."""
        if not self.stays:
            return 0.0
        if proved:
            return LOCKOUT_S
        longer = 2.0 ** min(self.repeats, 10)
        if self.claims:
            return min(longer * OTHERS_LOCKOUT_S, MOST_OTHERS_LOCKOUT_S)
        return min(longer * LOCKOUT_S, MOST_UNCLAIMED_LOCKOUT_S)

    def lockout_left_s(self, at_s: float, *, proved: bool) -> float:
        """Remaining time in s until it may be cleared; `at_s` is by the robot's time source."""
        return max(0.0, self.since_s + self.lockout_s(proved=proved) - at_s)

    def with_claim(self, claim: str | None) -> "Stop":
        """The same stop with one more claim, unless it is None."""
        if claim is None or claim in self.claims:
            return self
        claims = (*self.claims, claim) if len(self.claims) < MOST_CLAIMS else (*self.claims[1:], TOO_MANY)
        return replace(self, claims=claims)

    def refusal(
        self, stop_id: str | None, at_s: float, keys: Collection[str] = (), by: str | None = None
    ) -> str | None:
        """Why a clear is refused, or None. It contains no id: clients read it from the status."""
        if not self.stays and stop_id is None:
            return None
        if stop_id is None:
            return "clear: got no id; allowed: the id of the stop, which the status has"
        if stop_id != self.stop_id:
            return "clear: got the id of another stop; allowed: the one in force, which the status has"
        proved = self.proved_by(keys)
        of_others = bool(self.claims) or self.by not in (None, by)
        if of_others and not proved and by == self.commander:
            return (
                "clear: got a request of the stopped client; allowed: from the client that stopped the robot"
            )
        lockout_s, left_s = self.lockout_s(proved=proved), self.lockout_left_s(at_s, proved=proved)
        if left_s <= 0:
            return None
        without = (
            "" if proved or not self.claims else " without the key of the client that asked for the stop"
        )
        since_s = lockout_s - left_s
        return f"clear: got a request{without} {since_s:.1f} s after the stop; allowed: after {lockout_s:g} s"

    def to_json(self, at_s: float, *, on_disk: bool) -> dict[str, Any]:
        """As in the status, at a time by the robot's time source; `on_disk` is whether it is on the disk."""
        return {
            "id": self.stop_id,
            "since_s": round(at_s - self.since_s + self.before_start_s, 1),
            "clear_in_s": _hundredths_s(self.lockout_left_s(at_s, proved=bool(self.claims))),
            "others_in_s": _hundredths_s(self.lockout_left_s(at_s, proved=False)),
            "claims": list(self.claims),
            "kept": on_disk,
            "by": self.by,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Clear:
    """A cleared stop: by whom, when, and whether with the keys of its claims (`proved`)."""

    stop: Stop
    by: str
    at_s: float
    proved: bool = False

    def repeats_at(self, at_s: float) -> int:
        """`repeats` of a stop that a client asks for at a time by the robot's time source."""
        fought = not self.proved and self.stop.by is not None and at_s - self.at_s < REPEATED_WITHIN_S
        return self.stop.repeats + 1 if fought else 0

    def to_json(self, at_s: float) -> dict[str, Any]:
        """As in the status, at a time by the robot's time source."""
        return {
            "id": self.stop.stop_id,
            "reason": self.stop.reason,
            "by": self.by,
            "since_s": round(at_s - self.at_s, 1),
        }


def new_stop_id() -> str:
    """Unique id of a stop."""
    return secrets.token_hex(ID_BYTES)


def new_clear_key() -> str:
    """Clear key for one stop."""
    return secrets.token_hex(CLEAR_KEY_BYTES)


def claim_of(key: str) -> str:
    """Claim of a clear key: the beginning of its SHA-256, which is also the name of the request."""
    return hashlib.sha256(key.encode(errors="replace")).hexdigest()[:CLAIM_DIGITS]


def claim_in(value: object) -> str | None:
    """Claim in the name of a request, or in a value from the network; None for anything else."""
    is_claim = isinstance(value, str) and re.fullmatch(f"[0-9a-f]{{{CLAIM_DIGITS}}}", value)
    return str(value) if is_claim else None


def _hundredths_s(duration_s: float) -> float:
    return math.ceil(100 * duration_s) / 100
