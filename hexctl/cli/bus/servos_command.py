"""`hexctl servos`: servos on a serial bus, one by one."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.backends.bus.bus_options import (
    ALL_BAUDS,
    BusAddress,
    BusOptions,
    ScanOptions,
    ServoAssignmentOptions,
)
from hexctl.cli.console import DONE, FAULT, INTERRUPTED, StopOnInterrupt, print_note, print_result
from hexctl.cli.progress import ScanProgress
from hexctl.cli.settings import Commands
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import checked, with_options
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.servos.drivers import SERVO_ID

if TYPE_CHECKING:
    from hexctl.backends.bus.bus_map import BusMap
    from hexctl.backends.bus.damage import Damage
    from hexctl.backends.bus.servo import ScannedServo

servos = Commands()

YesOption = Annotated[
    bool, typer.Option("--yes", help="Move without asking, for scripts: a limp leg falls, and moves.")
]


def _an_id(help_text: str) -> Any:
    return typer.Argument(parser=checked(SERVO_ID.parse), metavar="ID", help=help_text, show_default=False)


@servos.command()
@with_options(ScanOptions, but=("baud",))
def scan(options: dict[str, Any], as_json: JsonOption = False) -> None:
    """Ask all ids which servos answer: model, position, voltage, temperature. Nothing moves.

    With --robot also which joint each is, and what differs from the file. Exit code 3 if none answers, or
    answers are damaged.
    """
    from hexctl.backends.bus.tools import check_family, damage_report, nothing_answers, scan_bus

    asked = ScanOptions(**options)
    bus = asked.address()
    bauds = asked.bauds_at(bus)
    if all_asked := asked.bauds == ALL_BAUDS:  # some seconds, in place of one or two minutes
        check_family(bus.path, bus.driver, bauds)
    with ScanProgress() as progress:
        damages: list[Damage] = []
        found = scan_bus(bus.path, bus.driver, *bauds, progress=progress.show, on_damage=damages.append)
    _note_models(bus, found)
    _note_firmware(found)
    for damage in damages:
        print_note(damage_report(damage, bus.path, bus.driver))
    if not (found or damages):
        print_note(nothing_answers(bus.path, bus.driver, bauds, all_asked=all_asked))
    _print_scan(found, asked.servo_map() if found else None, as_json=as_json)
    raise typer.Exit(DONE if found and not damages else FAULT)


def _note_models(bus: BusAddress, found: "Sequence[ScannedServo]") -> None:
    """Note servos without a model; raises InputError if none has one with this driver, but with another."""
    from hexctl.backends.bus.tools import check_family

    if not found:
        return
    unknown = [each for each in found if each.model is None]
    if unknown and not bus.family.reports_model:
        names = ", ".join(model.name for model in bus.family.models)
        print_note(f"these servos do not report their model: {names} and clones answer alike")
        return
    if len(unknown) == len(found):
        check_family(bus.path, bus.driver, {each.baud for each in found})
    for number in dict.fromkeys(each.model_number for each in unknown):
        ids = ", ".join(str(each.servo_id) for each in unknown if each.model_number == number)
        what = "without a model number" if number is None else f"of the unknown model number {number}"
        print_note(f"id {ids}: {what}, which hexctl does not move; is {bus.driver} the right driver?")
    for model in bus.family.models:
        if model.twins and model.name in {each.model for each in found}:
            print_note(f"{model.name}: the number {model.number} is also that of {model.twins} and clones")


def _note_firmware(found: "Sequence[ScannedServo]") -> None:
    """Note firmware and type of servos that report them, one line for each kind."""
    kinds: dict[str, list[str]] = {}
    for each in found:
        firmware = f"firmware {each.firmware}" if each.firmware else ""
        if words := ", ".join(filter(None, (firmware, each.variant))):
            kinds.setdefault(words, []).append(str(each.servo_id))
    for words, ids in kinds.items():
        print_note(f"{words}: " + ("all" if len(ids) == len(found) > 1 else f"id {', '.join(ids)}"))
    silent = [str(each.servo_id) for each in found if not each.firmware]
    if silent:
        print_note("firmware unknown: " + ("all" if len(silent) == len(found) else f"id {', '.join(silent)}"))


def _print_scan(found: "Sequence[ScannedServo]", servo_map: "BusMap | None", *, as_json: bool) -> None:
    from hexctl.backends.bus.tools import id_differences, joint_of
    from hexctl.cli.render.tables import row_table, with_units

    rows = [each.to_json() for each in found]
    if servo_map is not None:
        rows = [{"joint": joint_of(servo_map, each.servo_id), **each.to_json()} for each in found]
        for note in id_differences(servo_map, [each.servo_id for each in found]):
            print_note(note)
        stated = servo_map.p_gain
        odd = [each for each in found if each.p_gain is not None and stated not in (None, each.p_gain)]
        if odd:
            ids = ", ".join(f"{each.servo_id} ({each.p_gain})" for each in odd)
            print_note(f"P gain not {stated}, which the robot file states: id {ids}")
    if as_json:
        print_result(rows)
    elif rows:
        print_result(row_table([with_units(row) for row in rows]))


@servos.command("set-id")
@with_options(BusOptions, but=("robot",))
def set_id(
    options: dict[str, Any],
    new_id: Annotated[int, _an_id(f"The id to give, a whole number {SERVO_ID}.")],
    as_json: JsonOption = False,
) -> None:
    """Give the only servo on the bus another id; with more than one nothing is changed."""
    from hexctl.backends.bus.tools import set_servo_id
    from hexctl.cli.render.tables import row_table, with_units

    bus = BusOptions(**options).address()
    with ScanProgress() as progress:
        servo = set_servo_id(bus.path, bus.driver, bus.baud, int(new_id), progress=progress.show).to_json()
    print_result(servo if as_json else row_table([with_units(servo)]))


@servos.command()
@with_options(ServoAssignmentOptions)
def identify(
    options: dict[str, Any],
    servo_id: Annotated[
        int | None, _an_id(f"Only this servo, a whole number {SERVO_ID}. (default: all that answer)")
    ] = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Move one servo after the other by 5 degrees and back, and ask which joint it was.

    Hold the robot so that its legs hang free. The result is printed as the section servos of a robot file;
    no robot file is written.
    """
    from hexctl.cli.prompts import CalibrationPrompt, check_answerable
    from hexctl.control.calibration.servo_assignment import ServoAssignment, assign_servos

    asked = ServoAssignmentOptions(**options)
    bus = asked.address()
    model = asked.unreported_model(bus.family)
    if model is not None and asked.model is None:
        print_note(f"these servos do not report their model: {model} is written; --model sets another")
    output = None if asked.output is None else Path(asked.output)
    known = ServoAssignment(driver=bus.driver, port=bus.path, baud=bus.baud, output=output, model=model)
    check_answerable("identify")
    known.resume()
    ids = _answering(bus) if servo_id is None else [int(servo_id)]
    with StopOnInterrupt(plain=True) as interrupt:
        assign_servos(known, ids, CalibrationPrompt(), consent=yes, stop_requested=interrupt.requested)
        stopped = interrupt.requested()
    print_result(known.ids if as_json else known.section().rstrip())
    if known.finish():
        print_note(f"written to {known.output}")
    elif known.output is not None:
        there = known.draft is not None and known.draft.exists()
        kept = f", in {known.draft}; the same command continues" if there else "; nothing is written"
        print_note(f"{len(known.ids)} of 18 joints are known{kept}")
    raise typer.Exit(INTERRUPTED if stopped else DONE)


