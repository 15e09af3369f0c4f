"""The compared walks: simulated in chunks, and kept on disk."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hexctl.control.batch import run_sim_trials
from hexctl.control.result import STATUSES, TrialResult
from hexctl.files import atomic_write
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import Gait
from hexctl.study.cache import CacheError, LandscapeCache
from hexctl.study.evaluate import Progress, as_finished
from hexctl.study.holds.conditions import HOLDS, HoldCase, HoldConditions
from hexctl.study.holds.plan import HoldPlan

#: Statuses of walks that end on their feet and have a final deviation.
ENDED = ("ok", "no_progress")


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldWalk:
    """The outcome of one walk; deviations are those of the simulation's true pose, NaN where unknown.

    Attributes:
        case: what failed and what was held.
        slots: of the gait.
        body_raise: of the gait's posture, as a fraction of the robot's size.
        held: what the walk held.
        status: as in `hexctl.control.result.STATUSES`.
        why: why it was stopped, or the likely cause of a walk without progress; None for neither.
        duration_s: how long it walked.
        signed_m: deviation at the end, positive to the left.
        mean_m: mean of the absolute deviation on the way.
        max_m: greatest absolute deviation on the way.
        distance_m: progress along the line.
        ideal_distance_m: of a robot whose feet do not slip.
        yaw_change_rad: how far the body turned.
        clipped_ticks: ticks in which the guard changed the targets.
    """

    case: HoldCase
    slots: Slots
    body_raise: float
    held: str
    status: str
    why: str | None
    duration_s: float
    signed_m: float
    mean_m: float
    max_m: float
    distance_m: float
    ideal_distance_m: float
    yaw_change_rad: float
    clipped_ticks: int

    @classmethod
    def of(cls, case: HoldCase, gait: Gait, result: TrialResult) -> "HoldWalk":
        """Outcome of a case from the gait and the result of its trial."""
        off = result.true_deviation
        signed_m, mean_m, max_m = (math.nan,) * 3 if off is None else (off.signed, off.mean, off.max)
        return cls(
            case=case,
            slots=gait.slots,
            body_raise=float(gait.posture.body_raise),
            held=result.hold,
            status=result.status,
            why=result.stopped or result.cause,
            duration_s=float(result.duration_s),
            signed_m=float(signed_m),
            mean_m=float(mean_m),
            max_m=float(max_m),
            distance_m=_known(result.distance_m),
            ideal_distance_m=float(result.ideal_distance_m),
            yaw_change_rad=_known(result.yaw_change_rad),
            clipped_ticks=int(result.clipped_ticks),
        )

    @property
    def final_m(self) -> float:
        """Final deviation in m; NaN for a walk that did not end on its feet."""
        return abs(self.signed_m) if self.status in ENDED else math.nan

    @property
    def speed(self) -> float:
        """Progress as a share of the ideal; NaN for a walk that did not end on its feet."""
        return self.distance_m / self.ideal_distance_m if self.status in ENDED else math.nan


def _known(value: float | None) -> float:
    return math.nan if value is None else float(value)


def walk_cases(conditions: HoldConditions, cases: Sequence[HoldCase], threads: int = 1) -> list[HoldWalk]:
    """Walks of some cases, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    results = run_sim_trials(trials, threads)
    return [
        HoldWalk.of(case, trial.plan.gait, result)
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


class HoldCache:
    """Walks on disk, a file for each robot and world, beside the landscapes of a study.

    Args:
        landscapes: their cache, which takes the notes on files that are not usable.
    """

    def __init__(self, landscapes: LandscapeCache) -> None:
        self._landscapes = landscapes

    def path_of(self, conditions: HoldConditions) -> Path:
        """File of the walks under some conditions."""
        return self._landscapes.folder / f"hold-{conditions.number}-{conditions.fingerprint}.json"

    def load(self, conditions: HoldConditions) -> dict[HoldCase, HoldWalk]:
        """Walks as saved; empty where there is no usable file."""
        path = self.path_of(conditions)
        if not path.exists():
            return {}
        try:
            walks = [_walk_from(values) for values in json.loads(path.read_text(encoding="utf-8"))]
        except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
            reason = " ".join(str(error).split())
            self._landscapes.notes.append(f"{path}: not usable ({reason}); it is computed again")
            return {}
        return {walk.case: walk for walk in walks}

    def save(self, conditions: HoldConditions, walks: Iterable[HoldWalk]) -> None:
        """Replace the file of some conditions; raises CacheError when the disk refuses."""
        path = self.path_of(conditions)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, json.dumps([asdict(walk) for walk in walks]))
        except OSError as error:
            raise CacheError(f"study cache: {path} cannot be written: {error}") from error

    def count(self, plan: HoldPlan) -> tuple[int, int]:
        """Number of walks saved, and of all walks, of a plan."""
        conditions, cases = plan.conditions(), plan.cases()
        saved = sum(sum(case in walks for case in cases) for walks in map(self.load, conditions))
        return saved, len(conditions) * len(cases)


