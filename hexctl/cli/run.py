"""`hexctl run`: walk."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli.options import (
    HEADING_DEG,
    AmplitudeOption,
    BackendOption,
    ConnectOption,
    DurationOption,
    FailedLegOption,
    FailureOption,
    GaitOption,
    HeightOption,
    InsecureOption,
    JsonOption,
    KeysOption,
    LinkOption,
    PaceOption,
    RobotOption,
    SeedOption,
    SelfRotationOption,
    TurnOption,
    WorldOption,
    failure_of,
    number,
)


def run(
    backend: BackendOption = "sim",
    robot: RobotOption = "ant",
    world: WorldOption = None,
    gait: GaitOption = "demo",
    heading: Annotated[
        float | None,
        number(
            "--heading",
            HEADING_DEG,
            "Direction of travel in degrees, {}, counter-clockwise from where the body points "
            "at the start: 90 goes to the left. (default: 0)",
        ),
    ] = None,
    turn: TurnOption = None,
    duration: DurationOption = 30.0,
    pace: PaceOption = None,
    amplitude: AmplitudeOption = None,
    height: HeightOption = None,
    failed_leg: FailedLegOption = None,
    failure: FailureOption = None,
    self_rotation: SelfRotationOption = "rear",
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
            help="Show the walk in the Rerun viewer: during the walk with --realtime or on a robot, "
            "otherwise afterwards.",
        ),
    ] = False,
    seed: SeedOption = 0,
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

    from hexctl.cli.walking import Request, execute
    from hexctl.control.plan import TrialPlan
    from hexctl.gait.gait import make_gait
    from hexctl.robot.loader import load_robot_file

    file = load_robot_file(robot)
    described = file.robot
    failed = failure_of(failed_leg, failure)
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
        heading_rad=radians(heading or 0.0),
        travel=0.0 if in_place else 1.0,
        turn_rate_rad_s=radians(turn or 0.0),
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
        robot_file=file,
        meshes={} if no_record else file.meshes,
        connect=connect,
        credentials=keys,
        insecure=insecure,
        link=link,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
