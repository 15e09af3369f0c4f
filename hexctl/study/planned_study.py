"""The study that options ask for, planned."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from hexctl.adapt.prior.prior import Prior, load_prior
from hexctl.adapt.prior.prior_files import find_prior, prior_folders
from hexctl.backends.sim.world import DEFAULT_WORLD, DomainRandomization, load_randomization, load_world
from hexctl.errors import InputError, argument
from hexctl.options import listed
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.settings import find_settings
from hexctl.study import hold_plan
from hexctl.study.experiment import Experiment, Result
from hexctl.study.held_out_experiment import HeldOutExperiment
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.paper.matrix import FAILURES, ROBOTS, TIME_STEPS_S, WORLDS, MatrixPlan, cells_of
from hexctl.study.paper.paper_study import PaperStudy
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.plan import PlannedWork, check_each
from hexctl.study.recovery import recovery_plan
from hexctl.study.recovery.recovery_plan import RecoveryPlan
from hexctl.study.study_options import HOLD, MATRIX, PAPER, RECOVERY, TRANSFER, StudyOptions
from hexctl.study.transfer.transfer_plan import UNSEEN, TransferPlan

Planned = PlannedWork[Result[Any]]


def planned_study(options: StudyOptions, *, runs: Path | None = None) -> Planned:
    """Plan a study; its `run` simulates it and writes the report.

        result = planned_study(StudyOptions(hold=True, legs=(2,), worlds=1)).run()

    Args:
        runs: folder of reports and of built priors; None is that of the settings, `runs`.

    Raises InputError for an unknown robot, world, family or prior.
    """
    runs = find_settings().runs if runs is None else runs
    folder = options.out or runs / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    plan = _PLANS[options.kind](options, runs)
    return PlannedWork(plan=plan, options=options, begin=partial(plan.run, folder))


def _paper(options: StudyOptions, _runs: Path) -> PaperStudy:
    return PaperStudy(
        robot=load_robot(options.robot or "ant", all_sensors=True),
        world=load_world(options.world or DEFAULT_WORLD),
        **_values(options, StudyPlan),
    )


def _transfer(options: StudyOptions, runs: Path) -> TransferPlan:
    robot = load_robot(options.robot or "ant", all_sensors=True)
    return TransferPlan(
        robot=robot,
        family=_family(options.world or UNSEEN),
        prior=_prior(options, robot, runs),
        **_values(options, TransferPlan),
    )


def _prior(options: StudyOptions, robot: Robot, runs: Path) -> Prior:
    """The prior of an option, or the first one that covers the trials; raises InputError if there is none."""
    if options.prior not in (None, "auto"):
        return load_prior(Path(str(options.prior)))
    check_each("legs", map(str, options.legs))
    failure = parse_kind(options.legs[0], options.failure or TransferPlan.failure)
    walk = RunSpec(gait="demo", duration_s=options.duration_s, failure=failure, hold="none")
    plan = plan_walk(walk, robot)
    found = find_prior(robot, plan, prior_folders(runs))
    if found.path is None:
        raise InputError(
            f"prior: there is none for these trials ({found.reason}); hexctl prior build makes one"
        )
    return load_prior(found.path)


def _matrix(options: StudyOptions, _runs: Path) -> MatrixPlan:
    values = _values(options, StudyPlan)
    values.pop("failure", None)
    steps_ms = options.time_steps_ms
    cells = cells_of(
        [load_robot(name, all_sensors=True) for name in _several(options.robot, ROBOTS)],
        {name: load_world(name) for name in _several(options.world, WORLDS)},
        _several(options.failure, FAILURES),
        TIME_STEPS_S if steps_ms is None else [step_ms / 1000 for step_ms in steps_ms],
        **values,
    )
    return MatrixPlan(cells=cells)


_PLANS: dict[str, Callable[[StudyOptions, Path], Experiment[Any]]] = {
    PAPER: _paper,
    TRANSFER: _transfer,
    MATRIX: _matrix,
    HOLD: lambda options, _: HoldPlan(**_held_out(options, HoldPlan, (hold_plan.FAMILY,))),
    RECOVERY: lambda options, _: RecoveryPlan(**_held_out(options, RecoveryPlan, recovery_plan.FAMILIES)),
}


def _held_out(
    options: StudyOptions, plan: type[HeldOutExperiment], families: Sequence[str]
) -> dict[str, Any]:
    """Fields of an experiment in held-out worlds, by name."""
    values = _values(options, plan)
    if options.failure is not None:
        values["failures"] = listed(options.failure)
    return values | {
        "robots": tuple(load_robot(name, all_sensors=True) for name in _several(options.robot, ("ant",))),
        "families": {name: _family(name) for name in _several(options.world, families)},
    }


def _values(options: StudyOptions, plan: Any) -> dict[str, Any]:
    """Options that a plan has by the same name, without None."""
    names = {field.name for field in fields(plan)} - {"robot", "world", "prior"}
    values = {field.name: getattr(options, field.name) for field in fields(options) if field.name in names}
    return {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in values.items()
        if value is not None
    }


def _several(text: str | None, default: Sequence[str]) -> tuple[str, ...]:
    return tuple(default) if text is None else listed(text)


def _family(name: str) -> DomainRandomization:
    """Family of worlds by name; raises InputError for any other world."""
    try:
        return load_randomization(name)
    except InputError as error:
        raise InputError(f"{argument('world')}: got {name} ({error})") from error
