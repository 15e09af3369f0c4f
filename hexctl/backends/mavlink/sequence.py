"""What the sequence numbers of a sender say: how many frames were lost, and which came too late."""

from dataclasses import dataclass

#: Sequence numbers count modulo this.
MODULUS = 256

#: A sender that was silent for this long may have begun anew: its number says nothing.
FORGET_AFTER_S = 0.5


@dataclass(slots=True)
class SequenceCount:
    """Follows one sender.

    Attributes:
        lost: frames that never came, by their numbers.
        out_of_order: frames that came after a later one, or twice.
    """

    lost: int = 0
    out_of_order: int = 0
    _newest: int | None = None
    _at_s: float = 0.0

    def in_order(self, number: int, at_s: float) -> bool:
        """Return whether a frame is newer than all before it, and count what is missing between them.

        A number is taken for the nearer of its two meanings: up to 127 ahead is later, else it is earlier. A
        gap longer than that cannot be told from fewer losses.
        """
        newest, silent_s = self._newest, at_s - self._at_s
        ahead = 1 if newest is None or silent_s > FORGET_AFTER_S else (number - newest) % MODULUS
        if not 1 <= ahead < MODULUS // 2:
            self.out_of_order += 1
            # What came late was counted as lost when its successor came; what came twice was not.
            self.lost -= 1 if ahead and self.lost else 0
            return False
        self.lost += ahead - 1
        self._newest, self._at_s = number, at_s
        return True
