"""A repertoire built from walks in plausible worlds."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hexctl.control.monitor.repertoire import Repertoire, Situation, parts_of
from hexctl.control.monitor.repertoire_store import SUFFIX, save_repertoire
from hexctl.study.landscapes.versions import code_versions
from hexctl.study.prior_building import TIME_STEP_S, begin_build
from hexctl.study.repertoire.repertoire_plan import FIRST_WORLD, RepertoirePlan, texts_of
from hexctl.study.repertoire.repertoire_walks import CandidateWalk, RepertoireCase
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Progress, walk_all


def build_repertoire(
    plan: RepertoirePlan,
    path: Path,
    *,
    cache: WalkCache | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> Repertoire:
    """Simulate the candidates of all situations in the worlds of a plan, and write the repertoire to a file.

    Simulated walks are saved while this runs: a call that was interrupted is continued by the next one.

    Args:
        plan: robot, situations and worlds.
        path: of the file, ending in `.npz`; an existing file is replaced.
        cache: earlier walks; None is the one of the command line, `runs/study-cache`.
        jobs: threads that simulate; None is all cores here, one for each chunk on a Dask worker.
        dask: address of a Dask scheduler whose workers simulate; None simulates here.
        progress: observer.

    Raises InputError for a plan, a path or an address that cannot be used, RepertoireFileError or CacheError
    when the disk refuses a file.
    """
    cache = cache or WalkCache()
    begin_build(plan, path, SUFFIX, cache, jobs)
    walks = walk_all(plan.walked(), cache, jobs=jobs, dask=dask, progress=progress)
    repertoire = repertoire_of(plan, [walk for some in walks for walk in some])
    save_repertoire(repertoire, path)
    return repertoire


def repertoire_of(plan: RepertoirePlan, walks: Sequence[CandidateWalk]) -> Repertoire:
    """Repertoire of a plan from its walks, world by world in the order of `plan.walked()`."""
    by_case: dict[RepertoireCase, list[CandidateWalk]] = {case: [] for case in plan.cases}
    for walk in walks:
        by_case[walk.case].append(walk)
    situations = []
    for failures, heading_deg in plan.situations:
        candidates = plan.candidates(failures, heading_deg)
        rows = [
            by_case[RepertoireCase(failures=texts_of(failures), heading_deg=heading_deg, candidate=candidate)]
            for candidate in candidates
        ]
        situations.append(
            Situation(
                failed=parts_of(failures),
                heading_deg=heading_deg,
                candidates=candidates,
                speeds=np.array([[walk.speed for walk in row] for row in rows]),
                costs=np.array([[walk.cost for walk in row] for row in rows]),
            )
        )
    gait = plan.gait
    return Repertoire(
        robot=plan.robot.name,
        robot_fingerprint=plan.robot.fingerprint,
        pace_hz=gait.pace_hz,
        amplitude=gait.amplitude,
        height=gait.height,
        direction_step_deg=plan.step_deg,
        symmetries=plan.symmetries,
        situations=tuple(situations),
        origin={
            "families": list(plan.families),
            "first_world": FIRST_WORLD,
            "worlds": plan.worlds,
            "time_step_s": TIME_STEP_S,
            "code": code_versions(),
        },
    )


def repertoire_file_name(plan: RepertoirePlan) -> str:
    """Name of a repertoire's file."""
    return plan.robot.name + SUFFIX
