"""Stored walks of a session: trials, the baseline, and confirmations of a gait."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Trim
from hexctl.control.planning.top_speed import Stride
from hexctl.control.trial_result import QUALITIES, TrialResult
from hexctl.gait.gait import AUTO
from hexctl.types import N_LEGS


class _Plain(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False, extra="allow")


def _is_result(values: dict[str, Any]) -> dict[str, Any]:
    TrialResult.from_dict(values)
    return values


class _Expected(_Plain):
    """What `Prediction.as_json` writes and reports use."""

    signed_m: float
    low_m: float
    high_m: float
    chance: float
    target_m: float


class _Settled(_Expected):
    code: int


def _as(model: type[BaseModel]) -> AfterValidator:

    def checked(values: dict[str, Any]) -> dict[str, Any]:
        model.model_validate(values, strict=True)
        return values

    return AfterValidator(checked)


#: What an optimizer expected of a trial, as `Prediction.as_json` writes it.
Expected = Annotated[dict[str, Any], _as(_Expected)]

#: The gait that an optimizer settles on and what it expects of it.
Settled = Annotated[dict[str, Any], _as(_Settled)]

#: Progress and signed deviation; NaN where the pose is not known.
_Point = Annotated[list[Annotated[float, Field(allow_inf_nan=True)]], Field(min_length=2, max_length=2)]


#: Values of a result that `--json` and tables print.
PRINTED = (
    *("deviation_m", "distance_m", "yaw_change_deg", "status", "stopped", "clipped_ticks", "hold"),
    *(*QUALITIES, "trim_deg", "turn_trim_deg_s"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkRecord:
    """A stored walk of a session.

    Attributes:
        slots: of its gait.
        score: by the session's objective; `INVALID_SCORE` for an invalid walk.
        outcome: its result, as `TrialResult.to_dict` writes it.
        path_m: progress and signed deviation along the walk, five points a second.
        recording: path of the recording, or None.
        margin_m: minimum static stability margin of its gait over a cycle; None if unknown.
        stride: in place of the robot's; None for that.
    """

    slots: Annotated[tuple[int, ...], Field(min_length=N_LEGS, max_length=N_LEGS)]
    score: float
    outcome: Annotated[dict[str, Any], AfterValidator(_is_result)] = field(repr=False)
    path_m: list[_Point] = field(repr=False)
    recording: str | None = field(repr=False)
    margin_m: float | None = field(default=None, repr=False)
    stride: Stride | None = None

    @property
    def trim(self) -> Trim:
        """Trim of the walk; of none without one."""
        return Trim.rounded(self.outcome["trim_deg"], self.outcome["turn_trim_deg_s"])

    @property
    def commanded(self) -> tuple[tuple[int, ...], Trim, Stride | None]:
        """Slots, trim and stride, which are equal for repeats of a walk."""
        return self.slots, self.trim, self.stride

    @property
    def result(self) -> TrialResult:
        """Result of the stored walk: with five points of the path a second, and its end."""
        distance_m, signed_m = self.outcome["distance_m"], self.outcome["deviation_m"]["signed"]
        points = list(self.path_m)
        if distance_m is not None and signed_m is not None:
            points.append([distance_m, signed_m])
        return TrialResult.from_dict({**self.outcome, "path_m": points})

    @property
    def valid(self) -> bool:
        """Whether the walk counts."""
        return self.score < INVALID_SCORE

    def recording_in(self, folder: Path) -> Path | None:
        """Path of its recording in the folder of its session, existing or not; None without one.

        Only the name of the stored path counts: a store may have been moved, or come from another person.
        """
        return folder / Path(self.recording).name if self.recording else None

    def _measured_json(self) -> dict[str, Any]:
        outcome = self.outcome
        return {
            "slots": list(self.slots),
            "score": self.score if self.valid else None,
            **{name: outcome[name] for name in PRINTED},
            "walked_s": outcome["duration_s"],
            "margin_m": None if self.margin_m is None else round(self.margin_m, 4),
            "stride": None if self.stride is None else asdict(self.stride),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRecord(WalkRecord):
    """One trial of a session; index 1 is the first, `confirms` marks a repeat of the best gait.

    `expected` is the optimizer's prediction, as of `Prediction.as_json`, or None.
    """

    index: Annotated[int, Field(ge=1)]
    code: int
    confirms: bool = False
    expected: Expected | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"trial {self.index}"

    def as_json(self) -> dict[str, Any]:
        """The trial as `hexctl adapt --json` prints it."""
        return {
            "index": self.index,
            "code": self.code,
            **self._measured_json(),
            "confirms": self.confirms,
            "expected": self.expected,
            "recording": self.recording,
            "cause": self.outcome["cause"],
        }


#: The robot's usual gaits: the most stable one with the leg failed, its default one, and the tripod.
BASELINE_GAITS = (AUTO, "demo", "tripod")

#: The index of a baseline: it comes before the first trial.
BASELINE_INDEX = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class BaselineRecord(WalkRecord):
    """A walk with a usual gait such as `demo`, before the trials.

    `code` is None outside the session's gaits.
    """

    gait: str
    code: int | None

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"the baseline {self.gait}"

    def as_json(self) -> dict[str, Any]:
        """The walk as `hexctl adapt --json` prints it."""
        return {
            "gait": self.gait,
            "index": BASELINE_INDEX,
            "code": self.code,
            **self._measured_json(),
            "recording": self.recording,
            "cause": self.outcome["cause"],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfirmationRecord(WalkRecord):
    """A simulated walk that confirms a gait, no trial; `code` is None outside the session's gaits.

    `time_step_s` is the finer one of its simulation.
    """

    code: int | None
    time_step_s: Annotated[float, Field(gt=0)]

    @property
    def name(self) -> str:
        """Name in messages."""
        return f"the confirmation of gait {self.code}"

    def as_json(self) -> dict[str, Any]:
        """The walk as `hexctl adapt --json` prints it."""
        return {"code": self.code, "time_step_s": self.time_step_s, **self._measured_json()}