@servos.command("walk-through")
@with_options(BusOptions)
def walk_through_(options: dict[str, Any], yes: YesOption = False, as_json: JsonOption = False) -> None:
    """Move the joints of one leg after another by 5 degrees and ask which it was, before the first walk.

    The robot is on a stand or on its belly. If all joints are right, the robot file remembers it. Exit code 3
    if legs or joints are exchanged.
    """
    from hexctl.backends.bus.bus_map import ids_mark
    from hexctl.cli.prompts import CalibrationPrompt, check_answerable
    from hexctl.control.calibration.walk_through import exchanged_legs, walk_through
    from hexctl.robot.loader import load_robot_file
    from hexctl.robot.servos.servos_section import check_writable, write_mark
    from hexctl.types import N_LEGS

    asked = BusOptions(**options)
    servo_map = asked.servo_map()
    if asked.robot is None or servo_map is None:
        raise InputError("--robot: got none; allowed: the robot file with the ids of all joints")
    bus, file = asked.address(), load_robot_file(asked.robot)
    check_writable(file.path, "servos walk-through --robot")
    check_answerable("walk-through")
    with StopOnInterrupt(plain=True) as interrupt:
        stop = interrupt.requested
        seen = walk_through(
            servo_map, bus.path, bus.baud, CalibrationPrompt(), consent=yes, stop_requested=stop
        )
        stopped = stop()
    wrong, complete = exchanged_legs(seen), len(seen) == N_LEGS
    if complete and not wrong:
        write_mark(file.path, ids_mark(file.content.servos))
    print_result({"legs": seen, "right": complete and not wrong} if as_json else _legs_text(seen))
    if wrong:
        print_note(f"{wrong}: exchange their ids in {file.path}, and repeat")
        raise typer.Exit(FAULT)
    if not complete:
        print_note(f"{len(seen)} of {N_LEGS} legs are seen; nothing is written")
    raise typer.Exit(INTERRUPTED if stopped else DONE)


