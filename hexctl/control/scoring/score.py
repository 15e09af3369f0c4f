"""The score of a walk: its result, from the measured poses."""

import numpy as np

from hexctl.control.scoring.cause import Samples, symptoms
from hexctl.control.scoring.walk_quality import cost_of_transport, lean_deg, unsteadiness_m_s
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import Deviation, TrialResult
from hexctl.control.walks.sensor_loss import LOST_AFTER_S, frozen_rows
from hexctl.control.walks.steering import plane, why_less
from hexctl.control.walks.turning import TURN_WITHIN_RAD, turn_needed_rad
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.failure import NoticedFailure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import BoolArray, FloatArray

#: A walk of the soft start or longer with less than this share of the ideal distance made no progress.
PROGRESS_FLOOR = 0.5

#: A walk has an end if the position is known in one of this many last ticks.
END_TICKS = 50

#: Orientations of a walk that never began; also its positions.
NOWHERE: FloatArray = np.zeros((0, 4))


def score(
    robot: Robot,
    plan: TrialPlan,
    *,
    status: str,
    stopped: str | None = None,
    duration_s: float = 0.0,
    turned_rad: float = 0.0,
    clipped_ticks: int = 0,
    frame: TrialFrame | None = None,
    positions_world: FloatArray = NOWHERE[:, :3],
    quaternions_world: FloatArray = NOWHERE,
    samples: Samples | None = None,
    hold: str = "none",
    limited_ticks: int = 0,
    true_frame: TrialFrame | None = None,
    true_positions_world: FloatArray | None = None,
    energy_j: float | None = None,
    noticed: tuple[NoticedFailure, ...] = (),
    warnings: tuple[str, ...] = (),
    controller: str | None = None,
) -> TrialResult:
    """Result of a walk from base positions (T, 3) and orientations (T, 4); NaN or None if unknown.

    The status `ok` may become `no_progress`, with a cause from the samples. By default nothing was walked.
    """
    shown_world = positions_world
    positions_world = _without_frozen(positions_world, np.stack(plane(positions_world), axis=-1), duration_s)
    quaternions_world = _without_frozen(quaternions_world, quaternions_world, duration_s)
    motionless = frame is not None and _is_frozen(shown_world, positions_world)
    path, known = _paths(frame, positions_world)
    distance_m = float(known[-1, 0]) if np.isfinite(path[-END_TICKS:, 0]).any() else None
    yaw_change_rad = None if frame is None else _yaw_change_rad(frame.yaw_rad, quaternions_world)
    if status == "ok" and _lacks_progress(robot, plan, duration_s, distance_m, motionless=motionless):
        status = "no_progress"
    true_path_m = _true_path_m(true_frame, true_positions_world)
    clipped = min(1.0, clipped_ticks / max(1, len(positions_world)))
    cause = _cause(robot, plan, status, samples, duration_s, positions_world, quaternions_world, clipped)
    return TrialResult(
        status=status,
        stopped=stopped,
        duration_s=duration_s,
        turned_rad=turned_rad,
        distance_m=distance_m,
        ideal_distance_m=ideal_distance_m(robot, plan, duration_s),
        deviation=_deviation(known[:, 1]) if distance_m is not None else None,
        yaw_change_rad=yaw_change_rad,
        clipped_ticks=clipped_ticks,
        path_m=path,
        cause=cause,
        turn_miss_rad=_turn_miss_rad(robot, plan, turned_rad) if yaw_change_rad is not None else None,
        hold=hold,
        hold_caveat=why_less(plan, frame) if len(positions_world) else None,
        hold_lost_s=_hold_lost_s(hold, duration_s, positions_world, quaternions_world),
        limited_ticks=limited_ticks,
        true_deviation=None if true_path_m is None else _deviation(true_path_m[:, 1]),
        true_distance_m=None if true_path_m is None else float(true_path_m[-1, 0]),
        true_path_m=true_path_m,
        energy_j=energy_j,
        cost_of_transport=cost_of_transport(robot, energy_j, distance_m if plan.straight else None),
        tilt_deg=lean_deg(quaternions_world),
        steadiness=unsteadiness_m_s(positions_world),
        trim_rad=plan.trim_rad if hold == "heading" or plan.turn_trim_rad_s is not None else None,
        turn_trim_rad_s=plan.turn_trim_rad_s,
        noticed=noticed,
        warnings=warnings,
        controller=controller,
    )


def _is_frozen(shown_world: FloatArray, positions_world: FloatArray) -> bool:
    """Whether all known positions repeat one: the robot stands, or its sensor is dead."""
    shown, kept = (int(np.isfinite(rows[:, 0]).sum()) for rows in (shown_world, positions_world))
    return shown > 1 and kept == 1


