"""`hexctl board`: a servo board that speaks MAVLink, with a simulated robot on it."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import (
    JsonOption,
    RobotOption,
    SeedOption,
    SimFailedLegOption,
    SimFailureOption,
    SimWorldOption,
)


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
        str,
        typer.Option(
            "--backend",
            autocompletion=completion.board_backends,
            help="What the servos move: sim (simulation in real time) or mock (nothing).",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    world: SimWorldOption = None,
    failed_leg: SimFailedLegOption = None,
    failure: SimFailureOption = None,
    seed: SeedOption = 0,
    expiry: Annotated[
        float, typer.Option("--expiry", help="Seconds without a command until the pose is held, 0.05..1.")
    ] = 0.2,
    release_after: Annotated[
        float,
        typer.Option(
            "--release-after", help="Seconds without the controller until the servos are let go, 1..3600."
        ),
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
    from hexctl.cli.boarding import BoardRequest, execute
    from hexctl.cli.twin import Twin

    request = BoardRequest(
        port=port,
        pty=pty,
        twin=Twin(
            backend=backend, robot=robot, world=world, failed_leg=failed_leg, failure=failure, seed=seed
        ),
        expiry_s=expiry,
        release_after_s=release_after,
        keys=keys,
        insecure=insecure,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