def _legs_text(seen: dict[int, int]) -> str:
    right = ", ".join(str(leg) for leg, real in seen.items() if leg == real)
    return f"legs that move as the file says: {right or 'none'}"


def _answering(bus: BusAddress) -> list[int]:
    from hexctl.backends.bus.tools import damage_report, scan_bus

    with ScanProgress() as progress:
        damages: list[Damage] = []
        found = scan_bus(bus.path, bus.driver, bus.baud, progress=progress.show, on_damage=damages.append)
    if damages:  # two servos with one id would move together
        raise RobotFaultError("; ".join(damage_report(each, bus.path, bus.driver) for each in damages))
    return [each.servo_id for each in found]


@servos.command("test")
@with_options(BusOptions)
def try_(
    options: dict[str, Any],
    servo_id: Annotated[int, _an_id(f"The servo to test, a whole number {SERVO_ID}.")],
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Move one servo by 10 degrees to both sides and back, and report whether it followed.

    It goes limp first, and ends with its torque as it was. Hold the robot so that its legs hang free.
    """
    from hexctl.backends.bus.tools import opened_line, the_servo
    from hexctl.cli.prompts import ask_consent
    from hexctl.cli.render.tables import value_table
    from hexctl.control.calibration.servo_trial import try_servo

    bus = BusOptions(**options).address()
    with opened_line(bus.path, bus.baud, bus.family) as line:
        servo = the_servo(line, bus.driver, int(servo_id))
        ask_consent(f"The servo with id {servo_id} goes limp and moves by 10 degrees to both sides.", yes=yes)
        trial = try_servo(servo)
    values = asdict(trial)
    shown = {name: value for name, value in values.items() if value != ""}
    print_result(values if as_json else value_table(shown))
    if not trial.followed:
        print_note("it did not follow: is its leg free, its horn fixed, and its supply strong enough?")
    raise typer.Exit(DONE if trial.followed else FAULT)


@servos.command()
@with_options(BusOptions, but=("driver",))
def adopt(
    options: dict[str, Any],
    yes: Annotated[
        bool, typer.Option("--yes", help="Give the id without asking, for scripts: the joint goes limp.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Give a servo that fell back to the id 1 the id of the only joint without a servo.

    Its model and its position have to fit that joint. It goes limp; X servos are restarted.
    """
    from hexctl.backends.bus.tools import adopt as adopt_servo
    from hexctl.cli.prompts import ask_consent
    from hexctl.cli.render.tables import value_table, with_units
    from hexctl.robot.loader import load_robot_file
    from hexctl.types import JOINT_NAMES

    asked = BusOptions(**options)
    servo_map = asked.servo_map()
    if asked.robot is None or servo_map is None:
        raise InputError("--robot: got none; allowed: the robot file with the ids of all joints")
    bus = asked.address()
    ask_consent("The servo without its id goes limp.", yes=yes)
    robot = load_robot_file(asked.robot).robot
    joint, angle_deg, servo = adopt_servo(robot, servo_map, bus.path, bus.baud)
    rows = {"joint": JOINT_NAMES[joint], "angle_deg": angle_deg, **servo.to_json()}
    print_result(rows if as_json else value_table(with_units(rows)))
