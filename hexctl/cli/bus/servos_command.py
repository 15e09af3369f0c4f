"""`hexctl servos` and `hexctl ports`: servos on a bus, one by one, and serial ports."""

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hexctl.cli.options.output import JsonOption
from hexctl.cli.settings import Commands
from hexctl.cli.values import checked, choice
from hexctl.options import Range
from hexctl.robot.servos.drivers import BUS_DRIVERS, PWM_DRIVERS, BusDriver
from hexctl.serve.boards.board_options import BAUD

if TYPE_CHECKING:
    from rich.table import Table

    from hexctl.backends.serial_ports import SerialPort
    from hexctl.robot.servos.bus_map import BusMap

#: How long the cable of an adapter may take to be pulled.
FIND_TIMEOUT_S = 60.0

servos = Commands(
    help="Look at servos on a serial bus, one by one, before there is a robot file and after.",
    no_args_is_help=True,
)

SERVO_ID = Range(low=0, high=252, whole=True)

#: What asks at every usual baud.
ALL_BAUDS = "all"


def _parse_bauds(text: str) -> str:
    if text != ALL_BAUDS:
        try:
            BAUD.parse(text)
        except ValueError as error:
            raise typer.BadParameter(f"{error}, or {ALL_BAUDS}") from None
    return text


DriverOption = Annotated[
    str | None,
    choice(
        "--driver",
        BusDriver,
        "Whose protocol the servos speak: dynamixel, feetech or lx16a. (default: that of --robot, else it "
        "must be given)",
    ),
]
PortOption = Annotated[
    str | None,
    typer.Option(
        "--port",
        help="Serial device of the bus, such as /dev/ttyUSB0. (default: that of --robot, else it must be "
        "given)",
    ),
]
BaudOption = Annotated[
    int | None,
    typer.Option(
        "--baud",
        parser=checked(BAUD.parse),
        help=f"Bits per second, {BAUD}. (default: that of --robot, else 1000000, with lx16a 115200)",
    ),
]
BaudsOption = Annotated[
    str | None,
    typer.Option(
        "--baud",
        parser=_parse_bauds,
        help=f"Bits per second, {BAUD}, or all: every baud that is usual for the driver, one after the "
        "other. (default: that of --robot, else 1000000, with lx16a 115200)",
    ),
]
RobotFileOption = Annotated[
    str | None,
    typer.Option(
        "--robot", help="Robot file whose section servos has driver, port and baud. (default: none)"
    ),
]
YesOption = Annotated[
    bool, typer.Option("--yes", help="Move without asking, for scripts: a limp leg falls, and moves.")
]


def _an_id(help_text: str) -> Any:
    """Argument that is the id of a servo."""
    return typer.Argument(parser=checked(SERVO_ID.parse), metavar="ID", help=help_text, show_default=False)


@servos.command()
def scan(
    driver: DriverOption = None,
    port: PortOption = None,
    baud: BaudsOption = None,
    robot: RobotFileOption = None,
    as_json: JsonOption = False,
) -> None:
    """Ask all ids which servos answer: model, position, voltage, temperature. Nothing moves.

    With --robot also which joint each is, and what differs from the file. Exit code 3 where none answers.
    """
    from hexctl.backends.bus.scan import USUAL_BAUDS, nothing_answers, scan_bus
    from hexctl.backends.bus.unexpected_ids import id_differences, joint_of
    from hexctl.cli.console import DONE, FAULT, print_note, print_result

    every = baud == ALL_BAUDS
    driver, path, speed = _bus(robot, driver, port, None if every or baud is None else int(baud))
    bauds = USUAL_BAUDS[driver] if every else (speed,)
    with _Bar("asking ids") as bar:
        found = scan_bus(path, driver, *bauds, progress=bar.told)
    unknown = [each.servo_id for each in found if each.model is None]
    if unknown and driver == "lx16a":
        print_note("these servos tell no model")
    elif unknown:
        print_note(f"{len(unknown)} servos are of a model that is not known: is {driver} the right driver?")
    if not found:
        print_note(nothing_answers(path, driver, bauds))
    rows = [each.to_json() for each in found]
    if robot is not None and found:
        servo_map = _map_of(robot, driver)
        rows = [{"joint": joint_of(servo_map, each.servo_id), **each.to_json()} for each in found]
        for note in id_differences(servo_map, [each.servo_id for each in found]):
            print_note(note)
    if as_json:
        print_result(json.dumps(rows))
    elif found:
        print_result(_table([_readable(row) for row in rows], ""))
    raise typer.Exit(DONE if found else FAULT)


