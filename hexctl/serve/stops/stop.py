"""A stop in force: why, since when, and the id by which it is cleared."""

import math
import secrets
from dataclasses import dataclass
from typing import Any

#: Reason of a stop that a client requested.
ESTOP = "estop"

#: Reason of the stop that a new lease lifts; every other one is cleared explicitly.
LIFTED_BY_LEASE = "expired"

#: A stop is not cleared before this time has passed since it was asked for last.
HOLD_S = 1.0

#: Who asked, where the client says no name; before the address that a datagram came from; and by ROS 2.
UNNAMED, DATAGRAM_FROM, OVER_ROS = "an unnamed client", "a datagram from ", "ROS 2"

#: Longest name of the client that asked.
MAX_BY = 80

#: Bytes of the id of a stop.
ID_BYTES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A stop in force.

    Attributes:
        stop_id: 16 hexadecimal digits, drawn for this stop alone.
        reason: as `Guard.stopped` has it.
        since_s: when it was asked for last, or noticed, on time.monotonic.
        by: who asked for it last, also where the robot had stopped for another reason before; None where
            no client did. A client says its name itself.
    """

    stop_id: str
    reason: str
    since_s: float
    by: str | None = None

    @property
    def stays(self) -> bool:
        """Whether only a clear ends it."""
        return self.reason != LIFTED_BY_LEASE

    def hold_left_s(self, at_s: float) -> float:
        """For how long it cannot be cleared yet, at a time on time.monotonic."""
        return max(0.0, self.since_s + HOLD_S - at_s) if self.stays else 0.0

    def refusal(self, stop_id: str | None, at_s: float) -> str | None:
        """Why a request to clear it is refused, or None. It tells no id: the status does, to who looks there.

        Args:
            stop_id: of the stop that is meant, or None.
            at_s: when it was asked for, on time.monotonic.
        """
        if not self.stays and stop_id is None:
            return None
        if stop_id is None:
            return "clear: got no id; allowed: the id of the stop, which the status has"
        if stop_id != self.stop_id:
            return "clear: got the id of another stop; allowed: the one in force, which the status has"
        if (left_s := self.hold_left_s(at_s)) > 0:
            return f"clear: got it {HOLD_S - left_s:.1f} s after the stop; allowed: after {HOLD_S:g} s"
        return None

    def to_json(self, at_s: float, *, kept: bool) -> dict[str, Any]:
        """As the status has it, at a time on time.monotonic; `kept` is whether it is on the disk."""
        return {
            "id": self.stop_id,
            "since_s": round(at_s - self.since_s, 1),
            "clear_in_s": math.ceil(100 * self.hold_left_s(at_s)) / 100,
            "kept": kept,
            "by": self.by,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Clear:
    """A stop that was cleared.

    Attributes:
        stop: as it was.
        by: who cleared it, by the name that it says itself.
        at_s: when, on time.monotonic.
    """

    stop: Stop
    by: str
    at_s: float

    def to_json(self, at_s: float) -> dict[str, Any]:
        """As the status has it, at a time on time.monotonic."""
        return {
            "id": self.stop.stop_id,
            "reason": self.stop.reason,
            "by": self.by,
            "since_s": round(at_s - self.at_s, 1),
        }


def new_stop_id() -> str:
    """An id that no stop has had."""
    return secrets.token_hex(ID_BYTES)
