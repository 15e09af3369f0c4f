"""`hexctl serve`: put a robot on the network."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import (
    InsecureOption,
    KeysOption,
    LinkOption,
    Range,
    RobotOption,
    SeedOption,
    SimFailedLegOption,
    SimFailureOption,
    WorldOption,
    number,
)

SIT_AFTER_S = Range(low=1, high=3600, unit="s")


def serve(
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            autocompletion=completion.served_backends,
            help="What moves: sim (simulation in real time), mavlink (a servo board), mock (servos without a "
            "robot), or package.module:Class for servos of your own.",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    listen: Annotated[
        str | None,
        typer.Option(
            "--listen",
            help="Where to listen: PROTOCOL/HOST:PORT with tcp, tls or quic, such as tls/0.0.0.0:7447. "
            "(default: tcp/127.0.0.1:7447)",
        ),
    ] = None,
    device: Annotated[
        str | None,
        typer.Option(
            "--device",
            help="With mavlink, the servo board's port: /dev/ttyACM0:115200, udpout:HOST:PORT or "
            "udpin:HOST:PORT. (default: udpout:127.0.0.1:14550)",
        ),
    ] = None,
    signing: Annotated[
        Path | None,
        typer.Option(
            "--device-keys",
            help="With mavlink, folder with mavlink.key, the board's secret: only what it "
            "signed is believed. (default: none)",
        ),
    ] = None,
    world: WorldOption = None,
    failed_leg: SimFailedLegOption = None,
    failure: SimFailureOption = None,
    seed: SeedOption = 0,
    sit_after: Annotated[
        float,
        number("--sit-after", SIT_AFTER_S, "Seconds without a command until the robot sits and relaxes, {}."),
    ] = 10.0,
    view: Annotated[
        bool, typer.Option("--view", help="Show the robot in the Rerun viewer while it is served.")
    ] = False,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
) -> None:
    """Put a robot, real or simulated, on the network, with a guard and a stop of its own.

    It runs until Ctrl-C. hexctl run --backend zenoh walks it.
    """
    from hexctl.cli.serving import Service, execute
    from hexctl.cli.twin import Twin

    service = Service(
        twin=Twin(
            backend=backend, robot=robot, world=world, failed_leg=failed_leg, failure=failure, seed=seed
        ),
        listen=listen,
        device=device,
        device_keys=signing,
        sit_after_s=sit_after,
        view=view,
        credentials=keys,
        insecure=insecure,
        link=link,
    )
    raise typer.Exit(execute(service))
