"""`hexctl serve`: put a robot on the network."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import zip_longest
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import StopOnInterrupt, print_note
from hexctl.cli.settings import SettingsCommand, is_said
from hexctl.cli.signature import with_options
from hexctl.robot.loader import load_robot_file
from hexctl.server.serve_options import DEFAULT_ROUTER, ServeOptions
from hexctl.wire.links import Link, Role

if TYPE_CHECKING:
    from hexctl.server.service import ServiceStarted

#: Maximum wait for the viewer to end.
VIEWER_END_S = 5.0


class ServeCommand(SettingsCommand):
    """The command with an option --ros whose value is optional."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the router's default address after a bare --ros."""
        full: list[str] = []
        for word, following in zip_longest(args, args[1:], fillvalue="-"):
            full += [word, DEFAULT_ROUTER] if word == "--ros" and following.startswith("-") else [word]
        return super().parse_args(ctx, full)


COMMAND_CLASS = ServeCommand


@with_options(ServeOptions, rare=("failed_leg",))
def serve(
    asked: dict[str, Any],
    context: typer.Context,
    view: Annotated[
        bool, typer.Option("--view", help="Show the robot in the Rerun viewer while it is served.")
    ] = False,
) -> None:
    """Serve a robot, real or simulated, on the network, with its own guard and stop.

    It runs until Ctrl-C. hexctl run --backend zenoh walks it.
    """
    from hexctl.server.service import RobotService

    service = RobotService(**asked)
    settings = service.resolved_link()
    if view and settings.credentials is not None:
        from hexctl.wire.certificates import find_credentials

        find_credentials(settings.credentials, Role.VIEWER)  # the robot's own do not admit a viewer
    with StopOnInterrupt() as interrupt, ExitStack() as stack:

        def on_started(started: "ServiceStarted") -> None:
            print_note(_greeting(started, settings))
            if not is_said(context, "backend") and (note := _simulated_note(str(service.robot))):
                print_note(note)
            for warning in started.warnings:
                print_note(f"warning: {warning}")
            if view:
                stack.enter_context(_viewer(settings, service.link))

        service.run(interrupt.requested, on_started=on_started, on_event=print_note)


def _simulated_note(robot: str) -> str | None:
    driver = load_robot_file(robot).content.servos.driver
    return None if driver is None else f"simulated; its servos are served with --backend {driver}"


@contextmanager
def _viewer(settings: "Link", link: str | None) -> Iterator[None]:
    """The viewer is a separate client process: it cannot delay the robot."""
    here = settings.endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
    # -P: no file in the working folder replaces a module.
    command = [sys.executable, "-P", "-m", "hexctl", "view", "--connect", here]
    command += ["--keys", str(settings.credentials)] if settings.credentials is not None else []
    command += ["--link", link] if link is not None else []
    command += ["--insecure"] if settings.insecure else []
    viewer = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        viewer.terminate()
        try:
            viewer.wait(VIEWER_END_S)
        except subprocess.TimeoutExpired:
            viewer.kill()
            viewer.wait()


def _greeting(started: "ServiceStarted", settings: "Link") -> str:
    guarded = "certificates" if settings.credentials is not None else "no certificates"
    if settings.insecure:
        guarded = "INSECURE: no certificates beyond this computer"
    timing = "" if started.realtime else ", no real-time priority (needs rtprio): a busy machine delays it"
    return (
        f"serving {started.robot} ({started.backend}) at {started.place}, {guarded}{timing}; Ctrl-C ends it"
    )
