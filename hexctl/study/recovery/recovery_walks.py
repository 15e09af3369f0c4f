"""The walks of the recovery benchmark: simulated in chunks, and kept on disk."""

import math
from collections.abc import Sequence
from typing import Any

from hexctl.control.batch import run_sim_trials
from hexctl.control.controllers import Controller
from hexctl.control.custom_controller import StepFunction
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_result import STATUSES
from hexctl.study.landscapes.benchmark_walks import WalkCache, Walked
from hexctl.study.landscapes.benchmark_walks import walk_all as all_walks
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import Progress
from hexctl.study.recovery.episodes import Episode, RecoveryCase, RecoveryConditions
from hexctl.study.recovery.methods import METHODS, Alarm, method_of


def walk_episodes(
    conditions: RecoveryConditions, cases: Sequence[RecoveryCase], threads: int = 1
) -> list[Episode]:
    """Episodes of some cases of one method, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    method = method_of(cases[0].method).prepared(trials, threads)
    to_come = {id(trial.plan): trial.events for trial in trials}

    def make(start: WalkStart) -> Controller | StepFunction:
        return method.controller(start, [to_come[id(plan)] for plan in start.plans])

    results = run_sim_trials(trials, threads, make, apart=True)
    return [
        Episode.of(case, trial, result, trials=method.trials_before(trial.plan))
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


class EpisodeCache(WalkCache[RecoveryConditions, RecoveryCase, Episode]):
    """Episodes on disk, a file for each robot and world. Methods of one's own are never kept.

    Args:
        landscapes: cache beside which they are, which takes the notes on files that are not usable.
    """

    def __init__(self, landscapes: LandscapeCache) -> None:
        super().__init__(
            landscapes, name="recovery", read=_episode_from, keeps=lambda one: one.case.method in METHODS
        )


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


def walk_all(
    walked: Walked[RecoveryConditions, RecoveryCase],
    cache: EpisodeCache,
    progress: Progress,
    jobs: int | None = None,
) -> list[tuple[RecoveryConditions, Episode]]:
    """All episodes of some cases, method by method in each world, as `landscapes.walks` has it."""
    return all_walks(walked, cache, walk_episodes, _chunk_of, progress, jobs)


def _chunk_of(case: RecoveryCase) -> tuple[object, ...]:
    """What cases that are simulated together have in common; those with trials of their own are fewer."""
    return case.method, case.gait, case.legs if method_of(case.method).makes_trials else ()
