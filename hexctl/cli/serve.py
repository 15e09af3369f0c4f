"""`hexctl serve`: put a robot on the network."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completing
from hexctl.cli.options import InsecureOption, KeysOption, LinkOption, RobotOption


def serve(
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            autocompletion=completing.served_backends,
            help="Whose servos: sim (paced in real time), mavlink, mock, or package.module:Class.",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    listen: Annotated[
        str | None,
        typer.Option("--listen", help="Zenoh endpoint to listen at. (default: tcp/127.0.0.1:7447)"),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option("--device", help="With mavlink, its port. (default: udpout:127.0.0.1:14550)"),
    ] = None,
    signing: Annotated[
        Path | None,
        typer.Option("--device-keys", help="With mavlink, folder with mavlink.key: signed frames only."),
    ] = None,
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
    sit_after: Annotated[
        float,
        typer.Option(
            "--sit-after", help="Seconds without a command until the robot sits and relaxes, 1..3600."
        ),
    ] = 10.0,
    view: Annotated[
        bool, typer.Option("--view", help="Show the robot in Rerun while it is served, as hexctl view does.")
    ] = False,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
) -> None:
    """Put a robot, real or simulated, on the network, with a guard and a stop of its own. Ctrl-C ends it."""
    from hexctl.cli.serving import Service, execute

    service = Service(
        backend=backend,
        robot=robot,
        listen=listen,
        device=device,
        device_keys=signing,
        world=world,
        failed_leg=failed_leg,
        failure=failure,
        seed=seed,
        sit_after_s=sit_after,
        view=view,
        credentials=keys,
        insecure=insecure,
        link=link,
    )
    raise typer.Exit(execute(service))
