"""One servo on a line by its id, whatever it speaks: what it is, how it is, its torque and its goal.

For what is done with servos before there is a robot, or one at a time: scanning, identifying, trying.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.lx16a import lx16a_packets as lx
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PING, PROTOCOLS, PacketFormat
from hexctl.backends.bus.register.registers import AX, STS, Register, RegisterTable, X, table_of
from hexctl.backends.bus.register.servo import RegisterServo
from hexctl.backends.bus.register.stored_settings import hardware_error, renew_torque_limit, settings_of
from hexctl.backends.bus.servo_bus import TRIES
from hexctl.robot.servos.servo_models import SERVO_TYPES, ServoType

#: Protocols of each driver, the more likely one first.
PROTOCOLS_OF = {"dynamixel": (2, 1), "feetech": (1,), "lx16a": (1,)}

#: Registers of servos whose model number is not known, by driver and protocol.
_LIKELY: dict[tuple[str, int], RegisterTable] = {
    ("dynamixel", 2): X,
    ("dynamixel", 1): AX,
    ("feetech", 1): STS,
}

#: Time of a move of an LX-16A servo, in ms: two steps of a soft motion.
MOVE_MS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundServo:
    """A servo that answers.

    Attributes:
        servo_id: that it answers to.
        baud: bits per second at which it answers.
        model: name of its model, or None for one that is not known.
        model_number: that it reports, or None.
        protocol: version that it speaks.
        position: in counts, or None.
        voltage_v: at the servo, or None.
        temperature_c: of the servo, or None.
        load: share of its greatest effort, signed, or None where it reports none.
        current_a: or None.
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


