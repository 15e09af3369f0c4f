"""One servo on a bus by its id, whatever it speaks: what it is, how it is, its settings, torque and goal."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.robot.servos.servo_models import ServoType

#: Tries of what must arrive.
TRIES = 4

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundServo:
    """A servo that answers.

    Attributes:
        model: name of its model, or None for one that is not known.
        position: in counts, or None.
        load: share of its greatest effort, signed, or None if it reports none.
        error: what it complains of; empty for nothing.
    """

    servo_id: int
    baud: int
    model: str | None
    model_number: int | None
    protocol: int
    position: int | None
    voltage_v: float | None
    temperature_c: float | None
    load: float | None = None
    current_a: float | None = None
    error: str = ""

    @property
    def effort(self) -> float | None:
        """Magnitude of its load as a share, or of its current in A; None if it reports neither."""
        known = self.current_a if self.load is None else self.load
        return None if known is None else abs(known)

    def to_json(self) -> dict[str, object]:
        """JSON values; the id as `id`, and the voltage and temperature in V and degrees Celsius."""
        return {
            "id": self.servo_id,
            "model": self.model,
            "model_number": self.model_number,
            "protocol": self.protocol,
            "baud": self.baud,
            "position": self.position,
            "voltage": self.voltage_v,
            "temperature": self.temperature_c,
            "error": self.error,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """What is stored in a servo and matters before it moves.

    Attributes:
        refusal: why it must not be moved; empty if it may be.
        notes: what is worth knowing.
        least: lowest goal that it takes, in counts; -inf if it does not say.
        most: highest goal that it takes, in counts; inf if it does not say.
    """

    refusal: str
    notes: tuple[str, ...]
    least: float
    most: float


class Servo(ABC):
    """One servo by its id. Its methods raise OSError when the port has gone.

    Args:
        packets: of its protocol, on an open line.
        servo_id: that it answers to.
        model: its model, or the likely one if it does not say.
    """

    def __init__(self, packets: PacketLine, servo_id: int, model: ServoType) -> None:
        self._packets, self.servo_id, self.type = packets, servo_id, model

    def answers(self, *, tries: int = TRIES) -> bool:
        """Whether it answers at all."""
        return self._packets.ask(self.servo_id, self._packets.packets.probe, tries=tries) is not None

    def model_number(self) -> int | None:
        """Model number that it reports, or None."""
        return None

    @abstractmethod
    def look(self) -> FoundServo:
        """What it is, and how it is."""

    @abstractmethod
    def position(self) -> float | None:
        """Count at which it is, or None without an answer."""

    @abstractmethod
    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on, or None without an answer."""

    @abstractmethod
    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque; whether it is then as wanted, as the servo says."""

    @abstractmethod
    def go(self, count: float) -> str:
        """Set the goal; empty if the servo took it, or does not say, else why not."""

    @abstractmethod
    def settings(self) -> ServoSettings:
        """What is stored in it, as far as it says."""

    def limits(self) -> tuple[float, float]:
        """Lowest and highest goal that it takes, in counts, of those that its model has."""
        stored = self.settings()
        return max(stored.least, self.type.least), min(stored.most, self.type.most)

    def set_up(self) -> list[str]:
        """Set it up while it has no torque, if its family has anything to set; notes on what was changed."""
        return []

    def soften(self) -> str:
        """Limit its torque and its speed, if it can, until `restore`; empty if it did, else why not."""
        return ""

    def restore(self) -> None:  # noqa: B027  not every servo can be softened
        """Give it back the torque and the speed that it had before `soften`."""

    def set_id(self, servo_id: int) -> str:
        """Let it answer to another id, for good, without torque; empty if it took it, else why not."""
        self.set_torque(on=False)
        said = self._write_id(servo_id)
        before, self.servo_id = self.servo_id, servo_id
        if self.answers():
            return ""
        self.servo_id = before
        return said or "it does not answer to it"

    def reboot(self) -> None:  # noqa: B027  not every servo can
        """Let it start again if it can, without torque."""

    @abstractmethod
    def _write_id(self, servo_id: int) -> str:
        """Tell it another id; why it refused it, as far as it says."""

    def _twice(self, read: Callable[[], Answer | None]) -> Answer | None:
        """What was read twice in a row, for what is decided by it; None if that does not come.

        Most answers say neither their address nor their question: one that is late passes for another.
        """
        before = read()
        for _ in range(TRIES):
            if before is None:
                return None
            again = read()
            if again == before:
                return again
            self._packets.outwait()
            before = again
        return None
