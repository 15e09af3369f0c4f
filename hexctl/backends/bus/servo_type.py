"""A model of a bus servo: its counts, its supply and its registers."""

from dataclasses import dataclass
from typing import Any

from hexctl.backends.bus.families.registers import RegisterTable
from hexctl.errors import InputError


@dataclass(frozen=True, slots=True)
class ServoType:
    """A model of a bus servo; its number is None if the servo does not report it.

    Attributes:
        least_v: lowest supply by its data sheet, in V.
        registers: of a servo that has some; models with the same ones can be mixed on a robot.
        counts: of a full turn.
        least: lowest count of its travel, as is `most` the highest.
        centre: count at the middle of its travel.
        p_gains: lowest and highest P gain: a tenth and ten times that of the factory, because a number for
            another model is no other stiffness, but a mistake; None without a P gain.
        twins: other servos that report the same number, in words; empty for none.
    """

    name: str
    number: int | None
    least_v: float
    registers: RegisterTable | None = None
    counts: float = 4096
    least: int = 0
    most: int = 4095
    centre: int = 2048
    p_gains: tuple[int, int] | None = None
    twins: str = ""

    @property
    def table(self) -> RegisterTable:
        """Its registers; raises InputError for a model without registers."""
        if self.registers is None:
            raise InputError(f"servo model: got {self.name}, without registers; allowed: one with registers")
        return self.registers

    @property
    def protocol(self) -> int:
        """Version of its family's protocol."""
        return 1 if self.registers is None else self.registers.protocol

    @property
    def counts_per_deg(self) -> float:
        """Counts per degree of the horn."""
        return self.counts / 360.0


#: Counts of servos with 1024 over 300 degrees.
ARC: dict[str, Any] = {"counts": 1023 * 360 / 300, "most": 1023, "centre": 512}
