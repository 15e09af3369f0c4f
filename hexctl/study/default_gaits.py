"""Default gaits: where a robot with a failed leg ends without a search, with its own gait and the tripod."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.files import atomic_write
from hexctl.gait.gait import make_gait
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.landscapes.landscape import LandscapeSpec
from hexctl.study.study_plan import StudyPlan

#: Gaits of a robot that knows of no failure: its default one, and the tripod.
DEFAULT_GAITS = ("demo", "tripod")


@dataclass(frozen=True, slots=True, kw_only=True)
class DefaultWalk:
    """One walk with a gait that the robot would use anyway, under the conditions of a landscape.

    Attributes:
        leg: the failed leg.
        gait: name of the gait, one of `DEFAULT_GAITS`.
        status: as in `hexctl.control.trial_result.STATUSES`.
        signed_m: deviation at the end, positive to the left; None where unknown.
        distance_m: progress along the heading; None where unknown.
    """

    leg: int
    gait: str
    status: str
    signed_m: float | None
    distance_m: float | None

    @property
    def final_m(self) -> float | None:
        """Deviation at the end; None for an invalid walk."""
        return None if self.status != "ok" or self.signed_m is None else abs(self.signed_m)


def walk_default_gaits(
    plan: StudyPlan,
    cache: LandscapeCache,
    *,
    jobs: int | None = None,
    on_leg: Callable[[], None] = lambda: None,
) -> tuple[DefaultWalk, ...]:
    """Walks of the default gaits with each failed leg, in the world and with the self-rotation of a plan.

    They are no part of the landscapes: the tripod has no code, and the default gait only for some legs.

    Args:
        plan: the experiments.
        cache: of landscapes; walks are saved beside them.
        jobs: threads; None is all cores.
        on_leg: called after each leg.

    Raises CacheError when the walks cannot be saved.
    """
    walks: list[DefaultWalk] = []
    for leg in plan.legs:
        spec = replace(plan.searched_specs()[0], leg=leg)
        walks += _loaded(cache, spec) or _walked(cache, spec, jobs)
        on_leg()
    return tuple(walks)


def default_trial(spec: LandscapeSpec, gait: str) -> SimTrial:
    """Trial of a default gait under the conditions of a landscape."""
    trial = spec.trial(spec.codes[0])
    return replace(trial, plan=replace(trial.plan, gait=make_gait(spec.robot, gait)))


def _walked(cache: LandscapeCache, spec: LandscapeSpec, jobs: int | None) -> list[DefaultWalk]:
    trials = [default_trial(spec, gait) for gait in DEFAULT_GAITS]
    results = run_sim_trials(trials, threads=jobs or 0)
    walks = [_walk_of(spec, gait, result) for gait, result in zip(DEFAULT_GAITS, results, strict=True)]
    path = _path_of(cache, spec)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, json.dumps([asdict(walk) for walk in walks]))
    except OSError as error:
        raise CacheError(f"study cache: {path} cannot be written: {error}") from error
    return walks


def _walk_of(spec: LandscapeSpec, gait: str, result: TrialResult) -> DefaultWalk:
    return DefaultWalk(
        leg=spec.leg,
        gait=gait,
        status=result.status,
        signed_m=None if result.deviation is None else float(result.deviation.signed),
        distance_m=None if result.distance_m is None else float(result.distance_m),
    )


def _path_of(cache: LandscapeCache, spec: LandscapeSpec) -> Path:
    """File of the walks of a leg, which has the fingerprint of its landscape."""
    return cache.path_of(spec).with_suffix(".default.json")


def _loaded(cache: LandscapeCache, spec: LandscapeSpec) -> list[DefaultWalk]:
    """Walks as saved; empty when there is no usable file."""
    path = _path_of(cache, spec)
    if not path.exists():
        return []
    try:
        walks = [DefaultWalk(**values) for values in json.loads(path.read_text(encoding="utf-8"))]
        _check(walks, spec)
    except (OSError, ValueError, TypeError, AttributeError) as error:
        cache.notes.append(f"{path}: not usable ({' '.join(str(error).split())}); it is computed again")
        return []
    return walks


def _check(walks: list[DefaultWalk], spec: LandscapeSpec) -> None:
    """Raise ValueError for walks that are not those of a leg."""
    expected = [(spec.leg, gait) for gait in DEFAULT_GAITS]
    if [(walk.leg, walk.gait) for walk in walks] != expected:
        raise ValueError("it has other walks")
    for walk in walks:
        if walk.status not in STATUSES or (walk.status == "ok" and not isinstance(walk.signed_m, float)):
            raise ValueError("it has values that no simulation gives")