class SingleServo(ABC):
    """One servo by its id. Its methods raise OSError when the port has gone.

    Attributes:
        servo_id: that it answers to.
        type: its model, or the likely one where it does not say.
    """

    servo_id: int
    type: ServoType

    @abstractmethod
    def look(self) -> FoundServo:
        """What it is, and how it is."""

    @abstractmethod
    def position(self) -> float | None:
        """Count at which it is, or None without an answer."""

    @abstractmethod
    def torque(self) -> bool | None:
        """Whether it holds its goal, or None without an answer."""

    @abstractmethod
    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque; whether it is then as wanted, as the servo says."""

    @abstractmethod
    def go(self, count: float) -> str:
        """Set the goal; empty where the servo took it, or does not say, else why not."""

    @abstractmethod
    def limits(self) -> tuple[float, float]:
        """Lowest and highest goal that it takes, in counts, of those that its model has."""

    @abstractmethod
    def refusal(self) -> str:
        """Why it should not be moved; empty where it may be."""

    @abstractmethod
    def soften(self) -> str:
        """Limit its torque and its speed, where it can, until `restore`; empty where it did, else why not."""

    @abstractmethod
    def restore(self) -> None:
        """Give it back the torque and the speed that it had before `soften`."""

    @abstractmethod
    def set_id(self, servo_id: int) -> str:
        """Let it answer to another id, for good, without torque; empty where it took it, else why not."""

    @abstractmethod
    def reboot(self) -> None:
        """Let it start again where it can, without torque."""


class SingleRegisterServo(SingleServo):
    """A servo with registers.

    Args:
        packets: of its protocol, on an open line.
        driver: `dynamixel` or `feetech`.
        servo_id: that it answers to.
        soft_torque: share of its torque that is left to it by `soften`.
        soft_deg_s: greatest speed after `soften`, in degrees per second.
    """

    def __init__(
        self,
        packets: PacketLine,
        driver: str,
        protocol: int,
        servo_id: int,
        *,
        soft_torque: float = 0.4,
        soft_deg_s: float = 60.0,
    ) -> None:
        self.servo_id = servo_id
        self._packets, self._driver, self._protocol = packets, driver, protocol
        self.number, self.model = self._model()
        likely = _LIKELY[driver, protocol]
        self._table = likely if self.model is None else table_of(self.model)
        name = (
            self.model
            or {"dynamixel": {1: "ax12a", 2: "xl430-w250"}, "feetech": {1: "sts3215"}}[driver][protocol]
        )
        self.type = SERVO_TYPES[name]
        self._servo = RegisterServo(packets, self._table, servo_id)
        self._soft = {self._table.soft_torque: soft_torque, self._table.speed: soft_deg_s}
        self._before: dict[Register, float] = {}

    def look(self) -> FoundServo:
        """What it is, and how it is."""
        report = self._servo.report()
        table = self._table
        data, error = (b"", "") if report is None else report
        if table.hardware_error is not None and error:
            error = f"{error} ({hardware_error(self._servo)})"

        def value(register: Register | None, digits: int) -> float | None:
            known = bool(data) and register is not None
            return round(table.of_block(register, data), digits) if known else None

        position = value(table.position, 0)
        return FoundServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=self.model,
            model_number=self.number,
            protocol=self._protocol,
            position=None if position is None else int(position),
            voltage_v=value(table.voltage, 1),
            temperature_c=value(table.temperature, 1),
            load=value(table.effort, 3),
            current_a=value(table.current, 3),
            error=error,
        )

    def position(self) -> float | None:
        """Count at which it is."""
        return self._servo.value(self._table.position)

    def torque(self) -> bool | None:
        """Whether it holds its goal."""
        raw = self._servo.raw(self._table.torque)
        return None if raw is None else raw == 1

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque; an expired watchdog ends, and a torque limit of 0 is renewed."""
        if on:
            if self._table.watchdog is not None:
                self._servo.write(self._table.watchdog, 0)
            renew_torque_limit(self._servo)
        return not self._servo.change(self._table.torque, float(on))

    def go(self, count: float) -> str:
        """Set the goal."""
        return self._servo.write(self._table.goal, round(count))

    def limits(self) -> tuple[float, float]:
        """Lowest and highest goal that it takes."""
        settings = settings_of(self._servo)
        return max(settings.least, self.type.least), min(settings.most, self.type.most)

    def refusal(self) -> str:
        """Why it should not be moved."""
        if self.model is None:
            return f"its model number {self.number} is not known"
        return settings_of(self._servo).refusal

    def soften(self) -> str:
        """Limit its torque and its speed."""
        refusals = []
        for register, value in self._soft.items():
            before = self._servo.value(register)
            if register is None or before is None:
                continue
            self._before.setdefault(register, before)
            # A speed of 0 is no limit.
            limit = min(before, value) if before or register != self._table.speed else value
            refusals.append(self._servo.change(register, limit))
        return ", ".join(filter(None, refusals))

    def restore(self) -> None:
        """Give it back the torque and the speed that it had."""
        for register, value in self._before.items():
            self._servo.change(register, value)
        self._before.clear()

    def set_id(self, servo_id: int) -> str:
        """Let it answer to another id: unlocked for it where there is a lock."""
        table, servo = self._table, self._servo
        self.set_torque(on=False)
        if table.unlock is not None:
            servo.write(table.unlock, 0)
        said = servo.write(table.servo_id, servo_id)
        taken = RegisterServo(self._packets, table, servo_id)
        if not taken.answers():
            return said or "it does not answer to it"
        self.servo_id, self._servo = servo_id, taken
        if table.unlock is not None:
            taken.write(table.unlock, 1)
        return ""

    def reboot(self) -> None:
        """Let it start again, without torque; those of protocol 2 can."""
        if self._protocol == 2:
            self._servo.reboot()

    def _model(self) -> tuple[int | None, str | None]:
        """Model number that it reports, and the name of the model; None where they are not known."""
        likely = _LIKELY[self._driver, self._protocol]
        number = RegisterServo(self._packets, likely, self.servo_id).raw(likely.model)
        if number is None:
            return None, None
        for each in (number, int.from_bytes(number.to_bytes(2, "little"), "big")):
            for model in SERVO_TYPES.values():
                if (model.driver, model.protocol, model.number) == (self._driver, self._protocol, each):
                    return each, model.name
        return number, None


