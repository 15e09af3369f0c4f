"""A scan of a bus: which servos answer on it, without knowing any robot; and a new id for one of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PING, READ, WRITE, StatusPacket
from hexctl.backends.bus.registers import AX, STS, RegisterTable, X, table_of
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.servo_models import SERVO_TYPES

#: Ids that a servo can have.
IDS = tuple(range(253))

#: How long an answer may take beside its time on the wire; 16 ms of it may be the adapter's.
PATIENCE_S = 0.02

#: Protocols of each driver, the more likely one first.
PROTOCOLS_OF = {"dynamixel": (2, 1), "feetech": (1,)}

#: Registers of servos whose model number is not known, by driver and protocol.
_LIKELY: dict[tuple[str, int], RegisterTable] = {
    ("dynamixel", 2): X,
    ("dynamixel", 1): AX,
    ("feetech", 1): STS,
}

#: Tries of what must arrive.
TRIES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundServo:
    """A servo that answers.

    Attributes:
        servo_id: that it answers to.
        model: name of its model, or None for one that is not known.
        model_number: that it reports, or None.
        protocol: version that it speaks.
        position: in counts, or None.
        voltage_v: at the servo, or None.
        temperature_c: of the servo, or None.
        error: what it complains of; empty for nothing.
    """

    servo_id: int
    model: str | None
    model_number: int | None
    protocol: int
    position: int | None
    voltage_v: float | None
    temperature_c: float | None
    error: str

    def to_json(self) -> dict[str, object]:
        """JSON values; the id as `id`, and the voltage and temperature in V and degrees Celsius."""
        return {
            "id": self.servo_id,
            "model": self.model,
            "model_number": self.model_number,
            "protocol": self.protocol,
            "position": self.position,
            "voltage": self.voltage_v,
            "temperature": self.temperature_c,
            "error": self.error,
        }


def scan_bus(
    path: str,
    driver: str,
    baud: int,
    *,
    ids: Sequence[int] = IDS,
    asked: Callable[[int, int], None] = lambda _protocol, _servo_id: None,
) -> list[FoundServo]:
    """Servos that answer on a port, by id. Nothing is switched and nothing moves.

    Args:
        path: of the serial device.
        driver: `dynamixel` or `feetech`.
        baud: bits per second.
        ids: that are asked.
        asked: called with protocol and id before each is asked.

    Raises InputError for another driver, RobotFaultError for a port that cannot be opened or goes.
    """
    if driver not in PROTOCOLS_OF:
        raise InputError(f"driver: got {driver!r}; allowed: {', '.join(PROTOCOLS_OF)}")
    line = SerialLine(path, baud)
    found: dict[int, FoundServo] = {}
    try:
        for protocol in PROTOCOLS_OF[driver]:
            packets = PacketLine(line, protocol, patience_s=PATIENCE_S, adapts=False)
            packets.learn_echo()
            for servo_id in ids:
                asked(protocol, servo_id)
                if servo_id not in found and packets.ask(servo_id, PING) is not None:
                    found[servo_id] = _look(packets, driver, protocol, servo_id)
            # Those that gave no answer among others that did are asked once more.
            for servo_id in range(max((each for each in found if each in ids), default=-1) + 2):
                if servo_id in ids and servo_id not in found and packets.ask(servo_id, PING) is not None:
                    found[servo_id] = _look(packets, driver, protocol, servo_id)
    except OSError as error:
        raise RobotFaultError(f"the port {path} has gone ({error.strerror or error})") from error
    finally:
        line.close()
    return [found[servo_id] for servo_id in sorted(found)]


def set_servo_id(path: str, driver: str, baud: int, new_id: int) -> FoundServo:
    """Give the one servo on a bus another id, and look at it under that.

    Raises InputError unless exactly one servo answers, RobotFaultError when it does not take the id.
    """
    if new_id not in IDS:
        raise InputError(f"id: got {new_id}; allowed: {IDS[0]} to {IDS[-1]}")
    found = scan_bus(path, driver, baud)
    if len(found) != 1:
        answer = ", ".join(str(each.servo_id) for each in found) or "none"
        raise InputError(f"servos that answer: got {answer}; allowed: exactly one on the bus")
    servo = found[0]
    if driver == "feetech" and servo.model is None:
        raise InputError(
            f"model number: got {servo.model_number}; allowed: those of {', '.join(_names(driver))}"
        )
    line = SerialLine(path, baud)
    try:
        packets = PacketLine(line, servo.protocol, patience_s=PATIENCE_S, adapts=False)
        packets.learn_echo()
        _write_id(packets, _table(driver, servo.protocol, servo.model), servo.servo_id, new_id)
    except OSError as error:
        raise RobotFaultError(f"the port {path} has gone ({error.strerror or error})") from error
    finally:
        line.close()
    seen = scan_bus(path, driver, baud, ids=(new_id,))
    if not seen:
        raise RobotFaultError(f"the servo with id {servo.servo_id} did not take the id {new_id}")
    return seen[0]


def _names(driver: str) -> list[str]:
    """Models of a driver that report a number."""
    return [each.name for each in SERVO_TYPES.values() if each.driver == driver and each.number is not None]


def _write_id(packets: PacketLine, table: RegisterTable, old_id: int, new_id: int) -> None:
    """Write an id where it is kept: with the torque off, and unlocked for it where there is a lock."""
    _write(packets, table, old_id, table.torque.address, 0)
    if table.unlock is not None:
        _write(packets, table, old_id, table.unlock.address, 0)
    _write(packets, table, old_id, table.servo_id.address, new_id)
    if table.unlock is not None:
        _write(packets, table, new_id, table.unlock.address, 1)


def _write(packets: PacketLine, table: RegisterTable, servo_id: int, address: int, value: int) -> None:
    place = address.to_bytes(table.protocol, "little")
    packets.ask(servo_id, WRITE, place + bytes([value]), tries=TRIES)


def _look(packets: PacketLine, driver: str, protocol: int, servo_id: int) -> FoundServo:
    """What a servo is, and how it is."""
    number, model = _model(packets, driver, protocol, servo_id)
    table = _table(driver, protocol, model)
    answer = _read(packets, protocol, servo_id, *table.block)
    data = b"" if answer is None else answer.parameters
    whole = len(data) == table.block[1]
    return FoundServo(
        servo_id=servo_id,
        model=model,
        model_number=number,
        protocol=protocol,
        position=round(table.of_block(table.position, data)) if whole else None,
        voltage_v=round(table.of_block(table.voltage, data), 1) if whole else None,
        temperature_c=round(table.of_block(table.temperature, data), 1) if whole else None,
        error="" if answer is None else table.complaint(answer.error),
    )


def _model(packets: PacketLine, driver: str, protocol: int, servo_id: int) -> tuple[int | None, str | None]:
    """Model number that a servo reports, and the name of the model; None where they are not known."""
    place = _LIKELY[driver, protocol].model
    answer = _read(packets, protocol, servo_id, place.address, place.size)
    if answer is None or len(answer.parameters) != place.size:
        return None, None
    number = int.from_bytes(answer.parameters, "little")
    for each in (number, int.from_bytes(answer.parameters, "big")):
        for model in SERVO_TYPES.values():
            if (model.driver, model.protocol, model.number) == (driver, protocol, each):
                return each, model.name
    return number, None


def _table(driver: str, protocol: int, model: str | None) -> RegisterTable:
    return _LIKELY[driver, protocol] if model is None else table_of(model)


def _read(packets: PacketLine, protocol: int, servo_id: int, address: int, size: int) -> StatusPacket | None:
    asked = address.to_bytes(protocol, "little") + size.to_bytes(protocol, "little")
    return packets.ask(servo_id, READ, asked, tries=TRIES)
