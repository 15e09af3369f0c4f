"""The interface of all optimizers: ask for codes, tell their scores, save and restore exactly."""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar

import numpy as np

from hexctl.adapt.space import GaitSpace
from hexctl.control.planning.top_speed import Stride
from hexctl.control.trial import Enough
from hexctl.control.trial_result import TrialResult
from hexctl.errors import HexctlError, InputError, argument, check_type
from hexctl.robot.plugins import label_of, why
from hexctl.types import ArrayFields, FloatArray

#: Outcomes of walks that ended early, and so say nothing about where the gait ends.
UNFINISHED = ("fell", "diverged", "cut_short", "aborted")


#: Digits of a trim in degrees.
TRIM_DIGITS = 4


@dataclass(frozen=True, slots=True)
class Trim:
    """Corrections of the course of a walk.

    Attributes:
        course_rad: correction of its course, counter-clockwise.
        turn_rad_s: in open loop, correction of its turn rate.
    """

    course_rad: float = 0.0
    turn_rad_s: float = 0.0

    @classmethod
    def rounded(cls, course_deg: float | None, turn_deg_s: float | None) -> "Trim":
        """Trim of degrees, 0 for None, rounded so that a command line repeats it exactly."""
        course, turn = (round(degrees or 0.0, TRIM_DIGITS) for degrees in (course_deg, turn_deg_s))
        return cls(math.radians(course), math.radians(turn))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observation(ArrayFields):
    """The course of one walk; its status is one of `hexctl.control.trial_result.STATUSES`.

    Attributes:
        path_m: progress and signed deviation at equal intervals, the last row at the end, (T, 2).
        yaw_change_rad: of the body; None if not measured.
        trim: that the walk had.
    """

    path_m: FloatArray
    duration_s: float
    yaw_change_rad: float | None
    status: str
    trim: Trim = Trim()

    @classmethod
    def of(cls, result: TrialResult) -> "Observation":
        """Observation of a trial."""
        return cls(
            path_m=result.path_m,
            duration_s=result.duration_s,
            yaw_change_rad=result.yaw_change_rad,
            status=result.status,
            trim=Trim(course_rad=result.trim_rad or 0.0, turn_rad_s=result.turn_trim_rad_s or 0.0),
        )

    @property
    def finished(self) -> bool:
        """Whether the walk lasted as long as planned."""
        return self.status not in UNFINISHED

    def at(self, times_s: FloatArray) -> FloatArray:
        """Rows of the path at times since the start, NaN after the end, (len(times_s), 2)."""
        rows = np.full((len(times_s), 2), np.nan)
        if len(self.path_m) == 0:
            return rows
        index = np.rint(times_s / self.duration_s * len(self.path_m)).astype(int) - 1
        walked = (index >= 0) & (index < len(self.path_m))
        rows[walked] = self.path_m[index[walked]]
        return rows


