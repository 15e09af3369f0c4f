"""`hexctl run`: walk."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import (
    FAILED_LEG_HELP,
    FAILURE_HELP,
    SEED_HELP,
    SELF_ROTATION_HELP,
    WORLD_HELP,
    AmplitudeOption,
    ConnectOption,
    GaitOption,
    HeightOption,
    InsecureOption,
    JsonOption,
    KeysOption,
    LinkOption,
    PaceOption,
    RobotOption,
    TurnOption,
)


def run(
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            autocompletion=completion.backends,
            help="What moves: sim (simulation), zenoh (a robot that hexctl serve puts on the network), "
            "mavlink (a servo board), mock (servos without a robot), or package.module:Class for servos of "
            "your own.",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            autocompletion=completion.worlds,
            help=f"{WORLD_HELP} Only with sim. (default: flat)",
        ),
    ] = None,
    gait: GaitOption = "demo",
    heading: Annotated[
        float | None,
        typer.Option(
            "--heading",
            help="Direction of travel in degrees, any number, counter-clockwise from where the body points "
            "at the start: 90 goes to the left. (default: 0)",
        ),
    ] = None,
    turn: TurnOption = None,
    duration: Annotated[
        float, typer.Option("--duration", help="Seconds to walk, above 0 up to 86400.")
    ] = 30.0,
    pace: PaceOption = None,
    amplitude: AmplitudeOption = None,
    height: HeightOption = None,
    failed_leg: Annotated[
        int | None,
        typer.Option(
            "--failed-leg", autocompletion=completion.legs, help=f"{FAILED_LEG_HELP} (default: none)"
        ),
    ] = None,
    failure: Annotated[
        str | None,
        typer.Option(
            "--failure", autocompletion=completion.failures, help=f"{FAILURE_HELP} (default: locked)"
        ),
    ] = None,
    self_rotation: Annotated[
        str,
        typer.Option("--self-rotation", autocompletion=completion.self_rotations, help=SELF_ROTATION_HELP),
    ] = "rear",
    realtime: Annotated[
        bool,
        typer.Option("--realtime", help="Simulate at the speed of a real robot, not as fast as possible."),
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="Recording to write, a new .rrd file. (default: one in runs/)"),
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Leave no recording.")] = False,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show the walk in the Rerun viewer: while it goes on with --realtime or on a robot, "
            "afterwards else.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help=SEED_HELP)] = 0,
    connect: ConnectOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Walk, record it, and say how it went.

    Ctrl-C stops softly and keeps the recording. Exit codes: 0 done, 2 bad input, 3 fault of robot or link,
    4 fell or was stopped, 130 interrupted.
    """
    from math import radians

    from hexctl.cli.values import finite, make_failure, turn_rate_deg_s
    from hexctl.cli.walking import Request, execute
    from hexctl.control.plan import TrialPlan
    from hexctl.gait.gait import make_gait
    from hexctl.robot.loader import load_robot
    from hexctl.robot.meshes import load_meshes

    described = load_robot(robot)
    failed = make_failure(failed_leg, failure)
    in_place = turn is not None and heading is None
    plan = TrialPlan(
        gait=make_gait(
            described,
            gait,
            pace_hz=pace,
            amplitude=amplitude,
            height=height,
            failed_legs=(failed.leg,) if failed else (),
        ),
        heading_rad=radians(finite("--heading", heading)),
        travel=0.0 if in_place else 1.0,
        turn_rate_rad_s=radians(turn_rate_deg_s(turn)),
        duration_s=duration,
        failure=failed,
        self_rotation=self_rotation,
    )
    request = Request(
        backend=backend,
        robot=described,
        world=world,
        plan=plan,
        gait_text=gait,
        realtime=realtime,
        record=record,
        no_record=no_record,
        view=view,
        seed=seed,
        robot_file=robot,
        meshes={} if no_record else load_meshes(robot),
        connect=connect,
        credentials=keys,
        insecure=insecure,
        link=link,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
