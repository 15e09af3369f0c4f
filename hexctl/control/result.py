"""The result of a trial: distance, the four deviations and a status."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hexctl.control.assessment.cause import Samples, symptoms
from hexctl.control.assessment.walk_quality import cost_of_transport, lean_deg, unsteadiness_m_s
from hexctl.control.plan import TrialPlan
from hexctl.control.steering import LOST_AFTER_S, frozen_rows, plane, why_less
from hexctl.control.trace import TrialFrame
from hexctl.control.turning import TURN_WITHIN_RAD, turn_needed_rad
from hexctl.errors import InputError, MissingExtraError
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.failure_event import NoticedFailure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import ArrayFields, BoolArray, FloatArray

#: A walk with less than this share of the ideal distance made no progress; one that is over before the soft
#: start is says nothing about it.
PROGRESS_FLOOR = 0.5

#: A walk has an end where the robot knew its position in one of this many last ticks.
END_TICKS = 50

#: `ok` is the only valid outcome; the others rank behind every valid trial.
STATUSES = ("ok", "fell", "diverged", "no_progress", "cut_short", "aborted")

#: Fields of a result that say how it walked, not where to; results from before there were any have none.
QUALITIES = ("energy_j", "cost_of_transport", "tilt_deg", "steadiness")


@dataclass(frozen=True, slots=True, eq=False)
class Deviation(ArrayFields):
    """Distance from the line of travel in m.

    Attributes:
        final: at the end, absolute (the paper's F).
        mean: mean of the absolute deviation over the walk; NaN where only the end was measured.
        max: greatest absolute deviation; NaN likewise.
        signed: at the end, positive to the left.
    """

    final: float
    mean: float
    max: float
    signed: float

    def to_dict(self) -> dict[str, float | None]:
        """JSON values; None for NaN."""
        return {name: _known(getattr(self, name)) for name in ("final", "mean", "max", "signed")}

    @classmethod
    def from_dict(cls, data: Mapping[str, float | None]) -> "Deviation | None":
        """Inverse of `to_dict`; None where the end is not known."""
        if data["signed"] is None:
            return None
        values = {name: math.nan if value is None else float(value) for name, value in data.items()}
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class TrialResult(ArrayFields):
    """The outcome of one trial; distances are None where the robot knows no pose or never set out.

    Attributes:
        status: one of `STATUSES`. A walk that shows one and the same position from its start on has made
            `no_progress`, with distances that are None: the robot stands, or its sensor is dead.
        stopped: why an aborted trial was stopped: `requested`, or what the guard says; why one was cut short,
            where it was not for what it showed; None otherwise.
        duration_s: how long it walked.
        turned_rad: how far the self-rotation before the walk turned.
        distance_m: progress along the heading.
        ideal_distance_m: 1.5 * A * pace * duration.
        deviation: from the line of travel.
        yaw_change_rad: how far the body turned during the walk, counter-clockwise, whole turns counted.
        clipped_ticks: ticks in which the guard changed the targets.
        path_m: progress and signed deviation at each tick of the walk, (T, 2); NaN where not measured.
        cause: the likely cause of `no_progress`, one of `hexctl.control.assessment.cause.CAUSES`; None for
            any other status, and where none stands out or joints and feet are not measured.
        turn_miss_rad: how much further than its goal the self-rotation turned, counter-clockwise; None
            without one, and where the robot knows no yaw. A degree is worth 8 to 14 cm after 30 s.
        hold: what the walk held by feedback: `line`, `heading` or `none`.
        hold_caveat: why it held less than its plan wanted, in words; None where it did not.
        hold_lost_s: how long what it holds by was not measured, in gaps of more than a second; a value that
            froze for more than 4 s was not, and has no part in any other number of the result. What a sensor
            showed wrongly otherwise does not count.
        limited_ticks: ticks in which a steered walk asked for more speed than its strokes allow, and was
            scaled down.
        true_deviation: from the same line by where a simulated robot really was, which its sensors may not
            have told; None for a real robot.
        true_path_m: the same as `path_m` by where it really was, (T, 2); None for a real robot, and for a
            result that was read. It counts in no comparison.
        energy_j: mechanical work of the joints' actuators over the walk, without what they brake; None where
            the robot does not tell its torques.
        cost_of_transport: that work per weight and metre of progress, without unit; None likewise, without
            progress, and for a turn in place and an arc.
        tilt_deg: lean of the body after the soft start, root mean square; None where its orientation is not
            known.
        steadiness: by how much the velocity of the body differs from its mean after the soft start, root mean
            square in m/s, so that smaller is steadier; None where its position is not known.
        trim_rad: course correction with which it held its heading, counter-clockwise; None where it held
            something else, or nothing.
        turn_trim_rad_s: turn that went with it in open loop to take out its curve, counter-clockwise; None
            where it was not trimmed.
        noticed: failures that the controller noticed on the way.
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
    cause: str | None = None
    turn_miss_rad: float | None = None
    hold: str = "none"
    hold_caveat: str | None = None
    hold_lost_s: float = 0.0
    limited_ticks: int = 0
    true_deviation: Deviation | None = None
    true_path_m: FloatArray | None = field(default=None, compare=False)
    energy_j: float | None = None
    cost_of_transport: float | None = None
    tilt_deg: float | None = None
    steadiness: float | None = None
    trim_rad: float | None = None
    turn_trim_rad_s: float | None = None
    noticed: tuple[NoticedFailure, ...] = ()

    @property
    def valid(self) -> bool:
        """Whether the trial may be ranked by its deviation."""
        return self.status == "ok" and self.deviation is not None

    def to_dict(self, *, path: bool = False) -> dict[str, Any]:
        """The outcome as plain JSON values, angles in degrees; with `path`, the path as well."""
        unknown = {"final": None, "mean": None, "max": None, "signed": None}
        yaw_change = self.yaw_change_rad
        data: dict[str, Any] = {
            "duration_s": round(self.duration_s, 6),
            "distance_m": self.distance_m,
            "ideal_distance_m": self.ideal_distance_m,
            "deviation_m": unknown if self.deviation is None else self.deviation.to_dict(),
            "yaw_change_deg": None if yaw_change is None else float(np.degrees(yaw_change)),
            "self_rotation_deg": float(np.degrees(self.turned_rad)),
            "status": self.status,
            "stopped": self.stopped,
            "clipped_ticks": self.clipped_ticks,
            "cause": self.cause,
            "turn_miss_deg": None if self.turn_miss_rad is None else math.degrees(self.turn_miss_rad),
            "hold": self.hold,
            "hold_caveat": self.hold_caveat,
            "hold_lost_s": self.hold_lost_s,
            "limited_ticks": self.limited_ticks,
            "true_deviation_m": None if self.true_deviation is None else self.true_deviation.to_dict(),
            **{name: getattr(self, name) for name in QUALITIES},
            "trim_deg": _degrees(self.trim_rad),
            "turn_trim_deg_s": _degrees(self.turn_trim_rad_s),
            "noticed": [each.to_dict() for each in self.noticed],
        }
        if path:
            data["path_m"] = [[_known(value) for value in row] for row in self.path_m.tolist()]
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "TrialResult":
        """Inverse of `to_dict`, angles up to rounding; a path that was left out is empty.

        Raises InputError for anything else.
        """
        try:
            miss_deg = data.get("turn_miss_deg")
            yaw_change_deg, path = data["yaw_change_deg"], data.get("path_m") or np.zeros((0, 2))
            return cls(
                status=str(data["status"]),
                stopped=data["stopped"],
                duration_s=float(data["duration_s"]),
                turned_rad=math.radians(data["self_rotation_deg"]),
                distance_m=data["distance_m"],
                ideal_distance_m=float(data["ideal_distance_m"]),
                deviation=Deviation.from_dict(data["deviation_m"]),
                yaw_change_rad=None if yaw_change_deg is None else math.radians(yaw_change_deg),
                clipped_ticks=int(data["clipped_ticks"]),
                path_m=np.array(path, dtype=float),
                cause=data.get("cause"),
                turn_miss_rad=None if miss_deg is None else math.radians(miss_deg),
                hold=str(data.get("hold", "none")),
                hold_caveat=data.get("hold_caveat"),
                hold_lost_s=float(data.get("hold_lost_s", 0.0)),
                limited_ticks=int(data.get("limited_ticks", 0)),
                true_deviation=Deviation.from_dict(data.get("true_deviation_m") or {"signed": None}),
                **{name: data.get(name) for name in QUALITIES},
                trim_rad=_radians(data.get("trim_deg")),
                turn_trim_rad_s=_radians(data.get("turn_trim_deg_s")),
                noticed=tuple(NoticedFailure.from_dict(each) for each in data.get("noticed", ())),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f"trial result: cannot be read ({error!r}); allowed: what `to_dict` gives"
            ) from error

    def plot(self, ax: Any = None) -> Any:
        """Draw the path seen from above, the line of travel from left to right; the axes drawn in.

        Args:
            ax: matplotlib axes, or None for those of a new figure.

        Raises MissingExtraError without matplotlib.
        """
        ax = path_axes(ax)
        (line,) = ax.plot(self.path_m[:, 0], self.path_m[:, 1], label=repr(self))
        if len(self.path_m):
            ax.plot(*self.path_m[-1], "o", color=line.get_color())
        return ax

    def __repr__(self) -> str:
        why = self.stopped or self.cause
        text = self.status if why is None else f"{self.status} ({why})"
        if self.distance_m is not None:
            text += f", {self.distance_m:.3f} of {self.ideal_distance_m:.3f} m"
        if self.deviation is not None:
            side = "left" if self.deviation.signed > 0 else "right"
            text += f", {self.deviation.final:.4f} m {side} of the line"
        return f"TrialResult({text}, {self.duration_s:g} s)"


def path_axes(ax: Any = None) -> Any:
    """Matplotlib axes for paths seen from above, with the line of travel: those given, or of a new figure.

    Raises MissingExtraError without matplotlib.
    """
    try:
        import matplotlib.pyplot as plt
    except ModuleNotFoundError as error:
        raise MissingExtraError("a plot", "study") from error
    ax = plt.figure().add_subplot() if ax is None else ax
    ax.axhline(0.0, color="0.6", linewidth=1.0)
    ax.set(xlabel="progress in m", ylabel="deviation in m, positive to the left")
    ax.set_aspect("equal", adjustable="datalim")
    return ax


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad)


