"""What boards of hobby servos have in common, as their thread uses them."""

from dataclasses import dataclass
from typing import Protocol

from hexctl.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardReport:
    """What a board tells of itself.

    Attributes:
        at_s: when, on time.monotonic.
        contacts: which feet touch the floor, (6,), or None for a board without inputs.
        voltage_v: of the supply, or None where unknown.
        current_a: of all servos together, or None where unknown.
        fault: why the board has switched its servos off, or None.
    """

    at_s: float
    contacts: BoolArray | None = None
    voltage_v: float | None = None
    current_a: float | None = None
    fault: str | None = None


@dataclass(slots=True)
class PwmCounters:
    """Counts of a board since it was made.

    Attributes:
        writes: poses sent.
        reports: of the board.
        missed: reports that did not come, or not whole.
        reopened: times that a port that had gone was opened again.
    """

    writes: int = 0
    reports: int = 0
    missed: int = 0
    reopened: int = 0


class PwmBoard(Protocol):
    """A board on an open port, used by one thread; every method may raise OSError when the port has gone."""

    def commanded_us(self) -> FloatArray:
        """Pulses of each joint, (18,), that the board was last told; NaN where it was told none."""
        ...

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Power some servos, (18,), with the pulses of their joints, (18,), from the first one on."""
        ...

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send pulses of each joint, (18,), to the servos that are on, (18,); the others are limp."""
        ...

    def end(self) -> None:
        """Let all servos go limp."""
        ...

    def poll(self) -> BoardReport | None:
        """What the board tells, or None where it does not answer."""
        ...

    def close(self) -> None:
        """Close the port; the servos keep their pulses."""
        ...
