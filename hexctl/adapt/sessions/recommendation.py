"""Which walk of a session to recommend, and which ends to confirm by a walk at a finer time step first.

The end of a walk is that of its confirmation, else its own, each with its own uncertainty. A repeat confirms
a trimmed trial. Walks of the baseline need no search.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, TrialRecord
from hexctl.control.assessment.uncertainty_store import DISTINCT

if TYPE_CHECKING:
    from hexctl.adapt.sessions.search_session import Session

#: Walks that may be recommended.
Walk = TrialRecord | BaselineRecord

#: Differences of scores below this, 0.5 mm, are never resolved, also if no uncertainty is known.
LEAST_DIFFERENCE = 0.0005

#: Most trials of a session whose ends are confirmed; each confirmation takes some seconds.
MOST_CONFIRMED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Contender:
    """A trial (`searched`) or walk of the baseline that may be recommended, and its confirmation, or None.

    `score` is that of the confirmation, else of the walk, `uncertainty_m` its standard uncertainty, 0 if
    unknown.
    """

    walk: Walk
    searched: bool
    score: float
    uncertainty_m: float
    confirmation: ConfirmationRecord | TrialRecord | None

    @property
    def preference(self) -> tuple[bool, float, float]:
        """Order among walks that are not resolved: no search, then the larger margin, then the score."""
        margin_m = -math.inf if self.walk.margin_m is None else self.walk.margin_m
        return self.searched, -margin_m, self.score

    def resolved_from(self, other: "Contender") -> bool:
        """Whether two scores differ by more than their uncertainties, with 95 % confidence."""
        return abs(self.score - other.score) > resolution_m(self, other)


def resolution_m(one: Contender, other: Contender) -> float:
    """Minimum difference between two scores that is resolved with 95 % confidence."""
    known_m = DISTINCT * math.hypot(one.uncertainty_m, other.uncertainty_m) / math.sqrt(2.0)
    return max(known_m, LEAST_DIFFERENCE)


def recommended(session: "Session") -> Contender | None:
    """The walk to recommend; None before the first valid trial and baseline.

    Among the straightest, unresolved walks, those without a search come first, then the maximum static
    stability margin.
    """
    return min(_unresolved(session), key=lambda one: one.preference, default=None)


def next_to_confirm(session: "Session") -> Contender | None:
    """The straightest candidate without a confirmation; None if all are confirmed.

    At a coarse time step a walk of the baseline may end elsewhere by more than was measured on the flat
    floor. All are confirmed, unless none could be resolved as straighter.
    """
    if not session.spec.confirmed_uncertainty_m:
        return None
    return _unconfirmed(_unresolved(session)) or _unconfirmed(_baseline_to_beat(session))


def _unconfirmed(found: Iterable[Contender]) -> Contender | None:
    return _straightest(one for one in found if one.confirmation is None)


def _baseline_to_beat(session: "Session") -> list[Contender]:
    """Walks of the baseline, if one may be straighter than the recommendation; else none."""
    found = recommended(session)
    if found is None or not found.uncertainty_m or found.score <= resolution_m(found, found):
        return []
    return [one for one in contenders(session) if not one.searched]


def straightest_baseline(session: "Session") -> Contender | None:
    """The straightest walk of the baseline; None without a valid one."""
    return _straightest(one for one in contenders(session) if not one.searched)


def contenders(session: "Session") -> list[Contender]:
    """Valid walks of the baseline, and the straightest trial; none before a trial, if there is one."""
    if not session.trials:
        return []
    baseline = _valid(_contender(session, walk, searched=False) for walk in session.baseline)
    best = _straightest(_trials(session))
    return baseline if best is None else [*baseline, best]


def _trials(session: "Session") -> list[Contender]:
    """Valid trials; only the confirmed ones once there are enough."""
    trials = _valid(_contender(session, trial, searched=True) for trial in session.trials)
    confirmed = [trial for trial in trials if trial.confirmation is not None]
    known = {trial.walk.commanded for trial in confirmed}
    return confirmed if len(known) >= MOST_CONFIRMED else trials


def _unresolved(session: "Session") -> list[Contender]:
    found = contenders(session)
    lowest = _straightest(found)
    return [one for one in found if lowest is not None and not one.resolved_from(lowest)]


def _contender(session: "Session", walk: Walk, *, searched: bool) -> Contender:
    spec, confirmation = session.spec, session.confirmation_of(walk)
    finer = isinstance(confirmation, ConfirmationRecord)
    uncertainty_m = spec.confirmed_uncertainty_m if finer else spec.uncertainty_m
    return Contender(
        walk=walk,
        searched=searched,
        score=walk.score if confirmation is None else confirmation.score,
        uncertainty_m=uncertainty_m if spec.objective == "final" else 0.0,
        confirmation=confirmation,
    )


def _valid(found: Iterable[Contender]) -> list[Contender]:
    return [one for one in found if one.score < INVALID_SCORE]


def _straightest(found: Iterable[Contender]) -> Contender | None:
    return min(found, key=lambda one: one.score, default=None)
