"""What `hexctl serve` does with its options: check, open, serve until told to stop."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hexctl.backends.base import LegServos
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.table import BackendOptions, make_servos
from hexctl.cli.exits import DONE
from hexctl.cli.interrupt import StopOnInterrupt
from hexctl.cli.output import say_aside
from hexctl.cli.values import make_failure
from hexctl.errors import InputError
from hexctl.robot.file import load_robot
from hexctl.serve.server import RobotServer
from hexctl.wire.link import Link
from hexctl.wire.linkfile import load_link

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World

MIN_SIT_AFTER_S, MAX_SIT_AFTER_S = 1.0, 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Service:
    """The options of `hexctl serve` as values."""

    backend: str
    robot: str
    listen: str | None
    device: str | None
    device_keys: Path | None
    world: str | None
    failed_leg: int | None
    failure: str | None
    seed: int
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
    servos = _servos(service)
    server = RobotServer(
        servos, link, backend=service.backend, sit_after_s=service.sit_after_s, say=say_aside
    )
    with StopOnInterrupt() as interrupt, ExitStack() as stack:
        realtime = request_realtime_priority()

        def ready() -> None:
            say_aside(_greeting(service, servos, link, realtime))
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
    viewer = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        viewer.terminate()
        viewer.wait()


def _check(service: Service) -> None:
    """Refuse what cannot be served, before anything is opened."""
    if service.backend == "zenoh":
        raise InputError(
            "--backend: got zenoh, which is a robot that is served already; allowed: sim, mavlink, mock"
        )
    if service.backend != "sim":
        for option in ("world", "failed_leg", "failure"):
            if (value := getattr(service, option)) is not None:
                raise InputError(
                    f"--{option.replace('_', '-')}: got {value} with --backend {service.backend}; "
                    "allowed: with sim"
                )
    if service.backend != "mavlink" and (service.device is not None or service.device_keys is not None):
        option, value = (
            ("--device", service.device) if service.device else ("--device-keys", service.device_keys)
        )
        raise InputError(f"{option}: got {value} with --backend {service.backend}; allowed: with mavlink")
    if service.seed < 0:
        raise InputError(f"--seed: got {service.seed}; allowed: 0 or more")
    if not MIN_SIT_AFTER_S <= service.sit_after_s <= MAX_SIT_AFTER_S:  # false for nan too
        raise InputError(
            f"--sit-after: got {service.sit_after_s:g}; allowed: {MIN_SIT_AFTER_S:g} to {MAX_SIT_AFTER_S:g} s"
        )


def _servos(service: Service) -> LegServos:
    failure = make_failure(service.failed_leg, service.failure)
    options = BackendOptions(
        robot=load_robot(service.robot),
        world=_world(service),
        failure=failure,
        seed=service.seed,
        realtime=True,
        robot_file=service.robot,
        connect=service.device,
        credentials=service.device_keys,
        insecure=service.insecure,
    )
    return make_servos(service.backend, options)


def _world(service: Service) -> "World | None":
    if service.backend != "sim":
        return None
    from hexctl.backends.sim.family import load_any_world

    return load_any_world(service.world or "flat")


def _greeting(service: Service, servos: LegServos, link: Link, realtime: bool) -> str:
    """Return the line that says that clients may come."""
    guarded = "certificates" if link.credentials is not None else "no certificates"
    if link.insecure:
        guarded = "INSECURE: no certificates beyond this computer"
    timing = "" if realtime else ", no real-time priority (needs rtprio): a busy machine delays it"
    name = f"{servos.robot.name} ({service.backend})"
    return f"serving {name} at {link.endpoint}, {guarded}{timing}; Ctrl-C ends it"
