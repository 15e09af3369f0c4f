"""What `hexctl study` does with its options: check, simulate, search, report."""

import json
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from types import FrameType

from hexctl.backends.sim.world import load_world
from hexctl.cli.exits import DONE, INTERRUPTED
from hexctl.cli.interrupt import SIGNALS
from hexctl.cli.output import say
from hexctl.cli.places import RUNS
from hexctl.cli.studyprogress import StudyProgress
from hexctl.errors import InputError
from hexctl.robot.file import load_robot
from hexctl.study.bars import bar_rows
from hexctl.study.cache import LandscapeCache
from hexctl.study.claim import cm
from hexctl.study.claims import claims_of
from hexctl.study.drawing import check_drawing
from hexctl.study.evaluate import Simulate, fill, simulate_here
from hexctl.study.figures import FIGURES
from hexctl.study.findings import Findings, search_all
from hexctl.study.plan import StudyPlan
from hexctl.study.report import REPORT, write_report
from hexctl.study.summary import summary_json

CACHE = RUNS / "study-cache"
MAX_JOBS = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyRequest:
    """The options of `hexctl study` as values."""

    legs: tuple[int, ...]
    optimizers: tuple[str, ...]
    runs: int
    budget: int
    duration_s: float
    robot: str
    world: str
    out: Path | None
    jobs: int | None
    dask: str | None
    seed: int
    as_json: bool


def listed(text: str) -> tuple[str, ...]:
    """Return the parts of a text between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def listed_legs(text: str) -> tuple[int, ...]:
    """Return the legs of a text such as `2,5`, ascending; raises InputError for anything but numbers."""
    try:
        return tuple(sorted(int(part) for part in listed(text)))
    except ValueError:
        raise InputError(f"--legs: got {text!r}; allowed: numbers 1..6 with commas, such as 2,5") from None


def execute(request: StudyRequest) -> int:
    """Run a study and return the exit code."""
    plan = _checked_plan(request)
    folder = _new_folder(request.out)
    cache = LandscapeCache(CACHE)
    cache.probe()
    try:
        with _terminated_as_interrupted(), StudyProgress() as progress:
            findings, times = _study(request, plan, cache, progress, folder)
    except KeyboardInterrupt:
        say_interrupted(plan, cache)
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
    say(json.dumps(outcome) if request.as_json else closing_text(findings, folder, times))
    return DONE


def _study(
    request: StudyRequest, plan: StudyPlan, cache: LandscapeCache, progress: StudyProgress, folder: Path
) -> tuple[Findings, dict[str, float]]:
    """Simulate what is missing, search, report; return the findings and how long each part took."""
    marks_s = [time.perf_counter()]
    with ExitStack() as stack:
        landscapes = fill(plan.specs(), cache, _simulate(request, stack), progress)
    for note in cache.notes:
        progress.note(note)
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
    if request.jobs is not None and not 1 <= request.jobs <= MAX_JOBS:
        raise InputError(f"--jobs: got {request.jobs}; allowed: 1..{MAX_JOBS}")
    check_drawing()
    plan = StudyPlan(
        robot=load_robot(request.robot),
        world=load_world(request.world),
        legs=request.legs,
        optimizers=request.optimizers,
        runs=request.runs,
        budget=request.budget,
        duration_s=request.duration_s,
        seed=request.seed,
    )
    plan.check()
    return plan


def _simulate(request: StudyRequest, stack: ExitStack) -> Simulate:
    """Return the way to simulate: on the workers of a cluster, or here."""
    if request.dask is None:
        return simulate_here(request.jobs or 0)
    from hexctl.study.cluster import dask_executor, simulate_on

    return simulate_on(stack.enter_context(dask_executor(request.dask)), request.jobs or 1)


def _new_folder(out: Path | None) -> Path:
    """Return the folder of the report: new, empty, or one with an earlier study, which is replaced."""
    folder = out or RUNS / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".probe").touch()
        (folder / ".probe").unlink()
        others = any(folder.iterdir()) and not (folder / REPORT).exists()
    except OSError as error:
        raise InputError(f"--out: {folder} cannot be used ({error.strerror}); allowed: a folder") from error
    if others:
        raise InputError(f"--out: {folder} holds other things; allowed: a new or empty folder")
    return folder


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Take SIGTERM for Ctrl-C meanwhile, and Ctrl-C for itself even where a shell has switched it off."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def say_interrupted(plan: StudyPlan, cache: LandscapeCache) -> None:
    """Tell on stderr what is saved and how to go on."""
    import typer

    landscapes = [cache.load(spec) for spec in plan.specs()]
    done = sum(int(landscape.done.sum()) for landscape in landscapes)
    total = sum(len(landscape.codes) for landscape in landscapes)
    typer.echo(
        f"interrupted: {done} of {total} gaits are saved in {cache.folder}; the same command goes on",
        err=True,
    )


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
