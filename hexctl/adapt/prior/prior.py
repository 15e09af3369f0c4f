"""A prior: the outcomes of all gaits of each failed leg in many simulated worlds."""

import math
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.space import GaitSpace
from hexctl.archive import ArchiveKind, content_digest
from hexctl.control.planning.static_stability import stood_up
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.posture import STANCE
from hexctl.options import Range
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, BoolArray, FloatArray

#: A shorter walk consists mostly of the soft start.
PRIOR_DURATION_S = Range(low=6, unit="s")

#: Walks last multiples of this: the ten checkpoints then fall on kept points of the path, five per second.
WHOLE_S = 2.0


def in_whole_steps(duration_s: float) -> bool:
    """Whether a finite duration is a multiple of `WHOLE_S`."""
    return abs(duration_s / WHOLE_S - round(duration_s / WHOLE_S)) < 1e-9


@dataclass(frozen=True, kw_only=True)
class PriorKey:
    """Purpose of a prior: a robot, a kind of failure and a trial. It fits sessions with an equal key.

    Attributes:
        failure: as the command line writes it, for any leg.
        self_rotation: direction of the failed leg during the walk.
        heading_deg: direction of travel in the body frame; 0 after a self-rotation.
        posture: one of `hexctl.control.planning.static_stability.POSTURES`.
    """

    robot: str
    robot_fingerprint: str
    failure: str
    self_rotation: str
    heading_deg: float
    duration_s: float
    pace_hz: float
    amplitude: float
    height: float
    hold: str
    posture: str

    @classmethod
    def of(cls, robot: Robot, plan: TrialPlan) -> "PriorKey":
        """Key of a session's trials; the hold `auto` of a plan counts as `line`, its best case."""
        gait = plan.gait
        return cls(
            robot=robot.name,
            robot_fingerprint=robot.fingerprint,
            failure=str(next(iter(plan.failures), None)),
            self_rotation=plan.self_rotation,
            heading_deg=math.degrees(plan.heading_rad) if plan.self_rotation == "none" else 0.0,
            duration_s=plan.duration_s,
            pace_hz=gait.pace_hz,
            amplitude=gait.amplitude,
            height=gait.height,
            hold="line" if plan.hold == "auto" else plan.hold,
            posture=_posture_of(robot, plan),
        )

    def as_json(self) -> dict[str, Any]:
        """The key as plain JSON values."""
        return asdict(self)

    def differences(self, other: "PriorKey") -> list[str]:
        """Differences of another key, a few words each; empty for an equal one."""
        found = []
        for name, mine in asdict(self).items():
            theirs = getattr(other, name)
            if mine == theirs:
                continue
            if name == "robot_fingerprint":
                if self.robot == other.robot:
                    found.append(f"another description of {self.robot}")
                continue
            label, unit = _LABELS.get(name, (name, ""))
            found.append(f"{label} {_short(mine)}{unit}, not {_short(theirs)}{unit}")
        return found


def _posture_of(robot: Robot, plan: TrialPlan) -> str:
    """Name of the posture of a plan's gait; under a hold `auto`, if that is as good a name."""
    posture, flat = plan.gait.posture, replace(plan, gait=replace(plan.gait, posture=STANCE))
    if plan.hold != "none" and posture == stood_up(robot, flat):
        return "auto"
    return "stance" if posture == STANCE else f"raised by {posture.body_raise:g}"


_LABELS = {
    "self_rotation": ("self-rotation", ""),
    "heading_deg": ("heading", " deg"),
    "duration_s": ("duration", " s"),
    "pace_hz": ("pace", " Hz"),
}


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


#: Points of a walk that are kept, evenly spread, the last one at its end.
CHECKPOINTS = 10

_ARRAYS = ("signed_m", "progress_m", "yaw_rad")

#: The optional array.
_STANDING = "sag_rad"


#: Half precision is 2 mm at 4 m and finer nearer to the line: below what a simulation is good for.
STORED = np.float16


