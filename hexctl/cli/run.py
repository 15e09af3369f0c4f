"""`hexctl run`: walk."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completing
from hexctl.cli.options import (
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
            autocompletion=completing.backends,
            help="sim, zenoh (a robot that hexctl serve puts on the network), mavlink, mock, "
            "or package.module:Class for your own LegServos.",
        ),
    ] = "sim",
    robot: RobotOption = "ant",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            autocompletion=completing.worlds,
            help="World of the simulation: flat, slippery, slope, rough, or a YAML file. (default: flat)",
        ),
    ] = None,
    gait: GaitOption = "demo",
    heading: Annotated[
        float | None,
        typer.Option(
            "--heading",
            help="Direction of travel in degrees from where the body points at the start, "
            "counter-clockwise. (default: 0)",
        ),
    ] = None,
    turn: TurnOption = None,
    duration: Annotated[float, typer.Option("--duration", help="Seconds to walk, up to 86400.")] = 30.0,
    pace: PaceOption = None,
    amplitude: AmplitudeOption = None,
    height: HeightOption = None,
    failed_leg: Annotated[
        int | None,
        typer.Option("--failed-leg", autocompletion=completing.legs, help="Leg that failed, 1..6."),
    ] = None,
    failure: Annotated[
        str | None,
        typer.Option(
            "--failure",
            autocompletion=completing.failures,
            help="locked, limp, missing, weak[:FRACTION of torque 0..1, 0.3], "
            "stuck[:JOINT[:DEGREES]] (coxa at 0). (default: locked)",
        ),
    ] = None,
    self_rotation: Annotated[
        str,
        typer.Option(
            "--self-rotation",
            autocompletion=completing.self_rotations,
            help="Turn until the failed leg is at the rear, front, or none.",
        ),
    ] = "rear",
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Pace the simulation with the wall clock.")
    ] = False,
    record: Annotated[
        Path | None,
        typer.Option("--record", help="Recording to write (.rrd). (default: a new one in runs/)"),
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Leave no recording.")] = False,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show the walk in Rerun: while it goes on where the clock paces it, afterwards else.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help="Seed of everything random, 0 or more.")] = 0,
    connect: ConnectOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Walk, record it for Rerun, and say how it went. Ctrl-C stops softly."""
    from math import radians

    from hexctl.cli.values import finite, make_failure, turn_rate_deg_s
    from hexctl.cli.walking import Request, execute
    from hexctl.control.plan import TrialPlan
    from hexctl.gait.named import make_gait
    from hexctl.robot.file import load_robot

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
        connect=connect,
        credentials=keys,
        insecure=insecure,
        link=link,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
