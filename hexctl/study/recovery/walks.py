"""The walks of the recovery benchmark: simulated in chunks, and kept on disk."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hexctl.control.batch import run_sim_trials
from hexctl.control.controllers import Controller
from hexctl.control.preparation import WalkStart
from hexctl.control.result import STATUSES
from hexctl.files import atomic_write
from hexctl.study.cache import CacheError, LandscapeCache
from hexctl.study.evaluate import Progress, as_finished
from hexctl.study.recovery.episodes import Episode, RecoveryCase, RecoveryConditions
from hexctl.study.recovery.methods import METHODS, Alarm, method_of

#: What is to be walked: cases under each of some conditions.
Walked = Sequence[tuple[RecoveryConditions, Sequence[RecoveryCase]]]


def walk_episodes(
    conditions: RecoveryConditions, cases: Sequence[RecoveryCase], threads: int = 1
) -> list[Episode]:
    """Episodes of some cases of one method, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    method = method_of(cases[0].method).prepared(trials, threads)
    to_come = {id(trial.plan): trial.events for trial in trials}

    def make(start: WalkStart) -> Controller:
        return method.controller(start, [to_come[id(plan)] for plan in start.plans])

    results = run_sim_trials(trials, threads, make, apart=True)
    return [
        Episode.of(case, trial, result, trials=method.trials_before(trial.plan))
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


class EpisodeCache:
    """Episodes on disk, a file for each robot and world, beside the landscapes of a study.

    Args:
        landscapes: their cache, which takes the notes on files that are not usable.
    """

    def __init__(self, landscapes: LandscapeCache) -> None:
        self._landscapes = landscapes

    def path_of(self, conditions: RecoveryConditions) -> Path:
        """File of the episodes under some conditions."""
        return self._landscapes.folder / f"recovery-{conditions.number}-{conditions.fingerprint}.json"

    def load(self, conditions: RecoveryConditions) -> dict[RecoveryCase, Episode]:
        """Episodes as saved; empty where there is no usable file. Methods of one's own are never kept."""
        path = self.path_of(conditions)
        if not path.exists():
            return {}
        try:
            episodes = [_episode_from(values) for values in json.loads(path.read_text(encoding="utf-8"))]
        except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
            reason = " ".join(str(error).split())
            self._landscapes.notes.append(f"{path}: not usable ({reason}); it is computed again")
            return {}
        return {episode.case: episode for episode in episodes}

    def save(self, conditions: RecoveryConditions, episodes: Iterable[Episode]) -> None:
        """Replace the file of some conditions; raises CacheError when the disk refuses."""
        path = self.path_of(conditions)
        kept = [asdict(episode) for episode in episodes if episode.case.method in METHODS]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, json.dumps(kept))
        except OSError as error:
            raise CacheError(f"study cache: {path} cannot be written: {error}") from error

    def count(self, walked: Walked) -> tuple[int, int]:
        """Number of episodes saved, and of all episodes, of what is to be walked."""
        saved = 0
        for conditions, cases in walked:
            known = self.load(conditions)
            saved += sum(case in known for case in cases)
        return saved, sum(len(cases) for _, cases in walked)


def _episode_from(values: dict[str, Any]) -> Episode:
    """Episode of its values in a file; raises ValueError for what no simulation gives."""
    case = values["case"]
    episode = Episode(
        **values
        | {
            "case": RecoveryCase(**case | {"legs": tuple(case["legs"])}),
            "alarms": tuple(Alarm(**alarm) for alarm in values["alarms"]),
        }
    )
    numbers = (episode.signed_m, episode.way_m, episode.ideal_m_s, episode.after_m_s, episode.last_m_s)
    if episode.status not in STATUSES or not all(isinstance(value, float) for value in numbers):
        raise ValueError("it has values that no simulation gives")
    if episode.ended and not math.isfinite(episode.signed_m):
        raise ValueError("it has walks without an end")
    return episode


@dataclass(frozen=True, kw_only=True)
class _Chunk:
    """Cases that are simulated together: those of one method and gait under one set of conditions."""

    conditions: RecoveryConditions
    cases: tuple[RecoveryCase, ...]

    def walk(self, threads: int) -> tuple["_Chunk", list[Episode]]:
        """The chunk and its episodes."""
        return self, walk_episodes(self.conditions, self.cases, threads)


def walk_all(
    walked: Walked, cache: EpisodeCache, progress: Progress, jobs: int | None = None
) -> list[tuple[RecoveryConditions, Episode]]:
    """All episodes of some cases, simulated where the cache lacks them.

    When this is interrupted, what has finished, method by method in each world, is in the cache, and another
    call continues from there.

    Args:
        walked: conditions and their cases.
        cache: of the episodes.
        progress: observer.
        jobs: threads that simulate; None is all cores.

    Raises CacheError when episodes cannot be saved.
    """
    known = {one.fingerprint: cache.load(one) for one, _ in walked}
    todo = [chunk for one, cases in walked for chunk in _chunks(one, cases, known[one.fingerprint])]
    wanted = {one.fingerprint: cases for one, cases in walked}
    left, total = sum(len(chunk.cases) for chunk in todo), sum(len(cases) for _, cases in walked)
    if left < total:
        progress.note(f"{total - left} of {total} walks: from the cache")
    progress.stage("walks (Ctrl-C stops, the same command continues)", left)
    for chunk, episodes in as_finished([chunk.walk for chunk in todo], jobs):
        place = chunk.conditions
        saved = known[place.fingerprint]
        saved.update((episode.case, episode) for episode in episodes)
        cache.save(place, saved.values())
        for _ in episodes:
            progress.step()
        if all(case in saved for case in wanted[place.fingerprint]):
            progress.note(f"{place.title}: {len(wanted[place.fingerprint])} walks")
    return [(one, known[one.fingerprint][case]) for one, cases in walked for case in cases]


def _chunks(
    conditions: RecoveryConditions, cases: Sequence[RecoveryCase], known: dict[RecoveryCase, Episode]
) -> Iterator[_Chunk]:
    """Chunks of the cases that are not known, method by method and gait by gait."""
    groups: dict[tuple[str, str], list[RecoveryCase]] = {}
    for case in cases:
        if case not in known:
            groups.setdefault((case.method, case.gait), []).append(case)
    for group in groups.values():
        yield _Chunk(conditions=conditions, cases=tuple(group))
