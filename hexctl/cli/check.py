"""`hexctl check`: validate a robot file, with numbers."""

import json
from typing import Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import BAD_INPUT, print_result
from hexctl.cli.options import (
    HEADING_DEG,
    ROBOT_HELP,
    AmplitudeOption,
    GaitOption,
    HeightOption,
    JsonOption,
    PaceOption,
    TurnOption,
    number,
)


def check(
    robot_name: Annotated[
        str | None,
        typer.Argument(
            autocompletion=completion.robots,
            metavar="[ROBOT]",
            help=f"{ROBOT_HELP} (default: ant)",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot", autocompletion=completion.robots, help="The robot, as an option. (default: ant)"
        ),
    ] = None,
    gait: GaitOption = "demo",
    heading: Annotated[
        float | None,
        number(
            "--heading",
            HEADING_DEG,
            "Direction of travel in degrees, {}, counter-clockwise from forward. "
            "(default: all round, every 15)",
        ),
    ] = None,
    turn: TurnOption = None,
    pace: PaceOption = None,
    amplitude: AmplitudeOption = None,
    height: HeightOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check a robot file: can the robot walk a gait, in reach, angles, speeds and servo pulses."""
    from hexctl.control.feasibility import gait_demand
    from hexctl.errors import InputError
    from hexctl.gait.gait import make_gait
    from hexctl.robot.loader import load_robot_file

    if robot_name is not None and robot is not None and robot_name != robot:
        raise InputError(f"check: got robots {robot_name} and {robot}; allowed: one")
    file = load_robot_file(robot_name or robot or "ant")
    described, servo_map, meshes = file.robot, file.servo_map, file.meshes
    walked = make_gait(described, gait, pace_hz=pace, amplitude=amplitude, height=height)
    headings = range(0, 360, 15) if heading is None else [heading]
    motions = _motions(headings, turn or 0.0, in_place=turn is not None and heading is None)
    demand = gait_demand(described, walked, motions)
    report = {
        **_report(described, walked, demand),
        **_pulses(described, servo_map, demand),
        "meshes": list(meshes),
    }
    print_result(json.dumps(report) if as_json else "\n".join(_lines(described, walked, report)))
    if not demand.possible:
        raise typer.Exit(BAD_INPUT)


def _motions(headings: Any, turn_deg_s: float, *, in_place: bool) -> list[Any]:
    import math

    from hexctl.gait.gait import Motion

    rate = math.radians(turn_deg_s)
    if in_place:
        return [Motion(travel=0.0, turn_rate_rad_s=rate)]
    return [Motion(heading_rad=math.radians(degrees), turn_rate_rad_s=rate) for degrees in headings]


def _report(robot: Any, gait: Any, demand: Any) -> dict[str, Any]:
    """Return the numbers of the check, angles in degrees."""
    import numpy as np

    from hexctl.gait.gait import Motion, ideal_speed_m_s
    from hexctl.types import JOINT_NAMES

    columns = np.degrees(
        [
            demand.lowest_rad,
            demand.highest_rad,
            robot.joint_lower_rad,
            robot.joint_upper_rad,
            demand.peak_speed_rad_s,
            robot.joint_max_speed_rad_s,
        ]
    )
    keys = ("lowest_deg", "highest_deg", "min_deg", "max_deg", "peak_speed_deg_s", "max_speed_deg_s")
    joints = {
        name: dict(zip(keys, (round(float(value), 2) for value in column), strict=True))
        for name, column in zip(JOINT_NAMES, columns.T, strict=True)
    }
    return {
        "robot": robot.name,
        "mass_kg": round(robot.mass_kg, 4),
        "standing_height_m": round(robot.standing_height_m, 4),
        "gait": {"slots": list(gait.slots), "code": gait.code(), "pace_hz": gait.pace_hz},
        "ideal_speed_m_s": round(ideal_speed_m_s(robot, gait, Motion()), 4),
        "max_pace_hz": None if demand.max_pace_hz is None else round(demand.max_pace_hz, 3),
        "speed_holds": demand.speed_holds,
        "unreachable_legs": list(demand.unreachable_legs),
        "joints_out_of_range": [JOINT_NAMES[joint] for joint in demand.limits_exceeded],
        "least_foot_spacing_m": round(demand.least_foot_spacing_m, 4),
        "feet_stay_apart": demand.least_foot_spacing_m > 2 * robot.foot_radius_m,
        "possible": demand.possible,
        "joints": joints,
    }


def _pulses(robot: Any, servo_map: Any, demand: Any) -> dict[str, Any]:
    """Return whether a servo board could drive it: each joint's range as pulses, and what does not fit."""
    from hexctl.robot.servo_map import joints_beyond_pulses
    from hexctl.types import JOINT_NAMES

    ends = [servo_map.pulses_us(limit) for limit in (robot.joint_lower_rad, robot.joint_upper_rad)]
    needed = [servo_map.outside(angles) for angles in (demand.lowest_rad, demand.highest_rad)]
    return {
        "pulses_us": {
            name: sorted(round(float(end[joint])) for end in ends) for joint, name in enumerate(JOINT_NAMES)
        },
        "joints_beyond_pulses": list(joints_beyond_pulses(servo_map, robot)),
        "gait_fits_pulses": not bool((needed[0] | needed[1]).any()),
    }


def _lines(robot: Any, gait: Any, report: dict[str, Any]) -> list[str]:
    """Return the report for a person."""
    slots = ",".join(str(slot) for slot in gait.slots)
    lines = [
        f"{robot.name}: {report['mass_kg']:g} kg, stands {report['standing_height_m']:g} m high",
        f"gait slots {slots} at {gait.pace_hz:g} Hz: ideal speed {report['ideal_speed_m_s']:g} m/s",
        *([f"meshes for {', '.join(report['meshes'])}, solids for the rest"] if report["meshes"] else []),
        "",
        f"{'joint':<12}{'needs (deg)':>20}{'range (deg)':>20}{'peak deg/s':>12}{'limit':>8}",
    ]
    for name, row in report["joints"].items():
        needs = f"{row['lowest_deg']:.1f} .. {row['highest_deg']:.1f}"
        allowed = f"{row['min_deg']:g} .. {row['max_deg']:g}"
        mark = "  out of range" if name in report["joints_out_of_range"] else ""
        mark += "  too fast" if row["peak_speed_deg_s"] > row["max_speed_deg_s"] else ""
        peak, limit = row["peak_speed_deg_s"], row["max_speed_deg_s"]
        lines.append(f"{name:<12}{needs:>20}{allowed:>20}{peak:>12.0f}{limit:>8.0f}{mark}")
    return [*lines, "", *_verdict(report)]


def _verdict(report: dict[str, Any]) -> list[str]:
    legs = ", ".join(str(leg) for leg in report["unreachable_legs"])
    outside = ", ".join(report["joints_out_of_range"])
    pace = report["max_pace_hz"]
    upto = "" if pace is None else f"; up to {pace:g} Hz it is kept"
    spacing = report["least_foot_spacing_m"]
    return [
        f"reach: out of reach for leg {legs}" if legs else "reach: every foot position is in reach",
        f"range: exceeded by {outside}" if outside else "range: kept",
        f"speed: kept{upto}" if report["speed_holds"] else f"speed: too fast, the guard will clip it{upto}",
        f"feet: {spacing:g} m apart or more" + ("" if report["feet_stay_apart"] else ": they touch"),
        _pulse_verdict(report),
        _conclusion(report),
    ]


def _pulse_verdict(report: dict[str, Any]) -> str:
    beyond = report["joints_beyond_pulses"]
    if not beyond:
        return "servos: every range fits into the pulse limits"
    gait = "this gait is not" if report["gait_fits_pulses"] else "this gait too"
    return f"servos: range beyond the pulse limits for {', '.join(beyond)}; a board clips it, {gait}"


def _conclusion(report: dict[str, Any]) -> str:
    if not report["possible"]:
        return "this robot cannot walk this gait"
    return "this robot can walk this gait" + ("" if report["speed_holds"] else ", clipped at its fastest")