@servos.command("set-id")
def set_id(
    new_id: Annotated[int, _an_id(f"The id to give, a whole number {SERVO_ID}.")],
    driver: DriverOption = None,
    port: PortOption = None,
    baud: BaudOption = None,
    as_json: JsonOption = False,
) -> None:
    """Give the only servo on the bus another id; with more than one nothing is changed."""
    from hexctl.backends.bus.scan import set_servo_id
    from hexctl.cli.console import print_result

    driver, path, speed = _bus(None, driver, port, baud)
    with _Bar("asking ids") as bar:
        servo = set_servo_id(path, driver, speed, int(new_id), progress=bar.told).to_json()
    print_result(json.dumps(servo)) if as_json else print_result(_table([_readable(servo)], ""))


@servos.command()
def identify(
    servo_id: Annotated[
        int | None, _an_id(f"Only this servo, a whole number {SERVO_ID}. (default: all that answer)")
    ] = None,
    driver: DriverOption = None,
    port: PortOption = None,
    baud: BaudOption = None,
    robot: RobotFileOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            help="New file for the section servos of a robot file; what is known meanwhile is in a file "
            "beside it, which the same command continues. (default: none, it is printed)",
        ),
    ] = None,
    model: Annotated[
        str | None,
        choice(
            "--model",
            Literal["lx16a", "lx224", "hts35h"],
            "Model of servos that do not tell it, those of lx16a. (default: that of --robot, else lx16a)",
        ),
    ] = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Move one servo after the other by 5 degrees and back, and ask which joint it was.

    Hold the robot so that its legs hang free. What is found is printed as the section servos of a robot file;
    no robot file is written.
    """
    from hexctl.backends.bus.scan import scan_bus
    from hexctl.cli.console import DONE, INTERRUPTED, StopOnInterrupt, print_note, print_result
    from hexctl.cli.prompts import CalibrationPrompt
    from hexctl.control.calibration.servo_identification import Identification, identify_servos
    from hexctl.errors import InputError

    if robot is not None and output is not None:
        raise InputError(
            "--output: got it with --robot; allowed: without --robot, to which nothing is written"
        )
    driver, path, speed = _bus(robot, driver, port, baud)
    untold = _untold_model(driver, robot, model)
    _check_answerable()
    known = Identification(driver=driver, port=path, baud=speed, output=output, model=untold)
    known.resume()
    if servo_id is None:
        with _Bar("asking ids") as bar:
            ids = [each.servo_id for each in scan_bus(path, driver, speed, progress=bar.told)]
    else:
        ids = [int(servo_id)]
    with StopOnInterrupt(plain=True) as interrupt:
        identify_servos(known, ids, CalibrationPrompt(), consent=yes, stop_requested=interrupt.requested)
        stopped = interrupt.requested()
    print_result(json.dumps(known.ids) if as_json else known.section().rstrip())
    if known.finish():
        print_note(f"written to {output}")
    elif output is not None:
        there = known.draft is not None and known.draft.exists()
        kept = f", in {known.draft}; the same command continues" if there else "; nothing is written"
        print_note(f"{len(known.ids)} of 18 joints are known{kept}")
    raise typer.Exit(INTERRUPTED if stopped else DONE)


@servos.command("test")
def try_(
    servo_id: Annotated[int, _an_id(f"The servo to test, a whole number {SERVO_ID}.")],
    driver: DriverOption = None,
    port: PortOption = None,
    baud: BaudOption = None,
    robot: RobotFileOption = None,
    yes: YesOption = False,
    as_json: JsonOption = False,
) -> None:
    """Move one servo by 10 degrees to both sides and back, and tell whether it followed.

    It goes limp first, and ends with its torque as it was. Hold the robot so that its legs hang free.
    """
    from hexctl.backends.bus.scan import opened_line, the_servo
    from hexctl.cli.console import DONE, FAULT, print_note, print_result
    from hexctl.control.calibration.servo_trial import try_servo

    driver, path, speed = _bus(robot, driver, port, baud)
    with opened_line(path, speed) as line:
        servo = the_servo(line, driver, int(servo_id))
        _ask_consent(
            f"The servo with id {servo_id} goes limp and moves by 10 degrees to both sides.", yes=yes
        )
        trial = try_servo(servo)
    rows = asdict(trial)
    print_result(json.dumps(rows) if as_json else _column(rows))
    if not trial.followed:
        print_note("it did not follow: is its leg free, its horn fixed, and its supply strong enough?")
    raise typer.Exit(DONE if trial.followed else FAULT)


@servos.command()
def adopt(
    robot: Annotated[
        str,
        typer.Option(
            "--robot", help="Robot file with the ids of all joints. (default: none, it must be given)"
        ),
    ],
    port: PortOption = None,
    baud: BaudOption = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Give the id without asking, for scripts: the joint goes limp.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Give a servo that has fallen back to the id 1 the id of the only joint whose servo is missing.

    Its model and its position have to fit that joint. It goes limp; X servos are restarted.
    """
    from hexctl.backends.bus.lost_id import adopt as adopt_servo
    from hexctl.cli.console import print_result
    from hexctl.robot.loader import load_robot_file
    from hexctl.types import JOINT_NAMES

    driver, path, speed = _bus(robot, None, port, baud)
    servo_map = _map_of(robot, driver)
    _ask_consent("The servo that has lost its id goes limp.", yes=yes)
    adoption = adopt_servo(load_robot_file(robot).robot, servo_map, path, speed)
    rows = {"joint": JOINT_NAMES[adoption.joint], "angle_deg": adoption.angle_deg, **adoption.servo.to_json()}
    print_result(json.dumps(rows) if as_json else _column(_readable(rows)))


