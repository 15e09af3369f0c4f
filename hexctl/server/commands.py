"""Which commands a robot accepts: those of the current lease, in order, on time."""

from dataclasses import dataclass
from threading import Lock

from hexctl.control.guard import EXPIRY_S
from hexctl.errors import CommandRefusedError, MessageError
from hexctl.server.leases import Lease
from hexctl.types import FloatArray
from hexctl.wire.transit_delay import TransitDelay
from hexctl.wire.zenoh_messages import CommandTag, decode_command


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

    def check(self, payload: bytes, attachment: bytes | None, lease: Lease | None, at_s: float) -> Checked:
        """Command in order and on time; others are counted, and raise MessageError or CommandRefusedError."""
        try:
            joint_positions_rad, tag = decode_command(payload, attachment)
        except MessageError:
            self._count("malformed")
            raise
        if lease is None or tag.lease_id != lease.lease_id or tag.lease_sequence != lease.sequence:
            self._count("stale_owner")
            raise CommandRefusedError(f"command: got lease {tag.lease_sequence}; allowed: the one in force")
        if lease.sequence != self._lease_sequence:
            self._lease_sequence, self.newest_sequence, self._transit = lease.sequence, 0, TransitDelay()
        delay_s, good_for_s = self._in_order_and_on_time(tag, at_s)
        return Checked(joint_positions_rad, tag.sequence, delay_s, good_for_s)

    def _count(self, dropped: str) -> None:
        with self._counting:  # several threads count these
            setattr(self.counters, dropped, getattr(self.counters, dropped) + 1)

    def _in_order_and_on_time(self, tag: CommandTag, at_s: float) -> tuple[float, float]:
        """Delay and remaining validity."""
        delay_s = self._transit.delay_s(tag.stamp_ns / 1e9, at_s)
        if tag.sequence <= self.newest_sequence:
            self.counters.out_of_order += 1
            raise CommandRefusedError(
                f"command: got sequence {tag.sequence}; allowed: above {self.newest_sequence}"
            )
        self.counters.lost += tag.sequence - self.newest_sequence - 1
        self.newest_sequence = tag.sequence
        good_for_s = min(tag.time_to_live_ms / 1000, EXPIRY_S) - delay_s
        if good_for_s < 0:
            self.counters.late += 1
            raise CommandRefusedError(
                f"command: got {1000 * delay_s:.0f} ms late; allowed: {tag.time_to_live_ms} ms"
            )
        return delay_s, good_for_s
