"""What a trial came to: distance, the four deviations and a status."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.control.plan import TrialPlan
from hexctl.control.trace import TrialFrame
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.model import Robot
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray

#: A walk with less than this share of the ideal distance made no progress; one that is over before the soft
#: start is says nothing about it.
PROGRESS_FLOOR = 0.5

#: `ok` is the only valid outcome; the others rank behind every valid trial.
STATUSES = ("ok", "fell", "diverged", "no_progress", "cut_short", "aborted")


@dataclass(frozen=True, slots=True)
class Deviation:
    """Distance from the line of travel in m.

    Attributes:
        final: at the end, absolute (the paper's F).
        mean: mean of the absolute deviation over the walk; nan where only the end was measured.
        max: greatest absolute deviation; nan likewise.
        signed: at the end, positive to the left.
    """

    final: float
    mean: float
    max: float
    signed: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialResult:
    """The outcome of one trial; distances are None where the robot knows no pose or never set out.

    Attributes:
        status: one of `STATUSES`.
        stopped: why an aborted trial was stopped: `requested`, or what the guard says; why one was cut short,
            where it was not for what it showed; None otherwise.
        duration_s: how long it walked.
        turned_rad: how far the self-rotation before the walk turned.
        distance_m: progress along the heading.
        ideal_distance_m: 1.5 * A * pace * duration.
        deviation: from the line of travel.
        yaw_change_rad: how far the body turned during the walk, counter-clockwise, whole turns counted.
        clipped_ticks: ticks in which the guard changed the targets.
        path_m: progress and signed deviation at each tick of the walk, (T, 2); nan where nobody measured.
    """

    status: str
    stopped: str | None
    duration_s: float
    turned_rad: float
    distance_m: float | None
    ideal_distance_m: float
    deviation: Deviation | None
    yaw_change_rad: float | None
    clipped_ticks: int
    path_m: FloatArray

    @property
    def valid(self) -> bool:
        """Return whether the trial may be ranked by its deviation."""
        return self.status == "ok" and self.deviation is not None

    def numbers(self) -> dict[str, Any]:
        """Return the outcome as plain JSON values, angles in degrees."""
        deviation = self.deviation
        return {
            "duration_s": round(self.duration_s, 6),
            "distance_m": self.distance_m,
            "ideal_distance_m": self.ideal_distance_m,
            "deviation_m": {
                name: None if deviation is None else _known(getattr(deviation, name))
                for name in ("final", "mean", "max", "signed")
            },
            "yaw_change_deg": None if self.yaw_change_rad is None else float(np.degrees(self.yaw_change_rad)),
            "self_rotation_deg": float(np.degrees(self.turned_rad)),
            "status": self.status,
            "stopped": self.stopped,
            "clipped_ticks": self.clipped_ticks,
        }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def score(
    robot: Robot,
    plan: TrialPlan,
    *,
    status: str,
    stopped: str | None = None,
    duration_s: float,
    turned_rad: float,
    clipped_ticks: int,
    frame: TrialFrame | None,
    positions_world: FloatArray,
    quaternions_world: FloatArray,
) -> TrialResult:
    """Return the result of a walk.

    Args:
        robot: who walked.
        plan: what was asked for.
        status: how the walk ended; a walk that is `ok` so far may still have made no progress.
        stopped: why it was aborted, if it was.
        duration_s: how long it walked.
        turned_rad: how far the self-rotation turned.
        clipped_ticks: ticks in which the guard changed the targets.
        frame: the trial frame, None where the robot knows no pose or never set out.
        positions_world: base positions of the walk, (T, 3).
        quaternions_world: base orientations of the walk, (T, 4).
    """
    walked = frame is not None and len(positions_world) > 0
    path = frame.path(positions_world) if frame is not None else np.zeros((0, 2))
    distance_m = float(path[-1, 0]) if walked else None
    ideal_speed = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
    long_enough = duration_s >= RAMP_DURATION_S
    if status == "ok" and distance_m is not None and long_enough and _goes_straight(plan):
        status = "ok" if distance_m >= progress_floor_m(robot, plan, duration_s) else "no_progress"
    return TrialResult(
        status=status,
        stopped=stopped,
        duration_s=duration_s,
        turned_rad=turned_rad,
        distance_m=distance_m,
        ideal_distance_m=ideal_speed * duration_s,
        deviation=_deviation(path[:, 1]) if walked else None,
        yaw_change_rad=_yaw_change_rad(frame.yaw_rad, quaternions_world) if frame and walked else None,
        clipped_ticks=clipped_ticks,
        path_m=path,
    )


def progress_floor_m(robot: Robot, plan: TrialPlan, duration_s: float) -> float:
    """Return the distance below which a walk of a duration made no progress."""
    ideal_speed = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
    return PROGRESS_FLOOR * ideal_speed * _ramped_duration_s(duration_s)


def _deviation(signed_m: FloatArray) -> Deviation:
    """Return the four deviations of a walk, from its signed deviation at each tick."""
    off_m = np.abs(signed_m)
    return Deviation(float(off_m[-1]), float(off_m.mean()), float(off_m.max()), float(signed_m[-1]))


def _yaw_change_rad(first_yaw_rad: float, quaternions_world: FloatArray) -> float:
    """Return how far the body turned, whole turns counted."""
    yaws = np.unwrap(np.concatenate([[first_yaw_rad], yaw_rad(quaternions_world)]))
    return float(yaws[-1] - yaws[0])


def _goes_straight(plan: TrialPlan) -> bool:
    """Return whether a plan's distance along the heading says how well it went."""
    return plan.travel > 0 and plan.turn_rate_rad_s == 0


def _ramped_duration_s(duration_s: float) -> float:
    """Return the time at full stride that the soft start leaves of a duration of a ramp or more."""
    return duration_s - RAMP_DURATION_S / 2
