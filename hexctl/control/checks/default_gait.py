"""A stance and a default gait that an imported robot can walk, by the checks of `hexctl check`."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from hexctl.control.checks.feasibility import HEADINGS_RAD, RobotCheck, gait_demand
from hexctl.control.checks.gait_load import Verdict, gait_load
from hexctl.errors import InputError
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import DEFAULT_GAIT, Motion, make_gait
from hexctl.ik.legs import legs_that_reach
from hexctl.robot.formats.importing.robot_import import USUAL_STRIDE, ImportedRobot
from hexctl.robot.servos.servo_map import default_servo_map

#: Tried shares of the usual stride, and the stances, the best first.
SHARES, STANCES = (1.0, 0.85, 0.7, 0.55, 0.45, 0.35, 0.25, 0.18, 0.12), 80

#: A foot of a soft robot keeps this share of a step, if a higher one is in reach: multiples of the usual one.
TARGET_LIFT, STEPS = 0.7, (1.5, 2.0)

#: Points of a cycle and headings of the first look at a gait.
POINTS, LOOK_RAD = 40, HEADINGS_RAD[::3]

#: Number of stances per stride with a calculated load, and the used share of the possible pace.
LOADS, PACE_SHARE = 2, 0.9

#: The slowest default gait.
LEAST_PACE_HZ = 0.05

#: Reason if the legs reach no gait.
OUT_OF_REACH = (
    f"no stride of {SHARES[-1] * USUAL_STRIDE:.0%} of the distance from hip to foot stays within the "
    "ranges of its joints"
)


def walkable(imported: ImportedRobot) -> ImportedRobot:
    """The imported robot with a stance and a gait that it can walk all round, or a note why there is none.

    The stride is reduced, and other stances are tried, until `hexctl check` agrees.
    """
    first, reason, doubtful = None, OUT_OF_REACH, None
    for made in _in_reach(imported):
        slower, verdict = _judged(made)
        if not verdict.obstacles and not verdict.doubtful:
            return slower
        if not verdict.obstacles:
            doubts = f"hexctl check doubts the default gait: {'; '.join(verdict.warnings)}"
            doubtful = doubtful or replace(slower, remarks=(*slower.remarks, doubts))
        elif first is None:
            first, reason = slower, "; ".join(verdict.obstacles)
    if doubtful is not None:
        return doubtful
    note, made = f"no default gait was found that it can walk: {reason}", first or imported
    return replace(made, remarks=(*made.remarks, note))


def _in_reach(imported: ImportedRobot) -> Iterator[ImportedRobot]:
    """Variants whose feet stay in reach and range, the longest strides first, then the best stances."""
    own, *others = imported.stances
    stances = [own, *(stance for stance in others[:STANCES] if math.dist(stance, own) > 1e-6)]
    gait, size_m = imported.content["gait"], imported.content["size_m"]
    for share in SHARES:
        stride_m = share * gait["amplitude"] * size_m
        step_m = (share if share < 0.5 else 1.0) * gait["height"] * size_m
        variants = (imported.with_gait(stance, gait["pace_hz"], stride_m, step_m) for stance in stances)
        yield from islice(filter(_reaches, variants), LOADS)


def _reaches(imported: ImportedRobot) -> bool:
    try:
        robot = imported.robot()
    except InputError:
        return False
    gait = make_gait(robot, DEFAULT_GAIT)
    time_s = RAMP_DURATION_S + np.arange(POINTS) / (POINTS * gait.pace_hz)
    feet = np.array([gait_feet_body(robot, gait, Motion(heading_rad=one), time_s) for one in LOOK_RAD])
    return bool(legs_that_reach(robot, feet).all())


def _judged(imported: ImportedRobot) -> tuple[ImportedRobot, Verdict]:
    """The robot at a pace that its joints keep, and the verdict of `hexctl check` on it."""
    check = _check(imported)
    if not check.demand.possible:
        return imported, Verdict((OUT_OF_REACH,))
    max_pace_hz = check.demand.max_pace_hz
    if not check.demand.speed_reached and max_pace_hz is not None:
        pace_hz = math.floor(100 * PACE_SHARE * max_pace_hz) / 100
        if pace_hz < LEAST_PACE_HZ:
            return imported, Verdict((f"its joints keep a pace of {max_pace_hz:.2g} Hz at most",))
        imported = imported.with_gait_values(pace_hz=pace_hz)
        check = _check(imported)
    imported, check = _lifted(imported, check)
    return imported, check.verdict


def _lifted(imported: ImportedRobot, check: RobotCheck) -> tuple[ImportedRobot, RobotCheck]:
    """The robot with a higher step, if it sags by much of it, and its check; a gait of the file stays."""
    height, made = imported.content["gait"]["height"], imported
    for times in () if imported.own_gait else STEPS:
        if check.load.lift_left >= TARGET_LIFT:
            break
        higher = imported.with_gait_values(height=times * height)
        if not _reaches(higher) or not _as_good(higher_check := _check(higher), check):
            break
        made, check = higher, higher_check
    return made, check


def _as_good(check: RobotCheck, other: RobotCheck) -> bool:
    """Whether a check is possible, at its pace, with no more obstacles and doubts than another one."""
    verdict, least = check.verdict, other.verdict
    worse = len(verdict.obstacles) > len(least.obstacles) or verdict.doubtful > least.doubtful
    return check.demand.possible and check.demand.speed_reached and not worse


def _check(imported: ImportedRobot) -> RobotCheck:
    robot = imported.robot()
    gait, motions = make_gait(robot, DEFAULT_GAIT), [Motion(heading_rad=heading) for heading in HEADINGS_RAD]
    return RobotCheck(
        robot=robot,
        gait=gait,
        demand=gait_demand(robot, gait, motions),
        load=gait_load(robot, gait, motions),
        servo_map=default_servo_map(),
    )