class SingleLx16aServo(SingleServo):
    """An LX-16A servo or one of its kin, which report no model.

    Args:
        packets: of their format, on an open line.
        servo_id: that it answers to.
    """

    def __init__(self, packets: PacketLine, servo_id: int) -> None:
        self.servo_id, self._packets = servo_id, packets
        self.type = SERVO_TYPES["lx16a"]

    def look(self) -> FoundServo:
        """What it is, and how it is."""
        position, millivolts = self.position(), self._number(lx.READ_VOLTAGE)
        return FoundServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=None,
            model_number=None,
            protocol=1,
            position=None if position is None else int(position),
            voltage_v=None if millivolts is None else round(millivolts / 1000, 1),
            temperature_c=self._number(lx.READ_TEMPERATURE),
        )

    def position(self) -> float | None:
        """Count at which it is."""
        return self._number(lx.READ_POSITION)

    def torque(self) -> bool | None:
        """Whether it holds its goal."""
        loaded = self._number(lx.READ_LOAD)
        return None if loaded is None else bool(loaded)

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque, until the servo says that it is."""
        for _ in range(TRIES):
            self._packets.line.write(lx.load(self.servo_id, on=on))
            if self.torque() is on:
                return True
        return False

    def go(self, count: float) -> str:
        """Set the goal; these servos do not acknowledge it."""
        self._packets.line.write(lx.move(self.servo_id, round(count), MOVE_MS))
        return ""

    def limits(self) -> tuple[float, float]:
        """Lowest and highest goal that it takes."""
        stored = self._ask(lx.READ_LIMITS)
        if stored is None:
            return float(self.type.least), float(self.type.most)
        return float(lx.number(stored[:2])), float(lx.number(stored[2:]))

    def refusal(self) -> str:
        """Nothing: these servos have no settings that would make a move dangerous."""
        return ""

    def soften(self) -> str:
        """Nothing: their torque cannot be limited, and each move has its time."""
        return ""

    def restore(self) -> None:
        """Nothing."""

    def set_id(self, servo_id: int) -> str:
        """Let it answer to another id."""
        self.set_torque(on=False)
        self._packets.line.write(lx.LX16A.instruction(self.servo_id, lx.WRITE_ID, bytes([servo_id])))
        taken = SingleLx16aServo(self._packets, servo_id)
        if taken.position() is None:
            return "it does not answer to it"
        self.servo_id = servo_id
        return ""

    def reboot(self) -> None:
        """Nothing: these servos cannot."""

    def _number(self, command: int) -> float | None:
        answer = self._ask(command)
        return None if answer is None else float(lx.number(answer))

    def _ask(self, command: int) -> bytes | None:
        for _ in range(TRIES):
            answer = self._packets.ask(self.servo_id, command)
            if answer is not None and lx.answers(answer, command):
                return answer.parameters
        return None


def packets_of(driver: str, protocol: int) -> PacketFormat:
    """Format of the packets of a driver's protocol."""
    return lx.LX16A if driver == "lx16a" else PROTOCOLS[protocol]


def harmless_instruction(driver: str) -> int:
    """Instruction that any servo of a driver answers and that changes nothing."""
    return lx.READ_POSITION if driver == "lx16a" else PING


def single_servo(packets: PacketLine, driver: str, protocol: int, servo_id: int) -> SingleServo:
    """One servo of a driver; a servo with registers is asked for its model."""
    if driver == "lx16a":
        return SingleLx16aServo(packets, servo_id)
    return SingleRegisterServo(packets, driver, protocol, servo_id)


def effort_of(found: FoundServo) -> float:
    """Load of a servo as a share, or its current in A; NaN where it reports neither."""
    known = [each for each in (found.load, found.current_a) if each is not None]
    return abs(known[0]) if known else float(np.nan)