def _radians(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)


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
    samples: Samples | None = None,
    hold: str = "none",
    limited_ticks: int = 0,
    true_positions_world: FloatArray | None = None,
    energy_j: float | None = None,
    noticed: tuple[NoticedFailure, ...] = (),
) -> TrialResult:
    """Result of a walk.

    Args:
        robot: the robot that walked.
        plan: the plan.
        status: how the walk ended; a walk that is `ok` so far may still have made no progress.
        stopped: why it was aborted, if it was.
        duration_s: how long it walked.
        turned_rad: how far the self-rotation turned.
        clipped_ticks: ticks in which the guard changed the targets.
        frame: the trial frame, None where the robot knows no pose or never set out.
        positions_world: base positions of the walk, (T, 3).
        quaternions_world: base orientations of the walk, (T, 4).
        samples: of its joints and feet, from which the cause of a walk without progress is told; None where
            they are not known.
        hold: what the walk held by feedback.
        limited_ticks: ticks in which it was slower than asked for.
        true_positions_world: of a simulated robot, likewise; NaN or None where they are not known.
        energy_j: mechanical work of its actuators; None where it is not known.
        noticed: failures that its controller noticed.
    """
    shown = int(np.isfinite(positions_world[:, 0]).sum())
    positions_world = _without_frozen(positions_world, np.stack(plane(positions_world), axis=-1), duration_s)
    quaternions_world = _without_frozen(quaternions_world, quaternions_world, duration_s)
    # All that the robot showed of its position is one that froze: it stands, or its sensor is dead.
    never_moved = frame is not None and shown > 1 and int(np.isfinite(positions_world[:, 0]).sum()) == 1
    path = frame.path(positions_world) if frame is not None else np.zeros((0, 2))
    known = path[np.isfinite(path[:, 0])]
    path = path if len(known) else path[:0]
    walked = bool(np.isfinite(path[-END_TICKS:, 0]).any())
    distance_m = float(known[-1, 0]) if walked else None
    yaw_change_rad = None if frame is None else _yaw_change_rad(frame.yaw_rad, quaternions_world)
    long_enough = duration_s >= RAMP_DURATION_S
    if status == "ok" and long_enough and _goes_straight(plan):
        too_short = distance_m is not None and distance_m < progress_floor_m(robot, plan, duration_s)
        status = "no_progress" if too_short or never_moved else "ok"
    true_path_m = _true_path_m(frame, true_positions_world)
    cause = None
    if status == "no_progress" and samples is not None:
        poses = (_briefly_filled(rows, duration_s) for rows in (positions_world, quaternions_world))
        seen = symptoms(robot, plan, samples, *poses)
        cause = None if seen is None else seen.cause
    return TrialResult(
        status=status,
        stopped=stopped,
        duration_s=duration_s,
        turned_rad=turned_rad,
        distance_m=distance_m,
        ideal_distance_m=ideal_distance_m(robot, plan, duration_s),
        deviation=_deviation(known[:, 1]) if walked else None,
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
        true_path_m=true_path_m,
        energy_j=energy_j,
        cost_of_transport=cost_of_transport(robot, energy_j, distance_m if _goes_straight(plan) else None),
        tilt_deg=lean_deg(quaternions_world),
        steadiness=unsteadiness_m_s(positions_world),
        trim_rad=plan.trim_rad if hold == "heading" else None,
        turn_trim_rad_s=plan.turn_trim_rad_s,
        noticed=noticed,
    )


