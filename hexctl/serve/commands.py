"""Which commands a robot accepts: those of the current lease, in order, on time."""

from dataclasses import dataclass

from hexctl.control.guard import EXPIRY_S
from hexctl.errors import CommandRefusedError, MessageError
from hexctl.serve.leases import Lease
from hexctl.wire.messages import Command, decode_command

#: Two clocks that never jump still drift apart, by less than this share: 100 ppm each for their crystals, and
#: up to 500 ppm for time services that slew one of them. A faster one (chrony may) makes commands late.
DRIFT = 1000e-6


class TransitDelay:
    """Compares arrivals with the fastest so far: the clocks of the two ends need not agree.

    The first message counts as on time. Of a message that waited in a link that was cut, the delay shows.
    """

    def __init__(self) -> None:
        self._fastest_s: float | None = None
        self._at_s = 0.0

    def delay_s(self, stamp_s: float, arrived_s: float) -> float:
        """Return by how much a message took longer than the fastest one so far.

        Args:
            stamp_s: when it was sent, on the sender's clock.
            arrived_s: when it came, on the receiver's clock.
        """
        took_s = arrived_s - stamp_s
        if self._fastest_s is None:
            self._fastest_s, self._at_s = took_s, arrived_s
        self._fastest_s += DRIFT * max(0.0, arrived_s - self._at_s)
        self._at_s = max(self._at_s, arrived_s)
        self._fastest_s = min(self._fastest_s, took_s)
        return took_s - self._fastest_s


@dataclass(slots=True)
class CommandCounters:
    """Counts of the commands that arrived since the server began.

    Attributes:
        accepted: reached the guard and passed it.
        refused: reached the guard, which refused them.
        malformed: were no command.
        stale_owner: came without a lease, under an old or under another's.
        out_of_order: repeated a sequence number or came after a later one.
        late: took longer than their time to live.
        lost: sequence numbers that never came.
        overflowed: pushed out of a full inbox, with whatever else was in it.
    """

    accepted: int = 0
    refused: int = 0
    malformed: int = 0
    stale_owner: int = 0
    out_of_order: int = 0
    late: int = 0
    lost: int = 0
    overflowed: int = 0


@dataclass(frozen=True, slots=True)
class Checked:
    """A command to obey.

    Attributes:
        command: what it says.
        delay_s: how much longer than usual it was on its way.
        good_for_s: how long it is good for from now.
    """

    command: Command
    delay_s: float
    good_for_s: float


class CommandHandler:
    """Judges every command that arrives. Counts what it drops."""

    def __init__(self) -> None:
        self.counters = CommandCounters()
        self.newest_sequence = 0
        self._lease_sequence = 0
        self._transit = TransitDelay()

    def check(self, payload: bytes, attachment: bytes | None, lease: Lease | None, at_s: float) -> Checked:
        """Return a command that is to be obeyed.

        Raises MessageError or CommandRefusedError, counted, for every other.
        """
        try:
            command = decode_command(payload, attachment)
        except MessageError:
            self.counters.malformed += 1
            raise
        tag = command.tag
        if lease is None or tag.lease_id != lease.lease_id or tag.lease_sequence != lease.sequence:
            self.counters.stale_owner += 1
            raise CommandRefusedError(f"command: got lease {tag.lease_sequence}; allowed: the one in force")
        if lease.sequence != self._lease_sequence:
            self._lease_sequence, self.newest_sequence, self._transit = lease.sequence, 0, TransitDelay()
        return self._in_order_and_on_time(command, at_s)

    def _in_order_and_on_time(self, command: Command, at_s: float) -> Checked:
        tag = command.tag
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
        return Checked(command, delay_s, good_for_s)
