"""One servo on a bus by its id, of any protocol."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Self, TypeVar

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.servo_type import ServoType

#: Tries of what must arrive.
TRIES = 4

#: Notes on settings for which stiffness and angles of the robot file do not hold.
NO_GAIN = "it has no P gain, which the robot file states"
OFFSET = "it adds a stored offset to its counts; the robot file must be calibrated with it"

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannedServo:
    """A servo that answers; None for unknown values.

    Attributes:
        position: in counts.
        load: share of its maximum effort, signed.
        error: its complaint; empty for none.
        firmware: its version; empty if unknown.
        variant: its type by its supply, and the limits of that; empty if unknown.
        p_gain: of its position control.
    """

    servo_id: int
    model: str | None
    model_number: int | None
    protocol: int
    baud: int
    position: int | None
    voltage_v: float | None
    temperature_c: float | None
    load: float | None = None
    current_a: float | None = None
    error: str = ""
    firmware: str = ""
    variant: str = ""
    p_gain: int | None = None

    @property
    def effort(self) -> float | None:
        """Magnitude of its load as a share, or of its current in A; None if it reports neither."""
        known = self.current_a if self.load is None else self.load
        return None if known is None else abs(known)

    def to_json(self) -> dict[str, object]:
        """JSON values; the id as `id`, voltage in V, temperature in degrees Celsius."""
        values = asdict(self)
        del values["load"], values["current_a"]
        shorter = {"servo_id": "id", "voltage_v": "voltage", "temperature_c": "temperature"}
        return {shorter.get(name, name): value for name, value in values.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """Stored settings that matter before a servo moves.

    `refusal` is why it must not be moved; empty if it may be. `least` and `most` limit goals, in counts;
    infinite if unknown, `firmware` is empty then. With a `shadow_id` it also follows the goals of that id.
    """

    refusal: str
    notes: tuple[str, ...]
    least: float
    most: float
    firmware: str = ""
    shadow_id: int | None = None


class Servo(ABC):
    """One servo of a known or likely model, by its id. Its methods raise OSError when the port is lost.

    Attributes:
        p_gain: that the robot file states; None if it states none.
    """

    p_gain: int | None = None

    def __init__(self, packets: PacketLine, servo_id: int, model: ServoType) -> None:
        self._packets, self.servo_id, self.type = packets, servo_id, model

    @classmethod
    def identified(cls, packets: PacketLine, servo_id: int, models: Sequence[ServoType]) -> Self:
        """Servo with this id, of the one of some models that it reports; of the first if it reports none."""
        return cls(packets, servo_id, models[0])

    def answers(self, *, tries: int = TRIES) -> bool:
        """Whether it answers."""
        return self._packets.ping(self.servo_id, tries=tries)

    def reads(self) -> bool | None:
        """Whether its position can be read; None without any answer.

        Servos with one id may answer a ping alike, and stand at other positions.
        """
        return self.position() is not None if self.answers() else None

    def model_number(self) -> int | None:
        """Reported model number, or None."""
        return None

    @abstractmethod
    def look(self) -> ScannedServo:
        """Identity and readings of the servo."""

    @abstractmethod
    def position(self) -> float | None:
        """Position in counts; None without an answer."""

    @abstractmethod
    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on; None without an answer."""

    @abstractmethod
    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque; whether the servo confirms it."""

    @abstractmethod
    def go(self, count: float) -> str:
        """Set the goal; empty if accepted or not acknowledged, else the reason."""

    @abstractmethod
    def settings(self) -> ServoSettings:
        """Stored settings, as far as they can be read."""

    def limits(self) -> tuple[float, float]:
        """Lowest and highest goal in counts, within those of its model."""
        stored = self.settings()
        return max(stored.least, self.type.least), min(stored.most, self.type.most)

    def set_up(self) -> list[str]:
        """Set up the servo while it has no torque; the result is notes on changes."""
        return []

    def soften(self) -> str:
        """Limit its torque and speed, if possible, until `restore`; empty, or the reason of failure."""
        return ""

    def restore(self) -> None:  # noqa: B027  not every servo can be softened
        """Restore the torque and speed from before `soften`."""

    def set_id(self, servo_id: int) -> str:
        """Set another id permanently, without torque; empty if accepted, else the reason."""
        self.set_torque(on=False)
        said = self._write_id(servo_id)
        before, self.servo_id = self.servo_id, servo_id
        if self.answers():
            return ""
        self.servo_id = before
        return said or "it does not answer to it"

    def reboot(self) -> bool:
        """Restart without torque; False for a servo that cannot."""
        return False

    @abstractmethod
    def _write_id(self, servo_id: int) -> str:
        """Set another id; the reason if refused."""

    def _twice(self, read: Callable[[], Answer | None]) -> Answer | None:
        """Value of two equal reads in a row, else None: a late answer to another request looks the same."""
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