def _paths(frame: TrialFrame | None, positions_world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Path in the trial frame, empty if unknown, and its known rows."""
    path = frame.path(positions_world) if frame is not None else np.zeros((0, 2))
    known = path[np.isfinite(path[:, 0])]
    return path if len(known) else path[:0], known


def _lacks_progress(
    robot: Robot, plan: TrialPlan, duration_s: float, distance_m: float | None, *, motionless: bool
) -> bool:
    if duration_s < RAMP_DURATION_S or not plan.straight:
        return False
    too_short = distance_m is not None and distance_m < progress_floor_m(robot, plan, duration_s)
    return too_short or motionless


def _cause(
    robot: Robot,
    plan: TrialPlan,
    status: str,
    samples: Samples | None,
    duration_s: float,
    positions_world: FloatArray,
    quaternions_world: FloatArray,
    clipped: float,
) -> str | None:
    if status != "no_progress" or samples is None:
        return None
    positions, quaternions = (  # short gaps filled, NaN in longer ones
        np.where(_lost(rows, duration_s)[:, np.newaxis], np.nan, filled(rows))
        for rows in (positions_world, quaternions_world)
    )
    seen = symptoms(robot, plan, samples, positions, quaternions, clipped)
    return None if seen is None else seen.cause


def _without_frozen(rows: FloatArray, compared: FloatArray, duration_s: float) -> FloatArray:
    """Rows (T, n), with NaN at ticks in which `compared`, (T, m), repeats a frozen value."""
    frozen = frozen_rows(compared, duration_s / max(1, len(rows)))
    return np.where(frozen[:, np.newaxis], np.nan, rows) if frozen.any() else rows


def _hold_lost_s(
    hold: str, duration_s: float, positions_world: FloatArray, quaternions_world: FloatArray
) -> float:
    """Total time of the gaps over `LOST_AFTER_S` in the measurement that the hold needs."""
    by = {"line": positions_world, "heading": quaternions_world}.get(hold)
    if by is None or not len(by):
        return 0.0
    return float(_lost(by, duration_s).sum() * (duration_s / len(by)))


def _lost(rows: FloatArray, duration_s: float) -> BoolArray:
    """Which rows (T, n) are in a gap of more than `LOST_AFTER_S`, (T,)."""
    ends = np.flatnonzero(np.concatenate([[True], np.isfinite(rows[:, 0]), [True]])) - 1
    lost = np.zeros(len(rows), dtype=bool)
    for before, after in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        if (after - before - 1) * (duration_s / len(rows)) > LOST_AFTER_S:
            lost[before + 1 : after] = True
    return lost


def _true_path_m(frame: TrialFrame | None, positions_world: FloatArray | None) -> FloatArray | None:
    if frame is None or positions_world is None or not len(positions_world):
        return None
    if not np.isfinite(positions_world).all():
        return None
    return frame.path(positions_world)


def filled(rows: FloatArray) -> FloatArray:
    """Rows (T, n) with each unknown row filled by the row before, or by the first known one."""
    known = np.isfinite(rows[:, 0])
    if known.all() or not known.any():
        return rows
    last = np.maximum.accumulate(np.where(known, np.arange(len(rows)), -1))
    return np.asarray(rows[np.where(last < 0, np.argmax(known), last)])


def _turn_miss_rad(robot: Robot, plan: TrialPlan, turned_rad: float) -> float | None:
    requested_rad = turn_needed_rad(robot, plan)
    return wrapped_rad(turned_rad - requested_rad) if abs(requested_rad) > TURN_WITHIN_RAD else None


def ideal_distance_m(robot: Robot, plan: TrialPlan, duration_s: float) -> float:
    """Distance without slip, with the speed of each gait of the plan in its time."""
    distance_m, gait, since_s = 0.0, plan.gait, 0.0
    for change in plan.changes:
        until_s = min(change.at_s, duration_s)
        distance_m += ideal_speed_m_s(robot, gait, plan.motion(0.0)) * (until_s - since_s)
        gait, since_s = change.gait, until_s
    return distance_m + ideal_speed_m_s(robot, gait, plan.motion(0.0)) * (duration_s - since_s)


def progress_floor_m(robot: Robot, plan: TrialPlan, duration_s: float) -> float:
    """Distance below which a walk of a duration made no progress."""
    if plan.changes:
        lost_m = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0)) * RAMP_DURATION_S / 2
        return PROGRESS_FLOOR * (ideal_distance_m(robot, plan, duration_s) - lost_m)
    ideal_speed = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
    return PROGRESS_FLOOR * ideal_speed * (duration_s - RAMP_DURATION_S / 2)  # the soft start costs a half


def _deviation(signed_m: FloatArray) -> Deviation:
    off_m = np.abs(signed_m)
    return Deviation(float(off_m[-1]), float(off_m.mean()), float(off_m.max()), float(signed_m[-1]))


def _yaw_change_rad(first_yaw_rad: float, quaternions_world: FloatArray) -> float | None:
    known = quaternions_world[np.isfinite(quaternions_world[:, 0])]
    if not len(known):
        return None
    yaws = np.unwrap(np.concatenate([[first_yaw_rad], yaw_rad(known)]))
    return float(yaws[-1] - yaws[0])
