"""A session: the spec of one adaptation, and its walks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hexctl.adapt.objectives import Objective, undominated
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.sessions.recommendation import recommended
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import (
    BaselineRecord,
    ConfirmationRecord,
    TrialRecord,
    WalkRecord,
)


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

    def confirmation_of(self, found: WalkRecord) -> ConfirmationRecord | TrialRecord | None:
        """The walk that confirms the gait of another walk with its trim, or None."""
        walks: list[ConfirmationRecord | TrialRecord] = [*self.confirmations]
        if self.spec.optimizer == TRIM:
            walks += (trial for trial in self.trials if trial.confirms)
        return next((walk for walk in walks if walk.commanded == found.commanded), None)

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
        found = recommended(self)
        return None if found is None else found.walk

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
        found, target_m = recommended(self), self.spec.target_m
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
        found = recommended(self)
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
