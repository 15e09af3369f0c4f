"""`hexctl board`: a servo board that speaks MAVLink, with a simulated robot on it."""

import json
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from hexctl.cli.options.connection import BoardInsecureOption, BoardKeysOption
from hexctl.cli.options.failure import SimFailedLegOption, SimFailureOption
from hexctl.cli.options.output import JsonOption
from hexctl.cli.options.robot import RobotOption, SeedOption, WorldOption
from hexctl.cli.values import choice, given, number
from hexctl.options import Range
from hexctl.robot.servos.drivers import Driver

if TYPE_CHECKING:
    from hexctl.serve.boards.board_service import BusBoardService
    from hexctl.serve.service import ServiceStarted

BoardBackend = Literal["sim", "mock"]
BAUD = Range(low=9600, high=4_500_000, whole=True, unit="baud")
EXPIRY_S = Range(low=0.05, high=1, unit="s")
RELEASE_S = Range(low=1, high=3600, unit="s")


#: Options of a MAVLink board alone, and of a bus alone.
OF_BOARD = ("--port", "--pty", "--expiry", "--release-after", "--keys", "--insecure")
OF_BUS = ("--model", "--baud", "--fault")


def board(
    context: typer.Context,
    port: Annotated[
        str | None,
        typer.Option(
            "--port",
            help="Where controllers reach it: udpin:HOST:PORT (waits), udpout:HOST:PORT (calls) or a serial "
            "device such as /dev/ttyACM0:115200. "
            "(default: udpin:127.0.0.1:14550)",
        ),
    ] = None,
    pty: Annotated[
        bool, typer.Option("--pty", help="Make a serial device instead, a pseudo-terminal, and say its name.")
    ] = False,
    backend: Annotated[
        BoardBackend,
        choice(
            "--backend",
            BoardBackend,
            "What the servos move: sim (simulation in real time) or mock (nothing).",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    world: WorldOption = None,
    failed_leg: SimFailedLegOption = None,
    failure: SimFailureOption = None,
    seed: SeedOption = 0,
    expiry: Annotated[
        float, number("--expiry", EXPIRY_S, "Seconds without a command until the pose is held, {}.")
    ] = 0.2,
    release_after: Annotated[
        float,
        number("--release-after", RELEASE_S, "Seconds without the controller until torque is disabled, {}."),
    ] = 10.0,
    keys: BoardKeysOption = None,
    insecure: BoardInsecureOption = False,
    bus: Annotated[
        Driver | None,
        choice(
            "--bus",
            Driver,
            "Be servos on a serial bus instead, on a pseudo-terminal: dynamixel, feetech, lx16a, or the "
            "board servo2040 with hobby servos; or two boards pca9685, on a socket. "
            "(default: a MAVLink board)",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            help="With --bus, model of all servos, such as ax12a or sts3215; with servo2040 its firmware, "
            "stock or fork. (default: that of the robot file, else xl430-w250, sts3215, lx16a or stock)",
        ),
    ] = None,
    baud: Annotated[
        int | None,
        number(
            "--baud",
            BAUD,
            "With --bus, bits per second: how long packets take, {}. (default: 1000000, with lx16a 115200, "
            "with pca9685 400000)",
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            help="With --bus, what goes wrong, repeatable: mute:5:coxa@10, hot:2:femur:72@5, "
            "overload:4:femur@6, lost-id:3:tibia@8, bad-cable:3:femur:0.2, brown-out@12, unplug@15, "
            "replug@18, garble:0.01, wild:0.01, wild-once@5, echo; with servo2040 "
            "mute@10, trip:12@10, unplug@15, replug@18, garble:0.01; with pca9685 nack:0.01, reset@10, "
            "unplug@15, replug@18. (default: nothing)",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Be a servo board that speaks MAVLink 2, or servos on a bus, to try things without one.

    It runs until Ctrl-C. hexctl run --backend mavlink walks its simulated robot, and hexctl run --backend
    feetech --connect PORT that behind servos on a bus.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result
    from hexctl.serve.boards.board_service import BoardService, BusBoardService
    from hexctl.serve.service import ServiceStarted, ServosSpec

    servos = ServosSpec(
        backend=backend,
        robot=robot,
        world=world,
        failed_leg=failed_leg,
        failure=failure or (),
        seed=seed,
    )
    _check_of_one(context, bus)
    if bus is not None:
        _run_bus(
            BusBoardService(
                driver=bus,
                servos=servos,
                model=model,
                baud=None if baud is None else int(baud),
                faults=tuple(fault or ()),
            ),
            as_json=as_json,
        )
        return
    service = BoardService(
        port=port,
        pty=pty,
        servos=servos,
        expiry_s=expiry,
        release_after_s=release_after,
        keys=keys,
        insecure=insecure,
    )
    signed = "signed frames only" if service.signed else "not signed"

    def on_started(started: ServiceStarted) -> None:
        name = f"{started.robot} ({started.backend})"
        print_note(f"board of {name} at {started.place}, {signed}; Ctrl-C ends it")

    with StopOnInterrupt() as interrupt:
        report = service.run(interrupt.requested, on_started=on_started)
    if as_json:
        print_result(json.dumps(report))


def _check_of_one(context: typer.Context, bus: str | None) -> None:
    """Raise InputError for options of the board that were typed with a bus, and the other way round."""
    from hexctl.errors import InputError

    for flag in given(context):
        if bus is not None and flag in OF_BOARD:
            raise InputError(f"{flag}: got it with --bus {bus}; allowed: without --bus")
        if bus is None and flag in OF_BUS:
            raise InputError(f"{flag}: got it without --bus; allowed: with --bus")


def _run_bus(service: "BusBoardService", *, as_json: bool) -> None:
    """Be a bus until Ctrl-C."""
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result

    def on_started(started: "ServiceStarted") -> None:
        what = f"bus of {started.robot} ({started.backend}) with {service.driver} servos"
        print_note(f"{what} at {started.place}, {service.bits_per_s} baud; Ctrl-C ends it")

    with StopOnInterrupt() as interrupt:
        report = service.run(interrupt.requested, on_started=on_started)
    if as_json:
        print_result(json.dumps(report))