def _without_frozen(rows: FloatArray, compared: FloatArray, duration_s: float) -> FloatArray:
    """Rows (T, n) with NaN where what is compared of them, (T, m), repeats a value that froze."""
    frozen = frozen_rows(compared, duration_s / max(1, len(rows)))
    return np.where(frozen[:, np.newaxis], np.nan, rows) if frozen.any() else rows


def _hold_lost_s(
    hold: str, duration_s: float, positions_world: FloatArray, quaternions_world: FloatArray
) -> float:
    """Time of the gaps in which what a walk holds by was not measured, those longer than `LOST_AFTER_S`."""
    by = {"line": positions_world, "heading": quaternions_world}.get(hold)
    if by is None or not len(by):
        return 0.0
    return float(_lost(by, duration_s).sum() * (duration_s / len(by)))


def _lost(rows: FloatArray, duration_s: float) -> BoolArray:
    """Which rows (T, n) of a duration are in a gap of more than `LOST_AFTER_S`, (T,)."""
    ends = np.flatnonzero(np.concatenate([[True], np.isfinite(rows[:, 0]), [True]])) - 1
    lost = np.zeros(len(rows), dtype=bool)
    for before, after in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        if (after - before - 1) * (duration_s / len(rows)) > LOST_AFTER_S:
            lost[before + 1 : after] = True
    return lost