#: Half the width of a 90 % interval of the normal distribution, in standard deviations.
NINETY_PERCENT = 1.6449


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Prediction for a trial before the walk.

    Attributes:
        signed_m: expected signed final deviation, with standard deviations for the gait (`sd_m`) and one
            trial.
        chance: probability that the gait is valid and within the target.
    """

    signed_m: float
    sd_m: float
    trial_sd_m: float
    chance: float
    target_m: float

    def as_json(self) -> dict[str, Any]:
        """The prediction as plain JSON values, with the 90 % interval of the end of one trial."""
        reach_m = NINETY_PERCENT * self.trial_sd_m
        return {
            "signed_m": self.signed_m,
            "low_m": self.signed_m - reach_m,
            "high_m": self.signed_m + reach_m,
            "chance": self.chance,
            "target_m": self.target_m,
        }


class OptimizerMisuseError(HexctlError, RuntimeError):
    """Ask and tell were called out of turn."""


class Optimizer(ABC):
    """Searches a gait space for the code with the lowest score.

        optimizer = hexctl.make_optimizer("random", hexctl.GaitSpace((5,)), seed=0)
        optimizer.tell(optimizer.ask(2), [0.12, 0.07])

    `ask` and `tell` alternate; codes may repeat. An optimizer restored from `state`, JSON values with the
    random stream, continues exactly as the original would.

    A subclass sets `name` and implements `_suggest`, `_learn`, `_search_state` and `_restore_search`. It may
    override the other public methods, and `_learn_observed` instead of `_learn`, to learn from the course of
    walks.
    """

    #: Name on the command line.
    name: str

    #: True for a search whose `finished` decides when the target is reached.
    judges_target: bool = False

    #: True for a search that trims its walks, and learns from each walk of the session, by `repeat`.
    trims: bool = False

    def __init__(self, space: GaitSpace, seed: int) -> None:
        check_type(space, GaitSpace, "space", "a GaitSpace, as GaitSpace((5,))")
        check_type(seed, int, "seed", "0 or more")
        if seed < 0:
            raise InputError(f"seed: got {seed}; allowed: 0 or more")
        learning = "_learn", "_learn_observed"
        if all(getattr(type(self), name) is getattr(Optimizer, name) for name in learning):
            got = f"{argument('optimizer')}: got {type(self).__qualname__}, which does not learn"
            raise InputError(f"{got}; allowed: a class that implements {' or '.join(learning)}")
        self.space = space
        self._random = np.random.default_rng(seed)
        self._asked: list[int] | None = None

    @property
    def exhausted(self) -> bool:
        """True if no codes are left; never for searches that may repeat codes."""
        return False

    @property
    def finished(self) -> bool:
        """True if a gait is known to be good enough; most searches never know."""
        return False

    @property
    def worthwhile(self) -> bool:
        """False if another trial is not expected to gain enough; most searches never know."""
        return True

    def recommended(self) -> int | None:
        """Code that the search recommends; None if the best score decides."""
        return None

    def repeat(self, code: int, score: float, observation: Observation) -> None:
        """Learn from a walk without an ask, such as a repeat of the best gait; most searches ignore it."""
        return

    def trim(self, code: int) -> Trim | None:
        """Trim of the next walk of a gait; None from searches that correct no walks."""
        return None

    def stride(self, code: int) -> Stride | None:
        """Stride of the next walk of a gait; None for that of the robot."""
        return None

    def predict(self, code: int) -> Prediction | None:
        """Current prediction for a gait; None from searches without predictions."""
        return None

    def early_stopping(self, code: int) -> Enough | None:
        """Predicate `should_stop(path_m)` that ends a walk once its result is clear, or None."""
        return None

    def ask(self, count: int = 1) -> list[int]:
        """Next codes, one to `count`. Raises OptimizerMisuseError if those of the last ask have no scores."""
        if self._asked is not None:
            raise OptimizerMisuseError(f"{self.name}: ask after ask; tell the scores of {self._asked} first")
        if count < 1:
            raise InputError(f"{self.name}: got a request for {count} codes; allowed: 1 or more")
        suggested = self._suggest(count)
        codes = range(1, self.space.size + 1)
        if not 0 < len(suggested) <= count or not all(code in codes for code in suggested):
            raise InputError(
                f"{argument('optimizer')}: {self.name} ({label_of(type(self))}) suggested "
                f"{list(suggested)[:10]}; allowed: 1 to {count} codes from 1 to {self.space.size}"
            )
        self._asked = [int(code) for code in suggested]
        return list(self._asked)

    def tell(
        self,
        codes: Sequence[int],
        scores: Sequence[float],
        observations: Sequence[Observation | None] | None = None,
    ) -> None:
        """Take the scores of the codes of the last ask, in their order; lower is better.

        `observations` are the courses of the walks. Raises OptimizerMisuseError without an ask, InputError
        for other codes or non-finite scores, without any change.
        """
        if self._asked is None:
            raise OptimizerMisuseError(f"{self.name}: tell without ask")
        if list(codes) != self._asked or len(scores) != len(self._asked):
            raise InputError(
                f"{self.name}: got {len(scores)} scores for codes {list(codes)}; "
                f"allowed: one for each of {self._asked}"
            )
        if not all(isinstance(score, Real) and math.isfinite(score) for score in scores):
            raise InputError(f"{self.name}: got scores {list(scores)}; allowed: finite numbers")
        if observations is not None and len(observations) != len(codes):
            raise InputError(
                f"{self.name}: got {len(observations)} walks; allowed: one for each of {self._asked}"
            )
        self._asked = None
        self._learn_observed(
            [int(code) for code in codes],
            [float(score) for score in scores],
            observations or [None] * len(codes),
        )

    def state(self) -> dict[str, Any]:
        """State of the search, as JSON values; raises InputError for others in `_search_state`."""
        search = self._search_state()
        try:
            json.dumps(search)
        except (TypeError, ValueError) as error:
            got = f"{argument('optimizer')}: the state of {label_of(type(self))} cannot be stored"
            raise InputError(f"{got} ({why(error)}); allowed: JSON values from _search_state") from error
        return {
            "name": self.name,
            "failed_legs": list(self.space.failed_legs),
            "random": self._random.bit_generator.state,
            "asked": None if self._asked is None else list(self._asked),
            "search": search,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a saved state.

        Raises InputError for the state of another optimizer or another space, or a damaged one, without any
        change.
        """
        legs = state.get("failed_legs", ())
        got = (state.get("name"), tuple(legs) if isinstance(legs, (list, tuple)) else legs)
        if got != (self.name, self.space.failed_legs):
            raise InputError(f"optimizer state: got {got}; allowed: {(self.name, self.space.failed_legs)}")
        before = self.state()
        try:
            self._take_over(state)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            self._take_over(before)
            raise InputError(
                f"optimizer state of {self.name}: damaged or of another version ({error})"
            ) from error

    def _take_over(self, state: dict[str, Any]) -> None:
        self._random.bit_generator.state = state["random"]
        self._asked = None if state["asked"] is None else [int(code) for code in state["asked"]]
        self._restore_search(state["search"])

    @abstractmethod
    def _suggest(self, count: int) -> list[int]:
        """Codes to try next: one to `count` of them."""

    def _learn_observed(
        self, codes: list[int], scores: list[float], observations: Sequence[Observation | None]
    ) -> None:
        """Learn from scores and courses of the suggested codes; most searches need only the scores."""
        self._learn(codes, scores)

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        """Learn from the scores of the suggested codes, unless `_learn_observed` does."""
        raise NotImplementedError

    @abstractmethod
    def _search_state(self) -> dict[str, Any]:
        """State of the search itself, as JSON values."""

    @abstractmethod
    def _restore_search(self, state: dict[str, Any]) -> None:
        """Restore the result of `_search_state`."""