def _walk_from(values: dict[str, Any]) -> HoldWalk:
    """Walk of its values in a file; raises ValueError for what no simulation gives."""
    walk = HoldWalk(**values | {"case": HoldCase(**values["case"]), "slots": tuple(values["slots"])})
    numbers = (walk.signed_m, walk.max_m, walk.distance_m, walk.ideal_distance_m)
    if walk.status not in STATUSES or not all(isinstance(value, float) for value in numbers):
        raise ValueError("it has values that no simulation gives")
    if walk.status in ENDED and not all(map(math.isfinite, numbers)):
        raise ValueError("it has walks without an end")
    return walk


@dataclass(frozen=True, kw_only=True)
class _Chunk:
    """Cases that are simulated together: those that hold the same under one set of conditions."""

    conditions: HoldConditions
    cases: tuple[HoldCase, ...]

    def walk(self, threads: int) -> tuple["_Chunk", list[HoldWalk]]:
        """The chunk and its walks."""
        return self, walk_cases(self.conditions, self.cases, threads)


def walk_all(
    plan: HoldPlan, cache: HoldCache, progress: Progress, jobs: int | None = None
) -> list[tuple[HoldConditions, HoldWalk]]:
    """All walks of a plan, simulated where the cache lacks them.

    When this is interrupted, what has finished, hold by hold in each world, is in the cache, and another call
    continues from there.

    Args:
        plan: what to walk.
        cache: of the walks.
        progress: observer.
        jobs: threads that simulate; None is all cores.

    Raises CacheError when walks cannot be saved.
    """
    conditions, cases = plan.conditions(), plan.cases()
    known = {one.fingerprint: cache.load(one) for one in conditions}
    todo = [chunk for one in conditions for chunk in _chunks(one, cases, known[one.fingerprint])]
    left = sum(len(chunk.cases) for chunk in todo)
    total = len(conditions) * len(cases)
    if left < total:
        progress.note(f"{total - left} of {total} walks: from the cache")
    progress.stage("walks (Ctrl-C stops, the same command continues)", left)
    for chunk, walks in as_finished([chunk.walk for chunk in todo], jobs):
        saved = known[chunk.conditions.fingerprint]
        saved.update((walk.case, walk) for walk in walks)
        cache.save(chunk.conditions, saved.values())
        for _ in walks:
            progress.step()
        if all(case in saved for case in cases):
            progress.note(f"{chunk.conditions.title}: {len(cases)} walks")
    return [(one, known[one.fingerprint][case]) for one in conditions for case in cases]


def _chunks(
    conditions: HoldConditions, cases: Sequence[HoldCase], known: dict[HoldCase, HoldWalk]
) -> Iterator[_Chunk]:
    """Chunks of the cases that are not known, hold by hold."""
    for hold in HOLDS:
        missing = tuple(case for case in cases if case.hold == hold and case not in known)
        if missing:
            yield _Chunk(conditions=conditions, cases=missing)
