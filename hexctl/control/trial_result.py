"""The result of a trial: distance, the four deviations and a status; its JSON and its plot."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.failure import NoticedFailure
from hexctl.types import ArrayFields, FloatArray

#: Only `ok` is valid; the others rank behind every valid trial.
STATUSES = ("ok", "fell", "diverged", "no_progress", "cut_short", "aborted")

#: Fields on the quality of a walk.
QUALITIES = ("energy_j", "cost_of_transport", "tilt_deg", "steadiness")


@dataclass(frozen=True, slots=True, eq=False)
class Deviation(ArrayFields):
    """Distance from the line of travel in m, absolute except `signed`, which is positive to the left.

    `final` (the paper's F) and `signed` are at the end; mean and max are NaN if only the end was measured.
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
        """Inverse of `to_dict`; None if the end is not known."""
        if data["signed"] is None:
            return None
        values = {name: math.nan if value is None else float(value) for name, value in data.items()}
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class TrialResult(ArrayFields):
    """The outcome of one trial; distances are None if the robot knows no pose or never started.

    Attributes:
        status: one of `STATUSES`. `no_progress` is a straight walk, as long as the soft start (2 s) or
            longer, with less than half of its ideal distance, not counting the first second, which the soft
            start costs, or a constant position: the robot stands, or its sensor is dead.
        stopped: why it was aborted (`requested`, or the guard's reason) or cut short; None otherwise.
        duration_s: seconds walked.
        turned_rad: turn by the self-rotation before the walk.
        distance_m: progress along the heading.
        ideal_distance_m: 1.5 * A * pace * duration.
        deviation: from the line, in m: `final`, `mean`, `max`, and `signed`, positive to the left.
        yaw_change_rad: turn during the walk, counter-clockwise, with full turns.
        clipped_ticks: ticks in which the guard changed the targets.
        path_m: progress and signed deviation at each tick of the walk, (T, 2); NaN if not measured.
        cause: likely cause of `no_progress`, of `hexctl.control.scoring.cause.CAUSES`, or None.
        turn_miss_rad: overshoot of the self-rotation, counter-clockwise; None without one or without a yaw. A
            degree adds 8 to 14 cm after 30 s.
        hold: what the walk held by feedback: `line`, `heading` or `none`.
        hold_caveat: why it held less than its plan asked for, in words, or None.
        hold_lost_s: total gaps of more than a second in the measurement that it holds by. Values frozen for
            more than 4 s count as gaps, and are excluded from all other numbers.
        limited_ticks: ticks in which a steered walk was slowed down to its maximum strokes.
        true_deviation: of a simulated robot from its true line, by its true heading at the start and its true
            positions; None for a real one.
        true_path_m: the path along that line, (T, 2); None for a real robot or file. Not compared.
        energy_j: positive mechanical work of the joints over the walk; None without torques.
        cost_of_transport: energy per weight and metre of progress, without unit; None also without progress,
            and for turns and arcs.
        tilt_deg: RMS lean of the body after the soft start; None without orientations.
        steadiness: RMS deviation of the body's velocity from its mean after the soft start, in m/s; smaller
            is steadier; None without positions.
        trim_rad: counter-clockwise course correction of a held heading, or None.
        turn_trim_rad_s: counter-clockwise turn that removed a curve in open loop, or None.
        noticed: failures that the controller detected.
        warnings: those that the robot gave in the trial, such as `mute: leg 5 coxa (id 14)`, each once.
        controller: name of a custom controller, or None. Not compared.
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
    warnings: tuple[str, ...] = ()
    controller: str | None = field(default=None, compare=False)

    @property
    def valid(self) -> bool:
        """Whether the trial may be ranked by its deviation."""
        return self.status == "ok" and self.deviation is not None

    def to_dict(self, *, path: bool = False) -> dict[str, Any]:
        """JSON values, angles in degrees; `controller` only for a custom one, the path if asked for."""
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
            "warnings": list(self.warnings),
        }
        if self.controller is not None:
            data["controller"] = self.controller
        if path:
            data["path_m"] = [[_known(value) for value in row] for row in self.path_m.tolist()]
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "TrialResult":
        """Inverse of `to_dict`, angles up to rounding; raises InputError for anything else."""
        try:
            path, true_deviation_m = data.get("path_m") or np.zeros((0, 2)), data["true_deviation_m"]
            return cls(
                status=str(data["status"]),
                stopped=data["stopped"],
                duration_s=float(data["duration_s"]),
                turned_rad=math.radians(data["self_rotation_deg"]),
                distance_m=data["distance_m"],
                ideal_distance_m=float(data["ideal_distance_m"]),
                deviation=Deviation.from_dict(data["deviation_m"]),
                yaw_change_rad=_radians(data["yaw_change_deg"]),
                clipped_ticks=int(data["clipped_ticks"]),
                path_m=np.array(path, dtype=float),
                cause=data["cause"],
                turn_miss_rad=_radians(data["turn_miss_deg"]),
                hold=str(data["hold"]),
                hold_caveat=data["hold_caveat"],
                hold_lost_s=float(data["hold_lost_s"]),
                limited_ticks=int(data["limited_ticks"]),
                true_deviation=None if true_deviation_m is None else Deviation.from_dict(true_deviation_m),
                **{name: data[name] for name in QUALITIES},
                trim_rad=_radians(data["trim_deg"]),
                turn_trim_rad_s=_radians(data["turn_trim_deg_s"]),
                noticed=tuple(NoticedFailure.from_dict(each) for each in data["noticed"]),
                warnings=tuple(data["warnings"]),
                controller=data.get("controller"),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"trial result: cannot be read ({error!r}); allowed: what `to_dict` gives"
            ) from error

    def plot(self, ax: Any = None) -> Any:
        """Draw the path from above in axes, or a new figure; raises MissingExtraError."""
        ax = path_axes(ax)
        (line,) = ax.plot(self.path_m[:, 0], self.path_m[:, 1], label=repr(self))
        if len(self.path_m):
            ax.plot(*self.path_m[-1], "o", color=line.get_color())
        return ax

    def __repr__(self) -> str:
        why = self.stopped or self.cause
        text = self.status if why is None else f"{self.status} ({why})"
        if self.controller is not None:
            text = f"{self.controller}: {text}"
        if self.distance_m is not None:
            text += f", {self.distance_m:.3f} of {self.ideal_distance_m:.3f} m"
        if self.deviation is not None:
            side = "left" if self.deviation.signed > 0 else "right"
            text += f", {self.deviation.final:.4f} m {side} of the line"
        return f"TrialResult({text}, {self.duration_s:g} s)"


def path_axes(ax: Any = None) -> Any:
    """Matplotlib axes for paths from above, with the line of travel; raises MissingExtraError."""
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
