"""What `hexctl study --transfer` does: check, walk all gaits in unseen worlds, search, report."""

import json
from contextlib import suppress
from pathlib import Path

from hexctl.adapt.prior.find import find_prior, shipped_priors
from hexctl.adapt.prior.prior import Prior, PriorKey, load_prior
from hexctl.adapt.search import serving
from hexctl.backends.sim.world import load_randomization
from hexctl.cli.console import DONE, INTERRUPTED, print_result
from hexctl.cli.prioring import PRIORS
from hexctl.cli.simulating import (
    check_jobs,
    open_cache,
    say_interrupted,
    terminated_as_interrupted,
    walked,
)
from hexctl.cli.studying import StudyRequest, chosen, new_folder
from hexctl.cli.studyprogress import StudyProgress
from hexctl.control.plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.study.cache import LandscapeCache
from hexctl.study.drawing import check_drawing
from hexctl.study.transfer.plan import TransferPlan
from hexctl.study.transfer.report import REPORT, transfer_bars, transfer_json, write_transfer_report
from hexctl.study.transfer.searches import TransferFindings, run_transfer

FAMILY = "transfer"


def execute_transfer(request: StudyRequest) -> int:
    """Run a transfer benchmark and return the exit code."""
    check_jobs(request.jobs)
    check_drawing()
    plan = _checked_plan(request)
    folder = new_folder(request.out, REPORT)
    cache = open_cache()
    try:
        with terminated_as_interrupted(), StudyProgress() as progress:
            findings = _transfer(request, plan, cache, progress)
            report = write_transfer_report(findings, folder)
    except KeyboardInterrupt:
        say_interrupted(plan.specs(), cache)
        return INTERRUPTED
    finally:
        # An empty folder helps nobody; one with anything in it stays.
        with suppress(OSError):
            folder.rmdir()
    outcome = {"out": str(folder), "report": str(report), **transfer_json(findings), "notes": cache.notes}
    (folder / "transfer.json").write_text(json.dumps(outcome, indent=1), encoding="utf-8")
    print_result(json.dumps(outcome) if request.as_json else _closing_text(findings, report))
    return DONE


def _transfer(
    request: StudyRequest, plan: TransferPlan, cache: LandscapeCache, progress: StudyProgress
) -> TransferFindings:
    """Simulate what is missing and search in it."""
    landscapes = walked(plan.specs(), cache, progress, jobs=request.jobs, dask=request.dask)
    progress.stage("searches, world by world", len(landscapes))
    return run_transfer(plan, landscapes, lambda _: progress.step())


def _checked_plan(request: StudyRequest) -> TransferPlan:
    if request.world is not None:
        raise InputError(f"--world: got {request.world} with --transfer; allowed: without, it has its own")
    if not request.legs:
        raise InputError("--legs: got none; allowed: one or more of 1..6")
    robot = load_robot(request.robot)
    plan = TransferPlan(
        robot=robot,
        family=load_randomization(FAMILY),
        prior=_prior(request, robot),
        legs=request.legs,
        duration_s=request.duration_s,
        seed=request.seed,
        **chosen(request, "optimizers", "runs", "budget", "worlds"),
    )
    plan.check()
    return plan


def _prior(request: StudyRequest, robot: Robot) -> Prior:
    """Return the prior of the benchmark's trials, found or given."""
    if request.prior not in (None, "auto"):
        return load_prior(Path(str(request.prior)))
    failure = Failure(leg=request.legs[0])
    plan = TrialPlan(gait=make_gait(robot, "demo"), duration_s=request.duration_s, failure=failure)
    found = find_prior(PriorKey.of(robot, plan), [PRIORS, shipped_priors()], serves=serving(robot, plan))
    if found.path is None:
        raise InputError(
            f"prior: there is none for these trials ({found.reason}); hexctl prior build makes one"
        )
    return load_prior(found.path)


def _closing_text(findings: TransferFindings, report: Path) -> str:
    """Return the bars and where the report is."""
    lines = [f"{bar.verdict:<15} {bar.asked}: {bar.measured}" for bar in transfer_bars(findings)]
    return "\n".join([*lines, f"report: {report}"])
