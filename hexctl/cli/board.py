"""`hexctl board`: a servo board that speaks MAVLink, with a simulated robot on it."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completing
from hexctl.cli.options import JsonOption, RobotOption


def board(
    port: Annotated[
        str | None,
        typer.Option(
            "--port",
            help="udpin:HOST:PORT, udpout:HOST:PORT or a serial device such as /dev/ttyACM0:115200. "
            "(default: udpin:127.0.0.1:14550)",
        ),
    ] = None,
    pty: Annotated[
        bool, typer.Option("--pty", help="Make a pseudo-terminal instead and say which device it is.")
    ] = False,
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            autocompletion=completing.board_backends,
            help="What the servos move: sim (in real time) or mock.",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            autocompletion=completing.worlds,
            help="With sim, its world, as in hexctl run. (default: flat)",
        ),
    ] = None,
    failed_leg: Annotated[
        int | None,
        typer.Option(
            "--failed-leg", autocompletion=completing.legs, help="With sim, the leg that failed, 1..6."
        ),
    ] = None,
    failure: Annotated[
        str | None,
        typer.Option(
            "--failure",
            autocompletion=completing.failures,
            help="With sim, as in hexctl run. (default: locked)",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="With sim, of everything random, 0 or more.")] = 0,
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
        Path | None, typer.Option("--keys", help="Folder with mavlink.key: obey signed frames only.")
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Let others than this computer command without signatures.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Be a servo board that speaks MAVLink 2, the stand-in for firmware. Ctrl-C ends it."""
    from hexctl.cli.boarding import BoardRequest, execute

    request = BoardRequest(
        port=port,
        pty=pty,
        backend=backend,
        robot=robot,
        world=world,
        failed_leg=failed_leg,
        failure=failure,
        seed=seed,
        expiry_s=expiry,
        release_after_s=release_after,
        keys=keys,
        insecure=insecure,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
