"""`hexctl serve`: put a robot on the network."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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

if TYPE_CHECKING:
    from hexctl.serve.service import ServiceStarted
    from hexctl.wire.links import Link

SIT_AFTER_S = Range(low=1, high=3600, unit="s")


def serve(
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            autocompletion=completion.served_backends,
            help="What moves: sim (simulation in real time), mavlink (a servo board), dynamixel, feetech "
            "or lx16a (servos on a serial bus), servo2040 or pca9685 (boards of hobby servos), mock (servos "
            "without a robot), or package.module:Class for servos of your own.",
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
            "udpin:HOST:PORT (default: udpout:127.0.0.1:14550); with dynamixel, feetech and lx16a that of "
            "the bus: /dev/ttyUSB0:1000000, with servo2040 that of the board: /dev/ttyACM0, and with pca9685 "
            "the I2C bus: /dev/i2c-1. "
            "(default: that of the robot file)",
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
    from hexctl.cli.console import StopOnInterrupt, print_note
    from hexctl.robot.failure import failure_of
    from hexctl.serve.service import RobotService, ServiceStarted, ServosSpec
    from hexctl.wire.links import Role

    service = RobotService(
        servos=ServosSpec(
            backend=backend, robot=robot, world=world, failure=failure_of(failed_leg, failure), seed=seed
        ),
        listen=listen,
        device=device,
        device_keys=signing,
        sit_after_s=sit_after,
        credentials=keys,
        insecure=insecure,
        link=link,
    )
    settings = service.resolved_link()
    if view and settings.credentials is not None:
        from hexctl.wire.certificates import find_credentials

        find_credentials(settings.credentials, Role.VIEWER)  # the robot's own do not admit a viewer
    with StopOnInterrupt() as interrupt, ExitStack() as stack:

        def on_started(started: ServiceStarted) -> None:
            print_note(_greeting(started, settings))
            for warning in started.warnings:
                print_note(f"warning: {warning}")
            if view:
                stack.enter_context(_viewer(settings, link))

        service.run(interrupt.requested, on_started=on_started, on_event=print_note)


@contextmanager
def _viewer(settings: "Link", link: str | None) -> Iterator[None]:
    """Show the robot with a process that is a viewer like any other: it cannot delay the robot."""
    here = settings.endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
    command = [sys.executable, "-m", "hexctl", "view", "--connect", here]
    command += ["--keys", str(settings.credentials)] if settings.credentials is not None else []
    command += ["--link", link] if link is not None else []
    command += ["--insecure"] if settings.insecure else []
    viewer = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        viewer.terminate()
        viewer.wait()


def _greeting(started: "ServiceStarted", settings: "Link") -> str:
    """Line that says that clients can connect."""
    guarded = "certificates" if settings.credentials is not None else "no certificates"
    if settings.insecure:
        guarded = "INSECURE: no certificates beyond this computer"
    timing = "" if started.realtime else ", no real-time priority (needs rtprio): a busy machine delays it"
    return (
        f"serving {started.robot} ({started.backend}) at {started.place}, {guarded}{timing}; Ctrl-C ends it"
    )
