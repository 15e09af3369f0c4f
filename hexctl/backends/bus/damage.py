"""Diagnose bytes on a bus that belong to no answer: duplicate ids, noise, or a wrong baud rate.

A missing servo is silent. Bytes outside packets, or a second answer, have another cause.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hexctl.backends.bus.packet_line import FIRST_TIMEOUT_S, PacketLine

#: Pings with which damage is confirmed, and those of them that must be damaged.
CONFIRMING, CONFIRMED = 4, 3

#: How long a line is listened to without a question.
LISTENS_S = 0.1

#: From this number of damaged ids without a servo, the line is at fault and not a duplicate id.
MOST_IDS = 6

#: Advice for an id that several servos have.
APART = "connect one servo at a time and give each its own id (hexctl servos set-id)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """Bytes outside answers, at one baud rate.

    Attributes:
        noisy: whether bytes come without a question.
        garbled: ids whose answers cannot be understood.
        doubled: ids with several complete answers to one question.
    """

    baud: int
    noisy: bool = False
    garbled: tuple[int, ...] = ()
    doubled: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return self.noisy or bool(self.garbled or self.doubled)

    @property
    def at_many_ids(self) -> bool:
        """Whether answers at many ids are damaged, which excludes a duplicate id."""
        return len(self.garbled) > MOST_IDS

    def description(self, path: str) -> str:
        """Cause and remedy."""
        if self.noisy:
            return (
                f"unsolicited bytes on {path} at {self.baud} baud: noise, a missing ground, a wrong baud "
                "rate, or another controller on the bus"
            )
        if self.at_many_ids:
            return (
                f"answers on {path} at {self.baud} baud are damaged and cannot be understood at many ids: "
                "a wrong baud rate, driver or protocol, a bad cable or noise"
            )
        causes = []
        if self.garbled:
            causes.append(
                f"answers of {_ids(self.garbled)} are damaged and cannot be understood: several servos with "
                f"the same id answer together, or its cable is bad; {APART}"
            )
        if self.doubled:
            causes.append(
                f"more than one answer from {_ids(self.doubled)}: several servos have the same id; {APART}"
            )
        return "; ".join(causes)


class Listener:
    """Collect bytes outside answers while ids of a line are pinged, and confirm them."""

    def __init__(self, packets: PacketLine) -> None:
        self.packets = packets
        self._garbled: dict[int, None] = {}  # ids whose answers may be damaged
        self._doubled: dict[int, None] = {}  # ids with several answers, perhaps
        self._first = packets.garbled, packets.late

    def look(self, servo_id: int, read: Callable[[], bool | None]) -> bool:
        """Whether an id answers; suspects it if damaged bytes or second answers come while `read` asks it.

        `read` returns whether the readings are complete, None without any answer.
        """
        garbled, late = self.packets.garbled, self.packets.late
        answered = read()
        if not answered and self.packets.garbled > garbled:
            self._garbled[servo_id] = None
        if answered is not None and self.packets.late > late:
            self._doubled[servo_id] = None
        return answered is not None

    def answers(self, servo_id: int, *, tries: int = 1) -> bool:
        """Whether an id answers; one with damaged answers is suspected."""
        return self.look(servo_id, lambda: self.packets.ping(servo_id, tries=tries) or None)

    def damage(self) -> Damage:
        """Return the damage that further pings confirm."""
        if self._first != (self.packets.garbled, self.packets.late) and self.is_noisy():
            return Damage(baud=self.packets.line.baud, noisy=True)
        garbled = [each for each in list(self._garbled)[: 2 * MOST_IDS] if self._persists(each, garbled=True)]
        doubled = [
            each for each in self._doubled if each not in garbled and self._persists(each, garbled=False)
        ]
        return Damage(baud=self.packets.line.baud, garbled=tuple(garbled), doubled=tuple(doubled))

    def is_noisy(self) -> bool:
        """Whether bytes come while nothing is asked."""
        time = self.packets.line.time
        time.sleep(FIRST_TIMEOUT_S)  # a late answer belongs to a request
        self.packets.discard()
        return self.packets.hears_noise(time.now() + LISTENS_S)

    def _persists(self, servo_id: int, *, garbled: bool) -> bool:
        """Whether most pings return damaged bytes, or with `garbled` off several answers."""
        bad = 0
        for attempt in range(CONFIRMING):
            answers, outside = self.packets.hear(servo_id)
            bad += (outside > 0 and not answers) if garbled else answers > 1
            if attempt - bad >= CONFIRMING - CONFIRMED:
                return False
        return bad >= CONFIRMED


def _ids(ids: Sequence[int]) -> str:
    return f"id{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"
