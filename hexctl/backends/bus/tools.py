"""Tools on a bus by servo ids: scan, change an id, check ids, adopt a servo after the loss of its id."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.damage import Damage, Listener
from hexctl.backends.bus.family import Family, find_family
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import BROADCAST
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.bus.servo import TRIES, ScannedServo, Servo
from hexctl.backends.bus.servo_bus import BusCounters, ServoBus
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.model import Robot
from hexctl.robot.servos.drivers import SERVO_ID, bus_drivers
from hexctl.types import JOINT_NAMES, N_JOINTS, BoolArray

#: Ids that a servo can have, and the one that it has from the factory.
IDS, FACTORY_ID = tuple(range(int(SERVO_ID.low), int(SERVO_ID.high) + 1)), 1

#: How long an answer may take besides its time on the wire; 16 ms of it may be the adapter's.
TIMEOUT_S = 0.02

#: How often a broadcast is repeated that only a servo alone on its bus answers completely.
BROADCASTS = 3

#: Ids pinged to find a baud rate: the factory's, and those of a robot's joints.
FIRST_IDS = range(1, 19)

#: How far beyond the ids of the joints others are looked for: as far as all joints shifted once.
MARGIN = 18

#: How far a joint may seem to stand beyond its limits, in degrees.
TOLERANCE_DEG = 5.0

#: How long a servo takes to start again.
REBOOTS_S = 1.0

#: Called before each question with how many have been asked, and of how many.
Progress = Callable[[int, int], None]


def bus_of(servos: BusMap, line: SerialLine, counters: BusCounters) -> ServoBus:
    """Bus of the servos of all joints on an open line, in the order of the joints."""
    packets = PacketLine(line, servos.family.formats[servos.protocol])
    models = dict(zip(servos.ids.tolist(), servos.models, strict=True))
    bus = servos.family.bus(packets, models, counters)
    for servo in bus.servos:
        servo.p_gain = servos.p_gain
    return bus


@contextmanager
def opened_line(path: str, baud: int, family: Family) -> Iterator[SerialLine]:
    """Open a line to servos for a while; raises RobotFaultError when it cannot be opened, or is lost."""
    line = SerialLine(path, baud, modem_lines=family.modem_lines)
    try:
        yield line
    except OSError as error:
        raise RobotFaultError(f"the port {path} was lost ({error.strerror or error})") from error
    finally:
        line.close()


def tool_line(line: SerialLine, family: Family, protocol: int) -> PacketLine:
    """Packets on a line with unknown servos; learns whether the adapter echoes."""
    packets = PacketLine(line, family.formats[protocol], timeout_s=TIMEOUT_S, adapts=False)
    packets.learn_echo()
    return packets


def _find_servo(line: SerialLine, family: Family, servo_id: int) -> Servo | None:
    """Servo with this id, in any protocol of the family; None if none answers.

    Raises RobotFaultError for damaged answers: several servos may have this id.
    """
    for protocol in family.formats:
        listener = Listener(tool_line(line, family, protocol))
        answers = listener.answers(servo_id, tries=TRIES)
        if damage := listener.damage():
            raise RobotFaultError(damage.description(line.path))
        if answers:
            return family.servo_with(listener.packets, protocol, servo_id)
    return None


def the_servo(line: SerialLine, driver: str, servo_id: int) -> Servo:
    """Servo with this id; raises RobotFaultError if none answers, or if answers are damaged."""
    servo = _find_servo(line, find_family(driver), servo_id)
    if servo is None:
        raise RobotFaultError(
            f"no servo with id {servo_id} answers on {line.path} at {line.baud} baud; `hexctl servos scan` "
            "shows which do"
        )
    return servo


def scan_bus(
    path: str,
    driver: str,
    *bauds: int,
    ids: Sequence[int] = IDS,
    progress: Progress = lambda _asked, _of: None,
    on_damage: Callable[[Damage], None] = lambda _: None,
) -> list[ScannedServo]:
    """Servos that answer on a port, by id. Nothing is switched and nothing moves.

    Args:
        driver: name of the servos' family.
        bauds: bits per second, tried in this order.
        progress: called before each question.
        on_damage: called for each baud rate and protocol with bytes outside answers.

    Raises InputError for another driver, RobotFaultError for a port that cannot be opened or is lost.
    """
    family = find_family(driver)
    asked, of = count(), len(bauds) * len(family.formats) * len(ids)
    found: list[ScannedServo] = []
    for baud in bauds:
        with opened_line(path, baud, family) as line:
            at_baud: dict[int, ScannedServo] = {}
            for protocol in family.formats:
                listener = Listener(tool_line(line, family, protocol))
                for servo_id in ids:
                    progress(next(asked), of)
                    _look_at(listener, family, protocol, servo_id, at_baud)
                # Those that gave no answer among others that did are asked once more.
                for servo_id in [each for each in ids if each <= max(at_baud, default=-1) + 1]:
                    _look_at(listener, family, protocol, servo_id, at_baud)
                if damage := listener.damage():
                    on_damage(damage)
                    if damage.noisy or damage.at_many_ids:
                        break  # another protocol would hear the same
            found += at_baud.values()
    return sorted(found, key=lambda servo: (servo.servo_id, servo.baud))


def _look_at(
    listener: Listener, family: Family, protocol: int, servo_id: int, found: dict[int, ScannedServo]
) -> None:
    def look() -> bool | None:
        if not listener.packets.ping(servo_id):
            return None
        found[servo_id] = family.servo_with(listener.packets, protocol, servo_id).look()
        return found[servo_id].position is not None  # pings of two servos may be alike, and positions are not

    if servo_id not in found:
        listener.look(servo_id, look)


def other_settings(
    path: str, driver: str, bauds: Collection[int], drivers: Collection[str] | None = None
) -> str:
    """Other drivers and usual baud rates at which servos answer, as text; empty for none.

    A plug-in that does not load has no servos: `hexctl doctor` names it.

    Families answer each other's requests: a servo of a known model is preferred, and of another driver
    required.
    """
    families: list[Family] = []
    for each in bus_drivers() if drivers is None else drivers:
        with suppress(InputError):
            families.append(find_family(each))
    found = [
        (family.name, servo)
        for family in families
        for baud in family.bauds
        if family.name != driver or baud not in bauds
        if (servo := _a_servo(path, family, baud, known=family.name != driver and family.reports_model))
    ]
    found = [(each, servo) for each, servo in found if servo.model is not None] or found
    return " or ".join(
        f"servos answer at {servo.baud} baud: a wrong baud rate"
        if each == driver
        else f"servos{f' ({servo.model})' if servo.model else ''} answer with --driver {each} "
        f"--baud {servo.baud}"
        for each, servo in found
    )


def _a_servo(path: str, family: Family, baud: int, *, known: bool) -> ScannedServo | None:
    """A servo with one of a few ids; with `known` only one of a known model."""
    try:
        found = scan_bus(path, family.name, baud, ids=FIRST_IDS)
    except RobotFaultError:
        return None  # a rate that the adapter does not have
    return next((each for each in found if each.model is not None or not known), None)


def check_family(path: str, driver: str, bauds: Collection[int]) -> None:
    """Raise InputError if servos of another driver answer, and none of this one at these baud rates."""
    family = find_family(driver)
    if any(_a_servo(path, family, baud, known=family.reports_model) for baud in bauds):
        return
    if others := other_settings(path, driver, bauds, [each for each in bus_drivers() if each != driver]):
        raise InputError(f"{argument('driver')}: got {driver}, but {others}")


def damage_report(damage: Damage, path: str, driver: str) -> str:
    """The fault; for damage at many ids also the settings at which servos answer."""
    others = other_settings(path, driver, (damage.baud,)) if damage.at_many_ids else ""
    return "; ".join(filter(None, (damage.description(path), others)))


def nothing_answers(path: str, driver: str, bauds: Sequence[int], *, all_asked: bool) -> str:
    """Message for a line without servos and without damaged answers; `all_asked` after a search of all."""
    others = "" if all_asked else other_settings(path, driver, bauds)
    advice = others or f"are they powered, and is {driver} their driver?"
    return f"no {driver} servo answers on {path} at {' or '.join(map(str, bauds))} baud; {advice}"


def set_servo_id(
    path: str, driver: str, baud: int, new_id: int, *, progress: Progress = lambda _asked, _of: None
) -> ScannedServo:
    """Change the id of the only servo on a bus, and read it under the new one.

    Raises InputError for another driver, for an id that no servo can have and unless exactly one servo
    answers, RobotFaultError when it does not take the id.
    """
    SERVO_ID.check(argument("new_id"), new_id)
    family = find_family(driver)
    told = [] if family.id_question is None else _ids_by_broadcast(path, family, family.id_question, baud)
    damages: list[Damage] = []
    found = scan_bus(path, driver, baud, ids=told or IDS, progress=progress, on_damage=damages.append)
    answering = told or [each.servo_id for each in found]
    if len(answering) != 1 or len(found) != 1 or damages:
        answer = ", ".join(map(str, answering)) or "none"
        reasons = [damage_report(each, path, driver) for each in damages]
        if not (answering or damages):
            reasons = [other_settings(path, driver, (baud,))]
        more = "".join(f"; {each}" for each in reasons if each)
        raise InputError(f"servos that answer: got {answer}; allowed: exactly one on the bus{more}")
    servo = found[0]
    if family.ids_differ and servo.model is None:
        known = [each.name for each in family.models if each.number]
        raise InputError(f"model number: got {servo.model_number}; allowed: those of {', '.join(known)}")
    with opened_line(path, baud, family) as line:
        packets = tool_line(line, family, servo.protocol)
        return _give_id(family.servo_with(packets, servo.protocol, servo.servo_id), new_id)


def _give_id(servo: Servo, new_id: int) -> ScannedServo:
    old_id = servo.servo_id
    if said := servo.set_id(new_id):
        raise RobotFaultError(f"the servo with id {old_id} did not take the id {new_id} ({said})")
    return servo.look()


def _ids_by_broadcast(path: str, family: Family, question: int, baud: int) -> list[int]:
    """Ids of servos that answer a broadcast of a question for them: complete only if there is one."""
    ids: set[int] = set()
    with opened_line(path, baud, family) as line:
        packets = tool_line(line, family, next(iter(family.formats)))
        request = packets.packets.instruction(BROADCAST, question)
        for _ in range(BROADCASTS):
            wire_s = line.wire_s(len(request) + packets.packets.status_size(1))
            ids |= {each.parameters[0] for each in packets.transact(request, range(BROADCAST + 1), wire_s)}
            line.time.sleep(TIMEOUT_S)
        if not ids and packets.garbled:
            damage = Damage(baud=baud, noisy=Listener(packets).is_noisy())
            raise InputError(
                "servos that answer: got several or damaged answers; allowed: exactly one on the bus"
                f"{f'; {damage.description(path)}' if damage else ''}"
            )
    return sorted(ids)


def joint_of(servos: BusMap, servo_id: int) -> str | None:
    """Name of the joint with this id, or None."""
    joints = np.flatnonzero(servos.ids == servo_id).tolist()
    return JOINT_NAMES[joints[0]] if joints else None


def id_differences(servos: BusMap, answering: Collection[int]) -> list[str]:
    """Differences between the ids that answer and those of the joints."""
    missing = ~np.isin(servos.ids, list(answering))
    others = [str(each) for each in answering if joint_of(servos, each) is None]
    notes = [f"no answer: {servos.names(missing)}"] if missing.any() else []
    return notes + ([f"in no joint of the robot file: id {', '.join(others)}"] if others else [])


def check_no_unexpected_ids(line: SerialLine, servos: BusMap, found: BoolArray) -> None:
    """Raise RobotFaultError if a joint's servo is missing and an id of no joint answers, or several do.

    With such a robot file a walk would move the wrong joints. Ids near those of the joints and the factory's
    are asked, without the only servo that may have lost its id.
    """
    if found.all():
        return
    used = set(servos.ids.tolist())
    near = range(min(used) - MARGIN, max(used) + MARGIN + 1)
    listener = Listener(tool_line(line, servos.family, servos.protocol))
    asked = [each for each in IDS if each not in used and (each in near or each == FACTORY_ID)]
    unexpected = [each for each in asked if listener.answers(each, tries=2)]
    if damage := listener.damage():
        raise RobotFaultError(f"{servos.names(~found)} does not answer; {damage.description(line.path)}")
    lost = unexpected == [FACTORY_ID] and _adoptable(servos, found) is not None
    if unexpected and not lost:
        others = ", ".join(map(str, unexpected))
        raise RobotFaultError(
            f"no answer from {servos.names(~found)}, but from ids of no joint: {others}; compare the ids "
            "(hexctl servos scan --robot FILE)"
        )


def lost_id_notes(bus: ServoBus, servos: BusMap, found: BoolArray) -> list[str]:
    """Note at connect if a joint's servo is missing and one answers to the factory's id."""
    joint = _adoptable(servos, found)
    if joint is None:
        return []
    servo, wanted = bus.servo(FACTORY_ID, servos.models[joint]), servos.models[joint].number
    if not servo.answers() or wanted not in (None, servo.model_number()):
        return []
    return [
        f"{servos.names(~found)} does not answer, and a servo with id {FACTORY_ID} does: it may have lost "
        "its id; `hexctl servos adopt --robot FILE`, with your robot file, gives it back"
    ]


def adopt(robot: Robot, servos: BusMap, port: str, baud: int) -> tuple[int, float | None, ScannedServo]:
    """Give the servo with the factory's id the id of the only missing joint.

    It is limp then, and restarted if possible. Returns the joint, 0..17, its angle in degrees if reported,
    and the servo. Raises RobotFaultError unless exactly one is missing, and for another model or an angle
    that the joint cannot have.
    """
    if FACTORY_ID in servos.ids.tolist():
        joint = servos.names(servos.ids == FACTORY_ID)
        raise RobotFaultError(f"id {FACTORY_ID} belongs to a joint of the robot file ({joint}): none is lost")
    with opened_line(port, baud, servos.family) as line:
        listener = Listener(tool_line(line, servos.family, servos.protocol))
        found = np.array([listener.answers(each, tries=TRIES) for each in servos.ids.tolist()])
        if damage := listener.damage():
            raise RobotFaultError(damage.description(port))
        joint_index = _adoptable(servos, found)
        if joint_index is None:
            names = servos.names(~found) or "none"
            raise RobotFaultError(f"joints without a servo: {names}; exactly one must be missing")
        servo, seen = _lost_servo(line, servos, joint_index)
        angle_deg = _angle_deg(robot, servos, joint_index, seen)
        if not servo.set_torque(on=False):
            raise RobotFaultError(f"the servo with id {FACTORY_ID} keeps its torque")
        adopted = _give_id(servo, int(servos.ids[joint_index]))
        if servo.reboot():
            line.time.sleep(REBOOTS_S)
            adopted = servo.look()
        return joint_index, angle_deg, adopted


def _adoptable(servos: BusMap, found: BoolArray) -> int | None:
    """Joint whose servo may have lost its id: the only one missing, if no joint has the factory's id."""
    missing = np.flatnonzero(~found).tolist()
    alone = len(missing) == 1 and FACTORY_ID not in servos.ids.tolist()
    return int(missing[0]) if alone else None


