"""The prior or the repertoire that options ask for, planned."""

from pathlib import Path
from typing import Any

from hexctl.adapt.prior.prior_files import PRIORS, describe_prior
from hexctl.backends.sim.world import load_randomization
from hexctl.control.monitor.repertoire import REPERTOIRES, SUFFIX, describe_repertoire
from hexctl.control.trial_plan import AUTO_ROTATION, suited_rotation
from hexctl.options import listed
from hexctl.robot.loader import load_robot
from hexctl.settings import find_settings
from hexctl.study.plan import PlannedWork
from hexctl.study.priors.prior_building import PriorPlan, build_prior, prior_file_name
from hexctl.study.priors.prior_options import PriorOptions
from hexctl.study.repertoire_plan import RepertoirePlan, build_repertoire
from hexctl.study.walking import Work

Planned = PlannedWork[dict[str, Any]]


def planned_prior(options: PriorOptions, *, runs: Path | None = None) -> Planned:
    """Plan a prior or a repertoire; its `run` writes the file and describes it.

    Args:
        runs: folder of the file, unless `out` names one; None is that of the settings.

    Raises InputError for an invalid robot, family or plan.
    """
    runs = find_settings().runs if runs is None else runs
    return _repertoire(options, runs) if options.repertoire else _prior(options, runs)


def _prior(options: PriorOptions, runs: Path) -> Planned:
    family, rotation = options.family or "randomised", options.self_rotation or AUTO_ROTATION
    plan = PriorPlan(
        robot=load_robot(options.robot, all_sensors=True),
        family=load_randomization(family),
        worlds=options.worlds or 16,
        legs=tuple(options.legs),
        failure=options.failure,
        self_rotation=suited_rotation(rotation, options.hold, chosen_gait=True),
        hold=options.hold,
        duration_s=options.duration_s,
    )
    path = options.out or runs / PRIORS / prior_file_name(plan, family)

    def begin(work: Work) -> dict[str, Any]:
        build_prior(plan, path, work)
        return {"prior": str(path), **describe_prior(path)}

    return PlannedWork(plan=plan, options=options, begin=begin)


def _repertoire(options: PriorOptions, runs: Path) -> Planned:
    asked: dict[str, Any] = {
        "worlds": options.worlds,
        "directions": options.directions,
        "codes": options.codes,
    }
    asked["pair_failures"] = None if options.pairs is None else tuple(options.pairs)
    plan = RepertoirePlan(
        robot=load_robot(options.robot, all_sensors=True),
        families={name: load_randomization(name) for name in listed(options.family or "transfer,real")},
        **{name: value for name, value in asked.items() if value is not None},
    )
    plan.check()
    path = options.out or runs / REPERTOIRES / f"{plan.robot.name}{SUFFIX}"

    def begin(work: Work) -> dict[str, Any]:
        build_repertoire(plan, path, work)
        return {"repertoire": str(path), **describe_repertoire(path)}

    return PlannedWork(plan=plan, options=options, begin=begin)
