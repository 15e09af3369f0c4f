"""What `hexctl study` does with its options: check, simulate, search, report."""

import json
import time
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from hexctl.backends.sim.world import load_world
from hexctl.cli.console import DONE, INTERRUPTED, RUNS, print_result
from hexctl.cli.simulating import (
    check_jobs,
    open_cache,
    say_interrupted,
    terminated_as_interrupted,
    walked,
)
from hexctl.cli.studyprogress import StudyProgress
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.study.cache import LandscapeCache
from hexctl.study.claims import bar_rows, claims_of, cm
from hexctl.study.drawing import check_drawing
from hexctl.study.figures import FIGURES
from hexctl.study.plan import StudyPlan
from hexctl.study.report import REPORT, write_report
from hexctl.study.searches import Findings, search_all
from hexctl.study.tables import summary_json


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyRequest:
    """The options of `hexctl study` as values."""

    legs: tuple[int, ...]
    optimizers: tuple[str, ...] | None
    runs: int | None
    budget: int | None
    worlds: int | None
    prior: str | None
    duration_s: float
    robot: str
    world: str | None
    out: Path | None
    jobs: int | None
    dask: str | None
    seed: int
    as_json: bool


def execute(request: StudyRequest) -> int:
    """Run a study and return the exit code."""
    plan = _checked_plan(request)
    folder = new_folder(request.out)
    cache = open_cache()
    try:
        with terminated_as_interrupted(), StudyProgress() as progress:
            findings, times = _study(request, plan, cache, progress, folder)
    except KeyboardInterrupt:
        say_interrupted(plan.specs(), cache)
        return INTERRUPTED
    finally:
        # An empty folder helps nobody; one with anything in it stays.
        with suppress(OSError):
            folder.rmdir()
    outcome = {
        "out": str(folder),
        "report": str(folder / REPORT),
        **summary_json(findings),
        "notes": cache.notes,
        "times_s": times,
    }
    (folder / "study.json").write_text(json.dumps(outcome, indent=1), encoding="utf-8")
    print_result(json.dumps(outcome) if request.as_json else closing_text(findings, folder, times))
    return DONE


def _study(
    request: StudyRequest, plan: StudyPlan, cache: LandscapeCache, progress: StudyProgress, folder: Path
) -> tuple[Findings, dict[str, float]]:
    """Simulate what is missing, search, report; return the findings and how long each part took."""
    marks_s = [time.perf_counter()]
    landscapes = walked(plan.specs(), cache, progress, jobs=request.jobs, dask=request.dask)
    marks_s.append(time.perf_counter())
    progress.stage("searches, leg by leg", len(plan.legs))
    findings = search_all(plan, landscapes, lambda _: progress.step())
    marks_s.append(time.perf_counter())
    progress.stage("figures", len(FIGURES))
    write_report(findings, folder, lambda _: progress.step())
    marks_s.append(time.perf_counter())
    spent_s = [round(after - before, 2) for before, after in pairwise(marks_s)]
    return findings, dict(zip(("landscapes", "searches", "report"), spent_s, strict=True))


def _checked_plan(request: StudyRequest) -> StudyPlan:
    """Refuse what cannot be done before anything runs; return the plan."""
    check_jobs(request.jobs)
    check_drawing()
    for name in ("worlds", "prior"):
        if getattr(request, name) is not None:
            raise InputError(f"--{name}: got {getattr(request, name)}; allowed: with --transfer")
    plan = StudyPlan(
        robot=load_robot(request.robot),
        world=load_world(request.world or "flat"),
        legs=request.legs,
        duration_s=request.duration_s,
        seed=request.seed,
        **chosen(request, "optimizers", "runs", "budget"),
    )
    plan.check()
    return plan


def chosen(request: StudyRequest, *names: str) -> dict[str, Any]:
    """Return those options that were given; the plan has the defaults of the others."""
    given = {name: getattr(request, name) for name in names}
    return {name: value for name, value in given.items() if value is not None}


def new_folder(out: Path | None, report: str = REPORT) -> Path:
    """Return the folder of the report: new, empty, or one with an earlier study, which is replaced."""
    folder = out or RUNS / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".probe").touch()
        (folder / ".probe").unlink()
        others = any(folder.iterdir()) and not (folder / report).exists()
    except OSError as error:
        raise InputError(f"--out: {folder} cannot be used ({error.strerror}); allowed: a folder") from error
    if others:
        raise InputError(f"--out: {folder} holds other things; allowed: a new or empty folder")
    return folder


def closing_text(findings: Findings, folder: Path, times: dict[str, float]) -> str:
    """Return claims, bars that are missed, and where the report is."""
    lines = [f"{claim.verdict:<15} {claim.claim}" for claim in claims_of(findings)]
    rows = [row for row in bar_rows(findings, paper_count=False) if row.leg is None]
    missed = [row for row in rows if not row.holds]
    lines += [
        f"bar missed: {row.optimizer} {cm(row.mean_m)} after {row.evaluations} evaluations, "
        f"{cm(row.over_m)} over"
        for row in missed
    ]
    if rows and not missed:
        lines.append("bar held by all optimizers, each gait paid for once")
    spent = ", ".join(f"{name} {spent_s:.0f} s" for name, spent_s in times.items())
    return "\n".join([*lines, spent, f"report: {folder / REPORT}"])
