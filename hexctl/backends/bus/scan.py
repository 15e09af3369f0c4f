"""A scan of a bus: which servos answer on it, without knowing any robot; and a new id for one of them."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count

from hexctl.backends.bus.lx16a import lx16a_packets as lx
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import BROADCAST
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo_bus import TRIES
from hexctl.backends.bus.single_servo import (
    PROTOCOLS_OF,
    FoundServo,
    SingleServo,
    harmless_instruction,
    packets_of,
    single_servo,
)
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.servos.servo_models import SERVO_TYPES

#: Ids that a servo can have.
IDS = tuple(range(253))

#: How long an answer may take beside its time on the wire; 16 ms of it may be the adapter's.
TIMEOUT_S = 0.02

#: How often a broadcast is repeated that only a servo alone on its bus answers whole.
BROADCASTS = 3

#: Bits per second that servos of each driver have from the factory or are usually given.
USUAL_BAUDS = {
    "dynamixel": (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000),
    "feetech": (1_000_000, 500_000, 115_200, 38_400),
    "lx16a": (115_200,),
}

#: Told before each question: how many have been asked, and of how many.
Progress = Callable[[int, int], None]


@contextmanager
def opened_line(path: str, baud: int) -> Iterator[SerialLine]:
    """A line that is open meanwhile; raises RobotFaultError when it cannot be opened, or goes."""
    line = SerialLine(path, baud)
    try:
        yield line
    except OSError as error:
        raise RobotFaultError(f"the port {path} has gone ({error.strerror or error})") from error
    finally:
        line.close()


def packet_line(line: SerialLine, driver: str, protocol: int) -> PacketLine:
    """Packets of a driver's protocol on a line whose servos are not known; learns whether it echoes."""
    packets = PacketLine(line, packets_of(driver, protocol), timeout_s=TIMEOUT_S, adapts=False)
    packets.learn_echo(harmless_instruction(driver))
    return packets


def scan_bus(
    path: str,
    driver: str,
    *bauds: int,
    ids: Sequence[int] = IDS,
    progress: Progress = lambda _asked, _of: None,
) -> list[FoundServo]:
    """Servos that answer on a port, by id. Nothing is switched and nothing moves.

    Args:
        path: of the serial device.
        driver: `dynamixel`, `feetech` or `lx16a`.
        bauds: bits per second, one after the other.
        ids: that are asked.
        progress: called before each question.

    Raises InputError for another driver, RobotFaultError for a port that cannot be opened or goes.
    """
    check_driver(driver)
    protocols = PROTOCOLS_OF[driver]
    asked, of = count(), len(bauds) * len(protocols) * len(ids)
    found: list[FoundServo] = []
    for baud in bauds:
        with opened_line(path, baud) as line:
            at_baud: dict[int, FoundServo] = {}
            for protocol in protocols:
                packets = packet_line(line, driver, protocol)
                for servo_id in ids:
                    progress(next(asked), of)
                    _look_at(packets, driver, protocol, servo_id, at_baud)
                # Those that gave no answer among others that did are asked once more.
                for servo_id in [each for each in ids if each <= max(at_baud, default=-1) + 1]:
                    _look_at(packets, driver, protocol, servo_id, at_baud)
            found += at_baud.values()
    return sorted(found, key=lambda servo: (servo.servo_id, servo.baud))


def _look_at(
    packets: PacketLine, driver: str, protocol: int, servo_id: int, found: dict[int, FoundServo]
) -> None:
    """Put the servo of an id that answers among those found, unless it is."""
    if servo_id not in found and _answers(packets, driver, servo_id):
        found[servo_id] = single_servo(packets, driver, protocol, servo_id).look()


def check_driver(driver: str) -> None:
    """Raise InputError for a driver that there is not."""
    if driver not in PROTOCOLS_OF:
        raise InputError(f"{argument('driver')}: got {driver!r}; allowed: {', '.join(PROTOCOLS_OF)}")


def nothing_answers(path: str, driver: str, bauds: Sequence[int]) -> str:
    """What is said when a scan found no servo."""
    tried = " or ".join(str(baud) for baud in bauds)
    others = [str(baud) for baud in USUAL_BAUDS[driver] if baud not in bauds]
    usual = f"; --baud all also asks at {', '.join(others)}" if others else ""
    return (
        f"no servo answers on {path} at {tried} baud; are they powered, and is {driver} their driver?{usual}"
    )


