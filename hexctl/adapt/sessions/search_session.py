"""A session: the spec of one adaptation, its walks, and which of them to recommend or to confirm.

The end of a walk is that of its confirmation by a walk at a finer time step, else its own, each with its own
uncertainty. A repeat confirms a trimmed trial. Walks of the baseline need no search.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE, Objective, undominated
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import (
    BaselineRecord,
    ConfirmationRecord,
    TrialRecord,
    WalkRecord,
)
from hexctl.control.scoring.uncertainty_store import DISTINCT

#: Differences of scores below this, 0.5 mm, are never resolved, also if no uncertainty is known.
LEAST_DIFFERENCE = 0.0005

#: Most trials of a session whose ends are confirmed; each confirmation takes some seconds.
MOST_CONFIRMED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """A trial or walk of the baseline that may be recommended, and its confirmation, or None.

    `score` is that of the confirmation, else of the walk, `uncertainty_m` its standard uncertainty, 0 if
    unknown.
    """

    walk: TrialRecord | BaselineRecord
    score: float
    uncertainty_m: float
    confirmation: ConfirmationRecord | TrialRecord | None

    @property
    def searched(self) -> bool:
        """Whether its walk is a trial, not one of the baseline."""
        return isinstance(self.walk, TrialRecord)

    @property
    def preference(self) -> tuple[bool, float, float]:
        """Order among walks that are not resolved: no search, then the larger margin, then the score."""
        margin_m = -math.inf if self.walk.margin_m is None else self.walk.margin_m
        return self.searched, -margin_m, self.score

    def resolution_m(self, other: "Contender") -> float:
        """Minimum difference between two scores that is resolved with 95 % confidence."""
        known_m = DISTINCT * math.hypot(self.uncertainty_m, other.uncertainty_m) / math.sqrt(2.0)
        return max(known_m, LEAST_DIFFERENCE)


def _straightest(found: Iterable[Contender]) -> Contender | None:
    return min(found, key=lambda one: one.score, default=None)


def trials_text(count: int) -> str:
    """Number of trials in words: `1 trial`, `2 trials`."""
    return f"{count} trial" + ("" if count == 1 else "s")


@dataclass(slots=True, kw_only=True)
class Session:
    """A session, to which trials are added one by one.

    Attributes:
        name: unique in its store; also the name of its folder.
        optimizer_state: the state after the last trial, or None before the first.
        created: ISO 8601.
        ended: why its search ended, as `AdaptLoop.run` returns it; None while it can be resumed.
        settled_on: gait that the optimizer recommends and its `Prediction.as_json`, or None.
        baseline: walks with the robot's usual gaits, before the first trial.
        confirmations: walks at a finer time step that confirm a gait, without a trim.
        stored_bytes: last known size of its file.
    """

    name: str
    spec: SessionSpec
    created: str
    trials: list[TrialRecord] = field(default_factory=list)
    optimizer_state: dict[str, Any] | None = None
    settled_on: dict[str, Any] | None = None
    ended: str | None = None
    baseline: list[BaselineRecord] = field(default_factory=list)
    confirmations: list[ConfirmationRecord] = field(default_factory=list)
    stored_bytes: int = field(default=0, compare=False, repr=False)

    def confirmation_of(self, walk: WalkRecord) -> ConfirmationRecord | TrialRecord | None:
        """The walk that confirms the gait of another walk with its trim, or None."""
        walks: list[ConfirmationRecord | TrialRecord] = [*self.confirmations]
        if self.spec.optimizer == TRIM:
            walks += (trial for trial in self.trials if trial.confirms)
        return next((one for one in walks if one.commanded == walk.commanded), None)

    @property
    def walked_s(self) -> float:
        """Seconds walked in the baseline, the trials and the confirmations."""
        walks = (*self.baseline, *self.trials, *self.confirmations)
        return float(sum(walk.outcome["duration_s"] for walk in walks))

    @property
    def best(self) -> TrialRecord | None:
        """The valid trial with the lowest score, the earliest of equals; None without a valid trial."""
        valid = [trial for trial in self.trials if trial.valid]
        return min(valid, key=lambda trial: trial.score) if valid else None

    @property
    def met_target(self) -> bool:
        """Whether a trial is within the target."""
        target_m = self.spec.target_m
        return target_m is not None and any(trial.score <= target_m for trial in self.trials)

    @property
    def best_walk(self) -> TrialRecord | BaselineRecord | None:
        """The recommended walk."""
        found = self.recommended
        return None if found is None else found.walk

    @property
    def recommended(self) -> Contender | None:
        """The walk to recommend; None before the first valid trial and baseline.

        Among the straightest, unresolved walks, those without a search come first, then the maximum static
        stability margin.
        """
        return min(self._unresolved(), key=lambda one: one.preference, default=None)

    @property
    def straightest_baseline(self) -> Contender | None:
        """The straightest walk of the baseline; None without a valid one."""
        return _straightest(one for one in self.contenders() if not one.searched)

    @property
    def next_to_confirm(self) -> Contender | None:
        """The straightest candidate without a confirmation; None if all are confirmed.

        At a coarse time step a walk of the baseline may end elsewhere by more than was measured on the flat
        floor. All are confirmed, unless none could be resolved as straighter than the recommendation.
        """
        found = self.recommended
        if not self.spec.confirmed_uncertainty_m or found is None:
            return None
        if unconfirmed := [one for one in self._unresolved() if one.confirmation is None]:
            return _straightest(unconfirmed)
        if not found.uncertainty_m or found.score <= found.resolution_m(found):
            return None
        return _straightest(one for one in self.contenders() if not (one.searched or one.confirmation))

    def contenders(self) -> list[Contender]:
        """Valid walks of the baseline, and the straightest trial; none before a trial, if there is one.

        Of the trials only the confirmed ones count once there are enough.
        """
        if not self.trials:
            return []
        trials = self._valid(self.trials)
        confirmed = [trial for trial in trials if trial.confirmation is not None]
        if len({trial.walk.commanded for trial in confirmed}) >= MOST_CONFIRMED:
            trials = confirmed
        best = _straightest(trials)
        return [*self._valid(self.baseline), *([] if best is None else [best])]

    def _unresolved(self) -> list[Contender]:
        """The straightest walk, and those that are not resolved from it."""
        found = self.contenders()
        lowest = _straightest(found)
        if lowest is None:
            return []
        return [one for one in found if abs(one.score - lowest.score) <= one.resolution_m(lowest)]

    def _valid(self, walks: Sequence[TrialRecord | BaselineRecord]) -> list[Contender]:
        found = [self._contender(walk) for walk in walks]
        return [one for one in found if one.score < INVALID_SCORE]

    def _contender(self, walk: TrialRecord | BaselineRecord) -> Contender:
        spec, confirmation = self.spec, self.confirmation_of(walk)
        finer = isinstance(confirmation, ConfirmationRecord)
        uncertainty_m = spec.confirmed_uncertainty_m if finer else spec.uncertainty_m
        return Contender(
            walk=walk,
            score=walk.score if confirmation is None else confirmation.score,
            uncertainty_m=uncertainty_m if spec.objective == "final" else 0.0,
            confirmation=confirmation,
        )

    def pareto(self, objectives: Sequence[Objective]) -> list[tuple[TrialRecord, list[float]]]:
        """Pareto front of the valid trials with their scores, sorted by the first one.

        Raises InputError if a trial did not measure what an objective needs.
        """
        valid = [trial for trial in self.trials if trial.valid]
        scores = np.array([[objective(trial.result) for objective in objectives] for trial in valid])
        front = [(valid[row], scores[row].tolist()) for row in np.flatnonzero(undominated(scores)).tolist()]
        return sorted(front, key=lambda pair: pair[1])

    def _trials_to(self, milestone_m: float) -> int | None:
        """Index of the first trial with a score within a milestone; None without one, or a score in m."""
        if self.spec.objective_unit != "m":
            return None
        return next((trial.index for trial in self.trials if trial.score <= milestone_m), None)

    @property
    def within_target(self) -> float | None:
        """Probability that the recommended gait ends within the target; None if its end is not confirmed.

        Trimmed walks of a simulation are as fine as the walks that confirm others.
        """
        found, target_m = self.recommended, self.spec.target_m
        if found is None or target_m is None:
            return None
        if found.confirmation is None and not (self.spec.optimizer == TRIM and found.uncertainty_m):
            return None
        if not found.uncertainty_m:
            return float(found.score <= target_m)
        reach_m = math.sqrt(2.0) * found.uncertainty_m
        below, above = (target_m - found.score) / reach_m, (target_m + found.score) / reach_m
        return 0.5 * (math.erf(below) + math.erf(above))

    def _recommended_json(self) -> dict[str, Any] | None:
        found = self.recommended
        if found is None:
            return None
        walk = found.walk
        return {
            "gait": walk.gait if isinstance(walk, BaselineRecord) else None,
            "code": walk.code,
            "slots": list(walk.slots),
            "trim_deg": walk.outcome["trim_deg"],
            "turn_trim_deg_s": walk.outcome["turn_trim_deg_s"],
            "score": found.score,
            "uncertainty_m": found.uncertainty_m or None,
            "confirmed": found.confirmation is not None,
            "within_target": self.within_target,
        }

    def as_json(self) -> dict[str, Any]:
        """The session as `hexctl adapt --json` prints it."""
        best = self.best
        return {
            "session": self.name,
            "created": self.created,
            **self.spec.as_json(),
            "baseline": [walk.as_json() for walk in self.baseline],
            "trials": [trial.as_json() for trial in self.trials],
            "best": None if best is None else best.as_json(),
            "found": best is not None,
            "walked_s": round(self.walked_s, 3),
            "settled_on": self.settled_on,
            "confirmations": [walk.as_json() for walk in self.confirmations],
            "recommended": self._recommended_json(),
            "ended": self.ended,
            "trials_to_0.10_m": self._trials_to(0.10),
            "trials_to_0.025_m": self._trials_to(0.025),
        }