def ports(
    find: Annotated[
        bool, typer.Option("--find", help="Find the port of an adapter: pull its cable when asked to.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List serial ports that have a device, with their adapters."""
    from hexctl.backends.serial_ports import serial_ports
    from hexctl.cli.console import print_note, print_result

    found = [_found_port()] if find else serial_ports()
    rows = [asdict(each) for each in found if each is not None]
    if as_json:
        print_result(json.dumps(rows))
        return
    print_result(_table(rows, "no serial ports"))
    if not any(row["vendor"] for row in rows):
        print_note("hexctl: no USB serial adapter found: plug it in, with a cable that carries data")


def _found_port() -> "SerialPort | None":
    """The port whose cable an operator pulls; raises Exit where it is interrupted."""
    from hexctl.backends.serial_ports import serial_ports, unplugged_port
    from hexctl.cli.console import INTERRUPTED, StopOnInterrupt, print_note

    before = serial_ports()
    print_note(f"{len(before)} ports; now pull the cable of the adapter (Ctrl-C ends it)")
    with StopOnInterrupt(plain=True) as interrupt:
        found = unplugged_port(before, timeout_s=FIND_TIMEOUT_S, stop_requested=interrupt.requested)
        if interrupt.requested():
            raise typer.Exit(INTERRUPTED)
    print_note("that is it; plug it in again")
    return found


def _bus(robot: str | None, driver: str | None, port: str | None, baud: int | None) -> tuple[str, str, int]:
    """Driver, device and baud: as typed, else as in a robot file, else as usual for the driver."""
    from hexctl.backends.bus.servos import parse_bus_port
    from hexctl.errors import InputError
    from hexctl.robot.loader import load_robot_file

    section = None if robot is None else load_robot_file(robot).content.servos
    if section is not None and section.driver in PWM_DRIVERS:
        raise InputError(
            f"--robot: got {robot}, whose servos are hobby servos ({section.driver}), which cannot be asked; "
            f"allowed: with {', '.join(BUS_DRIVERS)}"
        )
    if driver is None:
        driver = None if section is None else section.driver
    elif section is not None and section.driver not in (None, driver):
        raise InputError(f"--driver: got {driver}; allowed: {section.driver}, with this robot file")
    if driver not in BUS_DRIVERS:
        raise InputError(f"--driver: got {driver or 'none'}; allowed: {', '.join(BUS_DRIVERS)}")
    text = port or (None if section is None else section.port)
    if not text:
        raise InputError("--port: got none; allowed: the port of the bus, such as /dev/ttyUSB0")
    of_file = None if section is None or section.baud is None else int(section.baud)
    path, speed = parse_bus_port(text, of_file if baud is None else int(baud), driver=driver)
    return driver, path, speed


def _untold_model(driver: str, robot: str | None, model: str | None) -> str | None:
    """Model of servos that do not tell theirs: as typed, else of the robot file, else the usual one, told."""
    from hexctl.cli.console import print_note
    from hexctl.errors import InputError
    from hexctl.robot.loader import load_robot_file
    from hexctl.robot.servos.servo_models import DEFAULT_MODELS

    if driver != "lx16a":
        if model is not None:
            raise InputError(
                f"--model: got {model} with {driver}; allowed: with lx16a; others tell their model"
            )
        return None
    of_file = None if robot is None else load_robot_file(robot).content.servos.model
    if model is None and of_file is None:
        print_note(f"these servos tell no model: {DEFAULT_MODELS[driver]} is written; --model says another")
    return model or of_file or DEFAULT_MODELS[driver]


def _map_of(robot: str, driver: str) -> "BusMap":
    """Bus map of a robot file."""
    from hexctl.robot.loader import load_robot_file
    from hexctl.robot.servos.bus_map import bus_map_of

    return bus_map_of(load_robot_file(robot).content.servos, driver)


def _check_answerable() -> None:
    """Raise InputError where no answer can come on stdin."""
    from hexctl.cli.prompts import can_answer
    from hexctl.errors import InputError

    if not can_answer():
        raise InputError("identify: no answer can come on stdin; allowed: a terminal, or lines from a pipe")


def _ask_consent(text: str, *, yes: bool) -> None:
    """Ask whether a servo may move; raises InputError where the operator does not want it, or cannot say."""
    from hexctl.cli.console import print_note, print_question
    from hexctl.cli.prompts import LOOK_S, StdinLines, can_answer
    from hexctl.errors import InputError

    if yes:
        return
    if not can_answer():
        raise InputError("--yes: got none, and no answer can come on stdin; allowed: --yes, or a terminal")
    print_question(f"{text} Hold the robot so that its legs hang free. Go on? yes or no: ")
    lines = StdinLines()
    while (said := lines.poll(LOOK_S)) is None and not lines.ended:
        pass
    if said is None or not sys.stdin.isatty():
        print_note("")  # no key ended the line on the screen
    if said is None or said.strip().lower() not in ("y", "yes"):
        raise InputError(f"consent: got {said or 'no answer'}; allowed: yes; nothing was moved")


class _Bar:
    """Progress of a scan on stderr: a bar on a terminal, else one line."""

    def __init__(self, text: str) -> None:
        from hexctl.cli.console import make_bar

        self._bar, self._text = make_bar(), text
        self._task: Any = None

    def __enter__(self) -> "_Bar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def told(self, asked: int, of: int) -> None:
        """Show how many have been asked."""
        from hexctl.cli.console import print_note

        if self._task is None:
            self._task = self._bar.add_task(self._text, total=of)
            if self._bar.disable:
                print_note(f"{self._text}: {of}, some seconds")
        self._bar.update(self._task, completed=asked)


#: Units of what a servo reports; its position is raw.
UNITS = {"position": "counts", "voltage": "V", "temperature": "°C"}


def _readable(servo: dict[str, Any]) -> dict[str, Any]:
    """What a servo reports, with units; its model's number only if the model has no name."""
    row = {
        name: value if value is None or name not in UNITS else f"{value} {UNITS[name]}"
        for name, value in servo.items()
        if name not in ("model_number", "protocol")
    }
    if servo["model"] is None and servo["model_number"] is not None:
        row["model"] = f"number {servo['model_number']}"
    return row


def _column(rows: dict[str, Any]) -> "Table":
    """Names and values below one another."""
    from hexctl.cli.render.tables import plain_table

    table = plain_table("what", "value")
    for name, value in rows.items():
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else value
        table.add_row(name, "" if shown is None else str(shown))
    return table


def _table(rows: list[dict[str, Any]], empty: str) -> "Table | str":
    """Rows as a table, or what is said of none."""
    from hexctl.cli.render.tables import plain_table

    if not rows:
        return empty
    table = plain_table(*rows[0])
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    return table