def set_servo_id(
    path: str, driver: str, baud: int, new_id: int, *, progress: Progress = lambda _asked, _of: None
) -> FoundServo:
    """Give the one servo on a bus another id, and look at it under that.

    Raises InputError unless exactly one servo answers, RobotFaultError when it does not take the id.
    """
    check_driver(driver)
    if new_id not in IDS:
        raise InputError(f"{argument('new_id')}: got {new_id}; allowed: {IDS[0]} to {IDS[-1]}")
    if driver == "lx16a":
        answering = _ids_by_broadcast(path, baud)
        found = scan_bus(path, driver, baud, ids=answering)
    else:
        found = scan_bus(path, driver, baud, progress=progress)
        answering = [each.servo_id for each in found]
    if len(answering) != 1 or len(found) != 1:
        answer = ", ".join(map(str, answering)) or "none"
        raise InputError(f"servos that answer: got {answer}; allowed: exactly one on the bus")
    servo = found[0]
    if driver == "feetech" and servo.model is None:
        raise InputError(
            f"model number: got {servo.model_number}; allowed: those of {', '.join(_names(driver))}"
        )
    with opened_line(path, baud) as line:
        single = single_servo(
            packet_line(line, driver, servo.protocol), driver, servo.protocol, servo.servo_id
        )
        return give_id(single, new_id)


def give_id(servo: SingleServo, new_id: int) -> FoundServo:
    """Give a servo another id, and look at it; raises RobotFaultError where it does not take the id."""
    old_id = servo.servo_id
    if said := servo.set_id(new_id):
        raise RobotFaultError(f"the servo with id {old_id} did not take the id {new_id} ({said})")
    return servo.look()


def answering_ids(line: SerialLine, driver: str, protocol: int, ids: Sequence[int]) -> list[int]:
    """Those of some ids to which servos answer on an open line, each asked twice at the most."""
    packets = packet_line(line, driver, protocol)
    return [each for each in ids if any(_answers(packets, driver, each) for _ in range(2))]


def _answers(packets: PacketLine, driver: str, servo_id: int) -> bool:
    """Whether a servo answers to an id."""
    command = harmless_instruction(driver)
    answer = packets.ask(servo_id, command)
    return answer is not None and (driver != "lx16a" or lx.answers(answer, command))


def _ids_by_broadcast(path: str, baud: int) -> list[int]:
    """Ids of the servos of `lx16a` that answer when all are asked: whole only where there is one."""
    ids: set[int] = set()
    with opened_line(path, baud) as line:
        packets = packet_line(line, "lx16a", 1)
        request = lx.LX16A.instruction(BROADCAST, lx.READ_ID)
        for _ in range(BROADCASTS):
            wire_s = line.wire_s(len(request) + lx.LX16A.status_size(1))
            answers = packets.transact(request, range(BROADCAST + 1), wire_s)
            ids |= {answer.parameters[0] for answer in answers if lx.answers(answer, lx.READ_ID)}
            time.sleep(TIMEOUT_S)
        if not ids and packets.garbled:
            raise InputError("servos that answer: got several at once; allowed: exactly one on the bus")
    return sorted(ids)


def _names(driver: str) -> list[str]:
    """Models of a driver that report a number."""
    return [each.name for each in SERVO_TYPES.values() if each.driver == driver and each.number is not None]


def find_servo(line: SerialLine, driver: str, servo_id: int) -> SingleServo | None:
    """Servo with an id on an open line, in any of its driver's protocols; None where none answers."""
    check_driver(driver)
    for protocol in PROTOCOLS_OF[driver]:
        packets = packet_line(line, driver, protocol)
        if any(_answers(packets, driver, servo_id) for _ in range(TRIES)):
            return single_servo(packets, driver, protocol, servo_id)
    return None


def the_servo(line: SerialLine, driver: str, servo_id: int) -> SingleServo:
    """Servo with an id on an open line; raises RobotFaultError where none answers."""
    servo = find_servo(line, driver, servo_id)
    if servo is None:
        raise RobotFaultError(
            f"no servo with id {servo_id} answers on {line.path} at {line.baud} baud; `hexctl servos scan` "
            "shows which do"
        )
    return servo
