"""Controllers: from step and state to joint targets, for one robot or a batch of them."""

from abc import ABC, abstractmethod

import numpy as np

from hexctl.errors import LimitError, ReachError
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, feet_of_walks, gait_feet_body, stroke_vectors_m
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import solve_legs, solve_legs_within_limits
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, RobotState, leg_slice

#: Ticks planned ahead at once: long enough to spread numpy's cost, short enough to start at once.
LOOK_AHEAD_TICKS = 128

#: Points of the gait cycle in which a walk is checked before its first step.
CHECKED_POINTS = 120


class Controller(ABC):
    """Says where the joints shall be at each tick since it took over."""

    @abstractmethod
    def targets_rad(self, tick: int, state: RobotState) -> FloatArray:
        """Return joint targets, (18,), for a tick counted from the controller's start at 0."""


class Stand(Controller):
    """Brings the joints from where they are to the nominal stance, evenly over a number of ticks."""

    def __init__(self, robot: Robot, start_rad: FloatArray, ticks: int) -> None:
        self._start_rad = start_rad
        self._end_rad = robot.stance_angles_rad
        self._ticks = max(1, ticks)

    def targets_rad(self, tick: int, state: RobotState) -> FloatArray:
        """Return the pose on the way from the start to the stance, and then the stance."""
        if tick >= self._ticks:
            return self._end_rad
        share = tick / self._ticks
        return np.asarray((1 - share) * self._start_rad + share * self._end_rad)


class Walk(Controller):
    """Walks with a gait and a motion until told to stop, then comes softly to a stand.

    Legs that are held keep their stance pose. The feet follow from the time alone, so many ticks are
    planned at once.
    """

    def __init__(
        self, robot: Robot, gait: Gait, motion: Motion, *, period_s: float, held_legs: tuple[int, ...] = ()
    ) -> None:
        self._robot, self._gait = robot, gait
        self._slots, self._strokes = np.array(gait.slots), stroke_vectors_m(robot, gait, motion)
        self._period_s = period_s
        self._held_legs = held_legs
        self._stop_s: float | None = None
        self._planned_rad: FloatArray = np.empty((0, robot.stance_angles_rad.size))
        self._planned_from = 0

    def targets_rad(self, tick: int, state: RobotState) -> FloatArray:
        """Return the joint angles of the gait at this tick."""
        row = tick - self._planned_from
        if not 0 <= row < len(self._planned_rad):
            self._plan(tick)
            row = 0
        return np.asarray(self._planned_rad[row])

    def stop(self, tick: int) -> None:
        """Begin the soft stop at a tick; it lasts `stopping_ticks`."""
        if self._stop_s is None:
            self._stop_s = tick * self._period_s
            self._planned_rad = self._planned_rad[:0]

    @property
    def stopping_ticks(self) -> int:
        """Return how long a stop from full stride takes."""
        return round(RAMP_DURATION_S / self._period_s) + 1

    def _plan(self, tick: int) -> None:
        ticks = np.arange(tick, tick + LOOK_AHEAD_TICKS)
        feet = feet_of_walks(
            self._robot,
            slots=self._slots,
            stroke_vectors=self._strokes,
            pace_hz=self._gait.pace_hz,
            height_m=self._gait.height * self._robot.size_m,
            time_s=np.asarray(ticks * self._period_s, dtype=float),
            stop_s=self._stop_s,
        )
        self._planned_rad = joints_of_feet(self._robot, feet, self._held_legs)
        self._planned_from = tick


def joints_of_feet(robot: Robot, feet_body: FloatArray, held_legs: tuple[int, ...] = ()) -> FloatArray:
    """Return joint angles, leading shape + (18,), with held legs in their stance pose."""
    joints = solve_legs(robot, feet_body).joint_positions_rad
    for leg in held_legs:
        joints[..., leg_slice(leg)] = robot.stance_angles_rad[leg_slice(leg)]
    return joints


def check_walk(robot: Robot, gait: Gait, motion: Motion) -> None:
    """Raise ReachError or LimitError, naming leg and joint, for a walk that the legs cannot make."""
    cycle_s = RAMP_DURATION_S + np.arange(CHECKED_POINTS) / (CHECKED_POINTS * gait.pace_hz)
    solve_legs_within_limits(robot, gait_feet_body(robot, gait, motion, cycle_s))


#: How long sitting down takes.
SITTING_S = 2.0


def sitting_angles_rad(robot: Robot) -> FloatArray:
    """Return the joint angles, (18,), that bring the body as low as the legs can, the feet where they are."""
    lift_m = robot.standing_height_m - robot.body.size_m[2] / 2
    for share in np.linspace(1.0, 0.0, 21).tolist():
        feet_body = robot.stance_feet_body + np.array([0.0, 0.0, share * lift_m])
        try:
            return solve_legs_within_limits(robot, feet_body)
        except (ReachError, LimitError):
            continue
    return robot.stance_angles_rad
