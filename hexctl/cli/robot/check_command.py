"""`hexctl check`: validate a robot file, with numbers."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.backends.sim.world import load_world
from hexctl.cli import completion
from hexctl.cli.console import BAD_INPUT, print_message, print_result
from hexctl.cli.settings import is_said, runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.control.checks.check_options import CheckOptions
from hexctl.control.planning.leg_sets import DIRECTIONS_RAD, leg_sets
from hexctl.errors import InputError

if TYPE_CHECKING:
    from hexctl.control.checks.feasibility import RobotCheck


@with_options(CheckOptions, rare=("leg_sets", "turn_rate_rad_s"))
def check(
    asked: dict[str, Any],
    context: typer.Context,
    robot_name: Annotated[
        str | None,
        typer.Argument(
            autocompletion=completion.robots,
            metavar="ROBOT",
            help="Robot: a name that hexctl robot list prints, or a YAML file. (default: ant)",
        ),
    ] = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Print every finding, and the demands on each joint.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Check whether a robot can walk a gait: reach, angles, speeds, torques and servo pulses."""
    if robot_name is not None:
        if is_said(context, "robot") and asked["robot"] != robot_name:
            raise InputError(f"check: got robots {robot_name} and {asked['robot']}; allowed: one")
        asked["robot"] = robot_name
    options = CheckOptions(**asked)
    checked = _checked(options)
    report = checked.to_dict() | _further(checked, options)
    if as_json:
        print_result(report)
    else:
        from hexctl.cli.render.check_output import report_parts

        print_result(*report_parts(report, verbose=verbose))
    if not checked.possible:
        raise typer.Exit(BAD_INPUT)


def _checked(options: CheckOptions) -> "RobotCheck":
    from hexctl.control.checks.feasibility import check_robot

    return check_robot(
        options.robot,
        options.gait,
        heading_rad=options.heading_rad,
        turn_rate_rad_s=options.turn_rate_rad_s,
        pace_hz=options.pace_hz,
        amplitude=options.amplitude,
        height=options.height,
    )


def _further(checked: "RobotCheck", options: CheckOptions) -> dict[str, Any]:
    report: dict[str, Any] = {}
    if options.physics and checked.possible:
        report["physics"] = _measured(checked, options.world or "flat", options.duration_s or 30.0)
    if options.envelope:
        from hexctl.control.planning.speed_envelope import speed_envelope

        report["envelope"] = speed_envelope(checked.robot, checked.gait)
    if options.leg_sets:
        report["leg_sets"] = _leg_sets(checked, options.heading_rad)
    return report


def _measured(checked: "RobotCheck", world_name: str, duration_s: float) -> dict[str, Any]:
    """Measure and store the uncertainty of a robot's walks in a world; an unwritable folder is a note."""
    from hexctl.control.scoring.uncertainty import CODES, LEGS, simulation_uncertainty
    from hexctl.control.scoring.uncertainty_store import keep_uncertainty, known_uncertainty

    robot, world = checked.robot, load_world(world_name)
    # A damaged file is refused before the measurement.
    before = known_uncertainty(robot, world, duration_s=duration_s, folder=runs_folder())
    found = simulation_uncertainty(robot, world, duration_s=duration_s)
    if before is not None and not before.borrowed and before.walks > found.walks:
        print_message(
            f"not kept: ± {100 * before.numerical_m:.1f} cm of {before.walks} walks is known already"
        )
        return found.to_dict()
    codes, legs = ", ".join(map(str, CODES)), " and ".join(map(str, LEGS))
    how = f"hexctl check --physics: codes {codes} with leg {legs} locked, in {world_name}"
    try:
        keep_uncertainty(robot, world, found, folder=runs_folder(), how=how)
    except InputError as error:
        print_message(f"not kept: {error}")
    return found.to_dict()


def _leg_sets(checked: "RobotCheck", heading_rad: float | None) -> list[dict[str, Any]]:
    directions_rad = DIRECTIONS_RAD if heading_rad is None else (heading_rad,)
    return [one.to_dict() for one in leg_sets(checked.robot, checked.gait, directions_rad)]
