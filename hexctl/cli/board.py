"""`hexctl board`: a servo board that speaks MAVLink, with a simulated robot on it."""

import json
from pathlib import Path
from typing import Annotated, Literal

import typer

from hexctl.cli.options import (
    JsonOption,
    Range,
    RobotOption,
    SeedOption,
    SimFailedLegOption,
    SimFailureOption,
    WorldOption,
    choice,
    number,
)

BoardBackend = Literal["sim", "mock"]
EXPIRY_S = Range(low=0.05, high=1, unit="s")
RELEASE_S = Range(low=1, high=3600, unit="s")


def board(
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
    keys: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            help="Folder with mavlink.key, the board's secret: only what it "
            "signed is obeyed. (default: none)",
        ),
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Let others than this computer command without that secret.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Be a servo board that speaks MAVLink 2, to try things without one.

    It runs until Ctrl-C. hexctl run --backend mavlink walks its simulated robot.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result
    from hexctl.robot.failure import failure_of
    from hexctl.serve.service import BoardService, ServiceStarted, ServosSpec

    service = BoardService(
        port=port,
        pty=pty,
        servos=ServosSpec(
            backend=backend, robot=robot, world=world, failure=failure_of(failed_leg, failure), seed=seed
        ),
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
