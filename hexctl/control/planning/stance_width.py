"""The stance width for five legs: the drive that the servos need there, over stance widths.

Without a leg its neighbours carry up to twice the load, and the lever of a joint grows with the width. With
a drive above 1 (`JointPath`) a joint does not follow, and the body sinks. The proposed width is the one of
the robot if the drive stays below 1 on any five legs, else the widest one at which it does.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from hexctl.control.planning.crawl import gait_without
from hexctl.control.planning.static_stability import STAND_UP
from hexctl.control.planning.top_speed import JointPath
from hexctl.errors import InputError
from hexctl.gait.gait import Gait, Motion
from hexctl.robot.model import Robot, in_stance_of
from hexctl.types import N_LEGS

#: Directions of travel: bodies are symmetric.
HEADINGS_RAD = (0.0, math.pi / 2)

#: Shares of the amplitude. A stroke that leaves the reach only in full is no fault of the stance.
AMPLITUDES = (1.0, 0.9)

#: Widths of the search, as shares of the robot's.
SHARES = tuple(0.98 - 0.02 * step for step in range(25))


def stance_width(robot: Robot, gait: Gait) -> dict[str, float | None]:
    """Stance of a robot in the gaits that its recovery glides to on five legs, and the proposed stance.

    JSON values: distances of the nominal feet from the coxa axes in m, and for each the largest share of a
    servo's drive, at 1 all that it has. The share is None if a foot is out of reach, its joints are out of
    their ranges, or the robot tips over. The gait gives pace, strokes and posture.
    """
    walks = _five_leg_walks(robot, gait)
    own_m, drive = robot.stance_outward_m, _drive(robot, walks)
    proposed_m, least = (own_m, drive) if drive <= 1 else _widest(robot, walks, drive)
    return {
        "stance_outward_m": round(own_m, 4),
        "five_leg_drive": _rounded(drive),
        "proposed_outward_m": round(proposed_m, 4),
        "proposed_five_leg_drive": _rounded(least),
    }


def _rounded(drive: float) -> float | None:
    return round(drive, 3) if math.isfinite(drive) else None


Walks = Sequence[tuple[Gait, Motion]]


def _five_leg_walks(robot: Robot, gait: Gait) -> Walks:
    posture = replace(gait.posture, body_raise=gait.posture.body_raise or STAND_UP)
    raised = replace(gait, posture=posture)
    return [
        (gait_without(robot, raised, heading_rad=heading_rad, legs=(leg,)), Motion(heading_rad=heading_rad))
        for heading_rad in HEADINGS_RAD
        for leg in range(1, N_LEGS + 1)
    ]


def _widest(robot: Robot, walks: Walks, drive: float) -> tuple[float, float]:
    """The widest stance in m whose drive is at most 1, and its drive; else the one with the least drive."""
    best_m = own_m = robot.stance_outward_m
    for share in SHARES:
        width_m = round(share * own_m, 3)
        if (now := _drive_at(robot, walks, width_m)) < drive:
            best_m, drive = width_m, now
        if now <= 1:
            break
    return best_m, drive


def _drive_at(robot: Robot, walks: Walks, width_m: float) -> float:
    try:
        return _drive(in_stance_of(robot, width_m), walks)
    except InputError:  # out of reach
        return math.inf


def _drive(robot: Robot, walks: Walks) -> float:
    """Largest share of a servo's drive over the cycles of some walks; inf if they cannot carry the robot."""
    most = 0.0
    for gait, motion in walks:
        shorter = (replace(gait, amplitude=share * gait.amplitude) for share in AMPLITUDES)
        paths = (JointPath.of(robot, one, motion) for one in shorter)
        if (path := next((path for path in paths if path is not None), None)) is None:
            return math.inf
        most = max(most, path.drive(gait.pace_hz))
    return most