def _briefly_filled(rows: FloatArray, duration_s: float) -> FloatArray:
    """Rows (T, n) in which short dropouts have the value before; NaN in longer gaps."""
    return np.where(_lost(rows, duration_s)[:, np.newaxis], np.nan, filled(rows))


def _true_path_m(frame: TrialFrame | None, positions_world: FloatArray | None) -> FloatArray | None:
    """Path by true positions, (T, 3); None where there are none."""
    if frame is None or positions_world is None or not len(positions_world):
        return None
    if not np.isfinite(positions_world).all():
        return None
    if not np.isfinite(frame.origin_world).all():
        frame = replace(frame, origin_world=positions_world[0])
    return frame.path(positions_world)


def filled(rows: FloatArray) -> FloatArray:
    """Rows (T, n) in which each unknown one is that before it, or the first known one."""
    known = np.isfinite(rows[:, 0])
    if known.all() or not known.any():
        return rows
    last = np.maximum.accumulate(np.where(known, np.arange(len(rows)), -1))
    return np.asarray(rows[np.where(last < 0, np.argmax(known), last)])


def _turn_miss_rad(robot: Robot, plan: TrialPlan, turned_rad: float) -> float | None:
    """How much further than its goal a self-rotation turned; None for a plan without one."""
    wanted_rad = turn_needed_rad(robot, plan)
    return wrapped_rad(turned_rad - wanted_rad) if abs(wanted_rad) > TURN_WITHIN_RAD else None


def ideal_distance_m(robot: Robot, plan: TrialPlan, duration_s: float) -> float:
    """Distance without slip in a duration, at the speed of each gait in its time."""
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
    return PROGRESS_FLOOR * ideal_speed * _ramped_duration_s(duration_s)


def _deviation(signed_m: FloatArray) -> Deviation:
    """The four deviations of a walk, from its signed deviation at each tick."""
    off_m = np.abs(signed_m)
    return Deviation(float(off_m[-1]), float(off_m.mean()), float(off_m.max()), float(signed_m[-1]))


def _yaw_change_rad(first_yaw_rad: float, quaternions_world: FloatArray) -> float | None:
    """How far the body turned, whole turns counted; None where no orientation is known."""
    known = quaternions_world[np.isfinite(quaternions_world[:, 0])]
    if not len(known):
        return None
    yaws = np.unwrap(np.concatenate([[first_yaw_rad], yaw_rad(known)]))
    return float(yaws[-1] - yaws[0])


def _goes_straight(plan: TrialPlan) -> bool:
    """Whether a plan's distance along the heading says how well it went."""
    return plan.travel > 0 and plan.turn_rate_rad_s == 0


def _ramped_duration_s(duration_s: float) -> float:
    """Time at full stride that the soft start leaves of a duration of a ramp or more."""
    return duration_s - RAMP_DURATION_S / 2