#: Objectives of steered walks, in the order of a score prior's last axis.
SCORES = ("speed", "cost", "tilt", "steadiness")


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcomes(ABC):
    """Simulated outcomes for one key; row i belongs to `legs[i]`, ascending, gait j to code j + 1.

    `origin` is for people: family of worlds, versions.
    """

    #: Version of its file.
    version: ClassVar[int]

    key: PriorKey
    legs: tuple[int, ...]
    origin: dict[str, Any]

    @property
    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays in their stored form, by name."""

    @property
    def worlds(self) -> int:
        """Number of worlds in which each leg has walked."""
        return int(next(iter(self.arrays.values())).shape[1])

    @property
    def head(self) -> dict[str, Any]:
        """All except the arrays, as JSON values."""
        return {"question": self.key.as_json(), "legs": list(self.legs), "origin": self.origin}

    @cached_property
    def digest(self) -> str:
        """Hash of the complete content."""
        return content_digest(self.head, self.arrays)

    def _check_shapes(self, **last: tuple[int, ...]) -> None:
        """Raise ValueError unless arrays have the shape (legs, worlds, gaits) and the given one."""
        first: FloatArray = getattr(self, next(iter(last)))
        worlds = first.shape[1] if first.ndim > 1 else 0
        for name, more in last.items():
            got, wanted = getattr(self, name).shape, (len(self.legs), worlds, GaitSpace((1,)).size, *more)
            if got != wanted or not worlds or not self.legs:
                raise ValueError(f"{name} has shape {got}, expected {wanted}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior(Outcomes):
    """Ends of open-loop walks.

    Attributes:
        signed_m: deviation at the checkpoints, positive to the left, (legs, worlds, gaits, CHECKPOINTS); NaN
            after the end of a walk.
        progress_m: distance along the heading, in the same form.
        yaw_rad: turn of the body at the end, or NaN, (legs, worlds, gaits).
        sag_rad: static deflection of the joints in the stance before any turn, (legs, worlds, 18); None if
            unknown.
    """

    version: ClassVar[int] = 1

    signed_m: FloatArray
    progress_m: FloatArray
    yaw_rad: FloatArray
    sag_rad: FloatArray | None = None

    def __post_init__(self) -> None:
        self._check_shapes(signed_m=(CHECKPOINTS,), progress_m=(CHECKPOINTS,), yaw_rad=())
        wanted = (len(self.legs), self.signed_m.shape[1], N_JOINTS)
        if self.sag_rad is not None and self.sag_rad.shape != wanted:
            raise ValueError(f"sag_rad has shape {self.sag_rad.shape}, expected {wanted}")

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Its arrays in half precision, by name."""
        names = _ARRAYS if self.sag_rad is None else (*_ARRAYS, _STANDING)
        return {name: getattr(self, name).astype(STORED) for name in names}


@dataclass(frozen=True, kw_only=True, eq=False)
class ScorePrior(Outcomes):
    """Scores of steered walks.

    Attributes:
        log_scores: natural logarithm of the score by each objective of `SCORES`, (legs, worlds, gaits, 4);
            NaN for a walk that did not last, or without progress.
        valid: whether the walk was, (legs, worlds, gaits).
    """

    version: ClassVar[int] = 2

    log_scores: FloatArray
    valid: BoolArray

    def __post_init__(self) -> None:
        self._check_shapes(log_scores=(len(SCORES),), valid=())

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays in their stored form, by name."""
        return {"log_scores": self.log_scores.astype(np.float32), "valid": self.valid.astype(np.uint8)}


#: How priors are stored.
KIND = ArchiveKind(name="prior", versions=(Prior.version, ScorePrior.version), command="hexctl prior build")


def save_prior(prior: Outcomes, path: Path) -> None:
    """Write a prior atomically; raises ArchiveFileError when the disk refuses."""
    KIND.save(path, prior.version, prior.head, prior.arrays)


def load_prior(path: Path | str) -> Prior:
    """Prior of open-loop walks from a file.

    Raises InputError for a file that is not such a prior, has another version, or is incomplete or altered.
    """
    prior = open_prior(path)
    if not isinstance(prior, Prior):
        raise KIND.refused(path, f"it is of steered walks (hold {prior.key.hold}), not of where they end")
    return prior


def load_score_prior(path: Path | str) -> ScorePrior:
    """Prior of steered walks from a file; raises InputError as `load_prior` does."""
    prior = open_prior(path)
    if not isinstance(prior, ScorePrior):
        raise KIND.refused(path, "it is of where open-loop walks end, not of steered walks")
    return prior


def open_prior(path: Path | str) -> Prior | ScorePrior:
    """Prior of either kind from a file; raises InputError as `load_prior` does."""
    return KIND.load(path, _made)


def _made(head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Prior | ScorePrior:
    what: dict[str, Any] = {"key": PriorKey(**head["question"]), "legs": tuple(head["legs"])}
    what["origin"] = head["origin"]
    if head["version"] == ScorePrior.version:
        log_scores, valid = arrays["log_scores"].astype(float), arrays["valid"].astype(bool)
        return ScorePrior(**what, log_scores=log_scores, valid=valid)
    names = (*_ARRAYS, _STANDING) if _STANDING in arrays else _ARRAYS
    what |= {name: arrays[name].astype(float) for name in names}
    return Prior(**what)
