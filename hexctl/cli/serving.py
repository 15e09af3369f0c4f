"""What `hexctl serve` does with its options: check, open, serve until told to stop."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import make_servos
from hexctl.cli.console import DONE, StopOnInterrupt, print_note
from hexctl.cli.twin import Twin
from hexctl.errors import InputError
from hexctl.serve.server import RobotServer
from hexctl.wire.certificates import find_credentials
from hexctl.wire.links import Link, Role, load_link

MIN_SIT_AFTER_S, MAX_SIT_AFTER_S = 1.0, 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """The options of `hexctl serve` as values."""

    twin: Twin
    listen: str | None
    device: str | None
    device_keys: Path | None
    sit_after_s: float
    view: bool
    credentials: Path | None
    insecure: bool
    link: str | None


def execute(service: Service) -> int:
    """Serve as requested until interrupted, and return the exit code."""
    _check(service)
    link = load_link(
        service.link, endpoint=service.listen, credentials=service.credentials, insecure=service.insecure
    )
    if service.view and link.credentials is not None:
        find_credentials(link.credentials, Role.VIEWER)  # the robot's own do not let a viewer in
    servos = _servos(service)
    server = RobotServer(
        servos,
        link,
        backend=service.twin.backend,
        simulated=service.twin.words(),
        sit_after_s=service.sit_after_s,
        on_event=print_note,
    )
    with StopOnInterrupt() as interrupt, ExitStack() as stack:
        realtime = request_realtime_priority()

        def ready() -> None:
            print_note(_greeting(service, servos, link, realtime))
            if service.view:
                stack.enter_context(_viewer(service, link))

        server.run(interrupt.requested, ready=ready)
    return DONE


@contextmanager
def _viewer(service: Service, link: Link) -> Iterator[None]:
    """Show the robot by a process that is a viewer like any other: it cannot hold the robot up."""
    here = link.endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
    command = [sys.executable, "-m", "hexctl", "view", "--connect", here]
    command += ["--keys", str(link.credentials)] if link.credentials is not None else []
    command += ["--link", service.link] if service.link is not None else []
    command += ["--insecure"] if link.insecure else []
    viewer = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        viewer.terminate()
        viewer.wait()


def _check(service: Service) -> None:
    """Refuse what cannot be served, before anything is opened."""
    if service.twin.backend == "zenoh":
        raise InputError(
            "--backend: got zenoh, which is a robot that is served already; allowed: sim, mavlink, mock"
        )
    service.twin.check()
    if service.twin.backend != "mavlink" and (service.device is not None or service.device_keys is not None):
        option, value = (
            ("--device", service.device) if service.device else ("--device-keys", service.device_keys)
        )
        raise InputError(
            f"{option}: got {value} with --backend {service.twin.backend}; allowed: with mavlink"
        )
    if not MIN_SIT_AFTER_S <= service.sit_after_s <= MAX_SIT_AFTER_S:  # false for nan too
        raise InputError(
            f"--sit-after: got {service.sit_after_s:g}; allowed: {MIN_SIT_AFTER_S:g} to {MAX_SIT_AFTER_S:g} s"
        )


def _servos(service: Service) -> LegServos:
    options = replace(
        service.twin.options(),
        connect=service.device,
        credentials=service.device_keys,
        insecure=service.insecure,
    )
    return make_servos(service.twin.backend, options)


def _greeting(service: Service, servos: LegServos, link: Link, realtime: bool) -> str:
    """Return the line that says that clients may come."""
    guarded = "certificates" if link.credentials is not None else "no certificates"
    if link.insecure:
        guarded = "INSECURE: no certificates beyond this computer"
    timing = "" if realtime else ", no real-time priority (needs rtprio): a busy machine delays it"
    name = f"{servos.robot.name} ({service.twin.backend})"
    return f"serving {name} at {link.endpoint}, {guarded}{timing}; Ctrl-C ends it"
