"""The arena of a robot that is not reset between walks: geometry, return to home, geofence."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hexctl.control.pose_watch import joined
from hexctl.control.trace import Trace
from hexctl.control.trial import LOOK_TICKS, EndCheck, ShouldStop
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import body_heading_rad
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import FloatArray, RobotState

IntArray = NDArray[np.int_]

#: Nearer to home than this, the direction to home is undefined.
AT_HOME_M = 0.05

#: Margin of a walk to a better start, which may end this much short of its goal.
SPARE_M = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Arena:
    """Circle on the floor for the middle of the body. Positions are in the world, x and y first.

    Attributes:
        home_m: centre, the robot's position when its session began.
    """

    home_m: tuple[float, float]
    radius_m: float

    def distance_m(self, position: FloatArray) -> float:
        """Horizontal distance of a position from home."""
        return math.hypot(*self._from_home(position))

    def aim_rad(self, position: FloatArray, otherwise_rad: float) -> float:
        """World heading of the longest straight walk, through home; at home it is `otherwise_rad`."""
        x, y = self._from_home(position)
        return math.atan2(-y, -x) if math.hypot(x, y) > AT_HOME_M else otherwise_rad

    def leaves(self, position: FloatArray, ahead: FloatArray) -> bool:
        """Whether a robot leaves the arena towards a position ahead; not if it returns from outside."""
        away_m = self.distance_m(ahead)
        return away_m > self.radius_m and away_m > self.distance_m(position)

    def start(self, reach_m: float) -> "Arena":
        """Circle of the best starts of a straight walk: half its length from home."""
        radius_m = min(reach_m / 2 + SPARE_M, self.radius_m)
        return Arena(home_m=self.home_m, radius_m=radius_m)

    def too_near(self, position: FloatArray, reach_m: float) -> bool:
        """Whether a walk needs another start, farther from home, to have room."""
        short_m = self.start(reach_m).radius_m - self.distance_m(position)
        return self.radius_m + self.distance_m(position) < reach_m and short_m > SPARE_M

    def _from_home(self, position: FloatArray) -> tuple[float, float]:
        return float(position[0]) - self.home_m[0], float(position[1]) - self.home_m[1]


def check_radius(radius_m: float, *, ideal_m: float, least_m: float) -> str | None:
    """Note on an arena for the operator before the first trial, or None.

    Args:
        ideal_m: distance of a walk without slip.
        least_m: minimum distance of a valid walk.

    Raises InputError for an arena without room for a valid straight walk.
    """
    advice = f"allowed: {ideal_m / 2:.2f} m or more, or a shorter {argument('duration_s')}"
    if 2 * radius_m < least_m:
        raise InputError(
            f"{argument('arena_m')}: got {radius_m:g} m, where no straight walk is long enough "
            f"({least_m:.2f} m); {advice}"
        )
    if 2 * radius_m < ideal_m:
        return (
            f"the arena is {2 * radius_m:g} m across, and a straight walk is up to {ideal_m:.2f} m: gaits "
            "that go far will be cut short at its edge and count for nothing; "
            f"better: --arena {math.ceil(50 * ideal_m) / 100:g} or more, or a shorter --duration"
        )
    if radius_m < ideal_m:
        return (
            f"a straight walk is up to {ideal_m:.2f} m and begins {ideal_m / 2:.2f} m from the middle of the "
            "arena; the robot walks there first where it must"
        )
    return None


def aimed(
    plan: TrialPlan, robot: Robot, state: RobotState, arena: Arena, *, outward: bool = False
) -> TrialPlan:
    """Plan whose walk returns home through the middle of the arena, or leads away from it.

    At the middle it walks without a turn. Raises RobotFaultError without a pose.
    """
    if state.base_position_world is None or state.base_quaternion_world is None:
        raise RobotFaultError("the robot no longer knows where it is")
    yaw = float(yaw_rad(state.base_quaternion_world))
    body_rad = body_heading_rad(robot, plan)
    as_it_stands_rad = yaw + body_rad
    away_rad = math.pi if outward else 0.0
    aim_rad = arena.aim_rad(state.base_position_world, as_it_stands_rad - away_rad) + away_rad
    turn_rad = wrapped_rad(aim_rad - as_it_stands_rad)
    return replace(plan, heading_rad=turn_rad + body_rad, turn_rad=turn_rad)


def facing_ahead(plan: TrialPlan, robot: Robot) -> TrialPlan:
    """Plan for a robot that an operator has placed in its direction after the self-rotation."""
    return replace(plan, heading_rad=body_heading_rad(robot, plan), turn_rad=0.0)


#: Why a walk was cut short: at the edge of its arena, or without a known position.
LEFT_THE_ARENA, NO_POSITION = "arena", "no position"

#: Checks ahead of the predicted position: a soft stop covers the distance of one interval between checks,
#: and the stop may be requested one check later.
LOOKS_AHEAD = 2.0

#: Without a new position for longer it is lost, in ticks.
LOST_TICKS = LOOK_TICKS


class Geofence(EndCheck):
    """Ends a walk that would stop outside, or loses its position; a `should_stop` of `run_trial`.

    A position that repeats itself is no new one: sensors have noise, and the robot walks.
    """

    def __init__(self, arena: Arena | float, also: ShouldStop | None = None) -> None:
        """Watch one walk in an arena, or a radius in m around its start; `also` may end it too."""
        self._arena: Arena | None = arena if isinstance(arena, Arena) else None
        self._radius_m = arena.radius_m if isinstance(arena, Arena) else arena
        self._also = also

    def __call__(self, trace: Trace) -> bool | str:
        """Reason to end the walk, or the answer of `also`."""
        rows, arena = trace.positions_world, self._placed(trace)
        measured = _new_positions(trace)
        if arena is None or not len(measured) or len(rows) - 1 - measured[-1] > LOST_TICKS:
            return NO_POSITION
        last = measured[-1]
        first = measured[np.searchsorted(measured, max(measured[0], last - LOOK_TICKS), side="right") - 1]
        moved = (rows[last] - rows[first]) * (LOOK_TICKS / max(1, last - first))
        looks_m = moved * (LOOKS_AHEAD + (len(rows) - 1 - last) / LOOK_TICKS)
        if arena.leaves(rows[last], rows[last] + looks_m):
            return LEFT_THE_ARENA
        return self._also is not None and self._also(trace)

    def at_end(self, trace: Trace) -> str | None:
        """Why a walk that has come to its end was not within the fence for certain, or None."""
        measured = _new_positions(trace)
        lost = not len(measured) or len(trace) - 1 - measured[-1] > LOST_TICKS
        return NO_POSITION if lost or self._placed(trace) is None else None

    def _placed(self, trace: Trace) -> Arena | None:
        """The arena; one around the start is placed once the start is known."""
        if self._arena is None:
            start = None if trace.frame is None else trace.frame.origin_world
            if start is not None and np.isfinite(start).all():
                self._arena = Arena(home_m=(float(start[0]), float(start[1])), radius_m=self._radius_m)
        return self._arena


def _new_positions(trace: Trace) -> IntArray:
    """Ticks in which a position is known, and it or the orientation differs from the one before."""
    shown = joined(trace.positions_world, trace.quaternions_world)
    known = np.flatnonzero(np.isfinite(shown[:, :3]).all(axis=-1))
    shown = shown[known]
    changed = np.concatenate([[True], (shown[1:] != shown[:-1]).any(axis=-1)])[: len(known)]
    return np.asarray(known[changed])
