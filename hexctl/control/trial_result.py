"""The result of a trial: distance, the four deviations and a status; its JSON and its plot."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    WrapSerializer,
)

from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.failure import NoticedFailure
from hexctl.types import ArrayFields, FloatArray

#: Only `ok` is valid; the others rank behind every valid trial.
STATUSES = ("ok", "fell", "diverged", "no_progress", "cut_short", "aborted")

#: Fields on the quality of a walk.
QUALITIES = ("energy_j", "cost_of_transport", "tilt_deg", "steadiness")


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _or_nan(value: Any) -> float:
    """A finite number, or NaN for None."""
    if value is not None and (isinstance(value, bool | str) or not math.isfinite(value)):
        raise ValueError(f"got {value!r}; allowed: a finite number or null")
    return math.nan if value is None else float(value)


def _path(value: Any) -> FloatArray:
    """Points of a path, (T, 2), with NaN for None."""
    path_m = np.array(value or np.empty((0, 2)), dtype=float)
    if path_m.shape[1:] != (2,):
        raise ValueError(f"got shape {path_m.shape}; allowed: rows of two numbers")
    return path_m


#: Types of JSON values. Angles are in degrees there, and unknown numbers null.
_Text = Annotated[str, Field(strict=True)]
_Number = Annotated[float, Field(strict=True)]
_Count = Annotated[int, Field(strict=True, ge=0)]
_Seconds = Annotated[float, Field(strict=True, ge=0)]
_Angle = Annotated[_Number, AfterValidator(math.radians), PlainSerializer(math.degrees)]
_OrNan = Annotated[float, PlainValidator(_or_nan), PlainSerializer(_known)]
_Path = Annotated[
    FloatArray,
    PlainValidator(_path),
    PlainSerializer(lambda path_m: [[_known(value) for value in row] for row in path_m.tolist()]),
]
_Noticed = Annotated[
    NoticedFailure,
    PlainValidator(NoticedFailure.from_dict),
    PlainSerializer(NoticedFailure.to_dict),
]


@dataclass(frozen=True, slots=True, eq=False)
class Deviation(ArrayFields):
    """Distance from the line of travel in m, absolute except `signed`, which is positive to the left.

    `final` (the paper's F) and `signed` are at the end; mean and max are NaN if only the end was measured.
    """

    final: _OrNan
    mean: _OrNan
    max: _OrNan
    signed: _OrNan


def _or_nulls(deviation: Deviation | None, to_json: Callable[[Any], Any]) -> Any:
    """Numbers of a deviation, null for each of an unknown one."""
    return dict.fromkeys(("final", "mean", "max", "signed")) if deviation is None else to_json(deviation)


#: A deviation whose end is known; in JSON an unknown one has null in place of its numbers.
_Deviation = Annotated[
    Deviation | None,
    BeforeValidator(lambda data: None if data is None or data["signed"] is None else data),
]


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
        true_distance_m: progress along that line; None for a real robot.
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

    __pydantic_config__: ClassVar = ConfigDict(allow_inf_nan=False, arbitrary_types_allowed=True)

    duration_s: Annotated[_Seconds, PlainSerializer(lambda duration_s: round(duration_s, 6))]
    distance_m: _Number | None
    ideal_distance_m: _Number
    deviation: Annotated[_Deviation, Field(alias="deviation_m"), WrapSerializer(_or_nulls)]
    yaw_change_rad: Annotated[_Angle | None, Field(alias="yaw_change_deg")]
    turned_rad: Annotated[_Angle, Field(alias="self_rotation_deg")]
    status: Annotated[_Text, Field(pattern=f"^({'|'.join(STATUSES)})$")]
    stopped: _Text | None
    clipped_ticks: _Count
    cause: _Text | None = None
    turn_miss_rad: Annotated[_Angle | None, Field(alias="turn_miss_deg")] = None
    hold: _Text = "none"
    hold_caveat: _Text | None = None
    hold_lost_s: _Number = 0.0
    limited_ticks: _Count = 0
    true_deviation: Annotated[_Deviation, Field(alias="true_deviation_m")] = None
    true_distance_m: _Number | None = None
    energy_j: _Number | None = None
    cost_of_transport: _Number | None = None
    tilt_deg: _Number | None = None
    steadiness: _Number | None = None
    trim_rad: Annotated[_Angle | None, Field(alias="trim_deg")] = None
    turn_trim_rad_s: Annotated[_Angle | None, Field(alias="turn_trim_deg_s")] = None
    noticed: tuple[_Noticed, ...] = ()
    warnings: tuple[_Text, ...] = ()
    controller: Annotated[_Text | None, Field(exclude_if=lambda name: name is None)] = field(
        default=None, compare=False
    )
    path_m: _Path = field(default_factory=lambda: np.zeros((0, 2)))
    true_path_m: Annotated[FloatArray | None, Field(exclude=True)] = field(default=None, compare=False)

    @property
    def valid(self) -> bool:
        """Whether the trial may be ranked by its deviation."""
        return self.status == "ok" and self.deviation is not None

    def to_dict(self, *, path: bool = False) -> dict[str, Any]:
        """JSON values, angles in degrees; `controller` only for a custom one, the path if asked for."""
        values: dict[str, Any] = _json().dump_python(
            self, mode="json", by_alias=True, exclude=None if path else {"path_m"}, warnings=False
        )
        return values

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "TrialResult":
        """Inverse of `to_dict`, angles up to rounding; raises InputError for anything else."""
        try:
            return _json().validate_python(data)
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            why = f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}".removeprefix(": ")
            raise InputError(f"trial result: {why}; allowed: what `to_dict` gives") from error
        except (KeyError, TypeError, AttributeError, OverflowError) as error:
            raise InputError(f"trial result: got {error!r}; allowed: what `to_dict` gives") from error

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


@cache
def _json() -> TypeAdapter[TrialResult]:
    """Reads and writes results as JSON values; made once, when needed."""
    return TypeAdapter(TrialResult)
