"""`hexctl serve`: put a robot on the network."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import zip_longest
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.options.connection import (
    DeviceKeysOption,
    DeviceOption,
    InsecureOption,
    KeysOption,
    LinkOption,
    ListenOption,
)
from hexctl.cli.options.failure import SimFailedLegOption, SimFailureOption
from hexctl.cli.options.robot import RobotOption, SeedOption, WorldOption
from hexctl.cli.settings import SettingsCommand
from hexctl.cli.values import number
from hexctl.errors import InputError
from hexctl.options import Range

if TYPE_CHECKING:
    from hexctl.serve.ros.ros_options import RosOptions
    from hexctl.serve.service import ServiceStarted
    from hexctl.wire.links import Link

SIT_AFTER_S = Range(low=1, high=3600, unit="s")
ROS_DOMAIN = Range(low=0, high=232, whole=True)

#: How long the viewer may take to end: one that hangs must not keep the command from ending.
VIEWER_END_S = 5.0

#: What --ros stands for without an address.
ROS_ROUTER = "tcp/localhost:7447"


class ServeCommand(SettingsCommand):
    """The command whose option --ros may be given without a value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments, with the router's default address behind a bare --ros."""
        full: list[str] = []
        for word, following in zip_longest(args, args[1:], fillvalue="-"):
            full += [word, ROS_ROUTER] if word == "--ros" and following.startswith("-") else [word]
        return super().parse_args(ctx, full)


def serve(
    context: typer.Context,
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
    listen: ListenOption = None,
    device: DeviceOption = None,
    signing: DeviceKeysOption = None,
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
    ros: Annotated[
        str | None,
        typer.Option(
            "--ros",
            metavar="[ROUTER]",
            help="Be a node of ROS 2 over Zenoh (rmw_zenoh), by the ROS router at tcp/HOST:PORT; alone, at "
            "tcp/localhost:7447. (default: no ROS)",
        ),
    ] = None,
    ros_domain: Annotated[
        int,
        number(
            "--ros-domain", ROS_DOMAIN, "With --ros, the ROS domain, a whole number, {}: ROS_DOMAIN_ID there."
        ),
    ] = 0,
    ros_namespace: Annotated[
        str,
        typer.Option(
            "--ros-namespace",
            help="With --ros, namespace of node and topics, such as lab/ant. (default: none)",
        ),
    ] = "",
    ros_drive: Annotated[
        bool,
        typer.Option(
            "--ros-drive",
            help="With --ros, let ROS move the robot: cmd_vel, robot_joint_command, ~/stand, ~/sit and "
            "~/clear_stop. Whoever reaches the ROS router may then drive it.",
        ),
    ] = False,
    ros_humble: Annotated[
        bool,
        typer.Option("--ros-humble", help="With --ros, keys as ROS 2 Humble has them, without type hashes."),
    ] = False,
) -> None:
    """Put a robot, real or simulated, on the network, with a guard and a stop of its own.

    It runs until Ctrl-C. hexctl run --backend zenoh walks it.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note
    from hexctl.serve.service import RobotService, ServiceStarted, ServosSpec
    from hexctl.wire.links import Role

    service = RobotService(
        servos=ServosSpec(
            backend=backend,
            robot=robot,
            world=world,
            failed_leg=failed_leg,
            failure=failure or (),
            seed=seed,
        ),
        listen=listen,
        device=device,
        device_keys=signing,
        sit_after_s=sit_after,
        credentials=keys,
        insecure=insecure,
        link=link,
        ros=_ros_options(ros, domain=ros_domain, namespace=ros_namespace, humble=ros_humble, drive=ros_drive),
    )
    settings = service.resolved_link()
    if view and settings.credentials is not None:
        from hexctl.wire.certificates import find_credentials

        find_credentials(settings.credentials, Role.VIEWER)  # the robot's own do not admit a viewer
    with StopOnInterrupt() as interrupt, ExitStack() as stack:

        def on_started(started: ServiceStarted) -> None:
            print_note(_greeting(started, settings))
            typed = context.get_parameter_source("backend")
            if typed is not None and typed.name == "DEFAULT" and (note := _simulated_note(robot)):
                print_note(note)
            for warning in started.warnings:
                print_note(f"warning: {warning}")
            if view:
                stack.enter_context(_viewer(settings, link))

        service.run(interrupt.requested, on_started=on_started, on_event=print_note)


def _simulated_note(robot: str) -> str | None:
    """What is said where the servos that a robot file names are simulated."""
    from hexctl.robot.loader import load_robot_file

    driver = load_robot_file(robot).content.servos.driver
    return None if driver is None else f"simulated; its servos are served with --backend {driver}"


def _ros_options(router: str | None, **given: Any) -> "RosOptions | None":
    """Options of ROS, None without; raises InputError for some without a router."""
    if router is not None:
        from hexctl.serve.ros.ros_options import RosOptions

        return RosOptions(router=router, **given)
    for name, value in given.items():
        if value:
            told = "it" if value is True else value
            raise InputError(f"--ros-{name}: got {told} without --ros; allowed: with --ros")
    return None


@contextmanager
def _viewer(settings: "Link", link: str | None) -> Iterator[None]:
    """Show the robot with a process that is a viewer like any other: it cannot delay the robot."""
    here = settings.endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
    # -P: a file in the working folder stands for no module.
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
    """Line that says that clients can connect."""
    guarded = "certificates" if settings.credentials is not None else "no certificates"
    if settings.insecure:
        guarded = "INSECURE: no certificates beyond this computer"
    timing = "" if started.realtime else ", no real-time priority (needs rtprio): a busy machine delays it"
    return (
        f"serving {started.robot} ({started.backend}) at {started.place}, {guarded}{timing}; Ctrl-C ends it"
    )