def _lost_servo(line: SerialLine, servos: BusMap, joint: int) -> tuple[Servo, ScannedServo]:
    """Servo with the factory's id, and its readings; raises RobotFaultError unless it may be a joint's."""
    servo, name = _find_servo(line, servos.family, FACTORY_ID), servos.names(np.arange(N_JOINTS) == joint)
    if servo is None:
        raise RobotFaultError(
            f"{name} does not answer, and no servo with id {FACTORY_ID} does; is its cable in?"
        )
    seen, wanted = servo.look(), servos.models[joint]
    if wanted.number is not None and seen.model_number != wanted.number:
        raise RobotFaultError(
            f"the servo with id {FACTORY_ID} reports model number {seen.model_number}, not "
            f"{wanted.number} ({wanted.name}) of {name}"
        )
    return servo, seen


def _angle_deg(robot: Robot, servos: BusMap, joint: int, seen: ScannedServo) -> float | None:
    """Angle of a joint by its servo's position; raises RobotFaultError if the joint cannot have it."""
    if seen.position is None:
        return None
    angle_deg = float(np.degrees(servos.angles_rad(np.full(N_JOINTS, float(seen.position)))[joint]))
    ends = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
    if not ends[0] - TOLERANCE_DEG <= angle_deg <= ends[1] + TOLERANCE_DEG:
        name = servos.names(np.arange(N_JOINTS) == joint)
        raise RobotFaultError(
            f"angle of the servo with id {FACTORY_ID}: got {angle_deg:.0f} degrees; allowed for {name}: "
            f"{ends[0]:.0f} to {ends[1]:.0f}; it may be another servo: try `hexctl servos identify`"
        )
    return round(angle_deg, 1)