class TaughtOptimizer(Optimizer):
    """An optimizer whose state is the facts of its walks; `restore` learns them again."""

    #: Key of the walks in the state.
    walks_key: ClassVar[str] = "trials"

    def repeat(self, code: int, score: float, observation: Observation) -> None:
        """Learn from a walk without an ask."""
        self._take([code, *self._facts(score, observation)])

    def _learn_observed(
        self, codes: list[int], scores: list[float], observations: Sequence[Observation | None]
    ) -> None:
        for code, score, one in zip(codes, scores, observations, strict=True):
            self._take([code, *self._facts(score, one)])

    def _take(self, trial: list[Any]) -> None:
        first, *facts = trial
        code = int(first)
        if not 1 <= code <= self.space.size:
            raise ValueError(f"a walk of code {code}")
        self._trials.append([code, *facts])
        self._observe(code, *facts)

    def _forget(self) -> None:
        """Believe what was believed before any walk; a subclass adds its own belief."""
        self._trials: list[list[Any]] = []

    @abstractmethod
    def _facts(self, score: float, observation: Observation | None) -> list[Any]:
        """What is to be kept of a walk, as JSON values."""

    @abstractmethod
    def _observe(self, code: int, *facts: Any) -> None:
        """Learn from the facts of a walk; raises ValueError or TypeError for damaged ones."""

    def _search_state(self) -> dict[str, Any]:
        return {self.walks_key: deepcopy(self._trials)}

    def _restore_search(self, state: dict[str, Any]) -> None:
        trials = deepcopy(list(state[self.walks_key]))
        self._forget()
        for trial in trials:
            self._take(trial)


#: Makes a fresh optimizer from a space and a seed; an `Optimizer` class is one.
OptimizerClass = Callable[[GaitSpace, int], Optimizer]

#: An optimizer as users name it: a name of the registry, `package.module:Class`, or the class.
OptimizerChoice = str | type[Optimizer]
