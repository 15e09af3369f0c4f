"""`hexctl study`: the paper's experiments, and the benchmarks of transfer, holds and recovery."""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import print_result
from hexctl.cli.options.failure import ALL_LEGS, KIND_HELP, LegsOption
from hexctl.cli.options.output import DaskOption, JobsOption, JsonOption
from hexctl.cli.options.robot import WORLD_HELP, SeedOption, robot_option
from hexctl.cli.options.walk import SELF_ROTATION_HELP, TrialDurationOption
from hexctl.cli.progress import StudyProgress, interruptible
from hexctl.cli.render.study_output import bar_lines, study_lines
from hexctl.cli.settings import runs_folder
from hexctl.cli.values import choice, listed, number, refuse_given, with_values
from hexctl.control.trial_plan import SelfRotation
from hexctl.errors import InputError
from hexctl.options import Range

if TYPE_CHECKING:
    from hexctl.backends.sim.world import DomainRandomization
    from hexctl.study.study import HoldResult, RecoveryResult, StudyResult, TransferResult
    from hexctl.study.verdicts.matrix import MatrixResult

RUN_COUNT = Range(low=1, high=999, whole=True)
BUDGET = Range(low=1, high=10_000, whole=True)
WORLDS = Range(low=1, high=1000, whole=True)

TransferOption = Annotated[
    bool,
    typer.Option("--transfer", help="Compare the optimizers in held-out worlds."),
]
OptimizersOption = Annotated[
    str | None,
    typer.Option(
        "--optimizers",
        help="Optimizers, separated by commas: pso, psosp, dps, debest, derand, random, exhaustive, "
        "or a custom package.module:Class; with --transfer also bayes and bayes-early. "
        "(default: all but exhaustive)",
    ),
]
RunsOption = Annotated[
    int | None,
    number(
        "--runs",
        RUN_COUNT,
        "Runs of each optimizer on each leg, {}; with --recovery, runs of each set of legs in the protocols "
        "hexaheal and second. (default: 30; with --transfer 5, with --recovery 10)",
    ),
]
BudgetOption = Annotated[
    int | None, number("--budget", BUDGET, "Trials per run, {}. (default: 120; with --transfer 60)")
]
WorldsOption = Annotated[
    int | None,
    number(
        "--worlds",
        WORLDS,
        "Number of worlds, {}. With --transfer, --hold and --recovery they are held out (default: 30; 10 of "
        "each family). Otherwise --world and up to 99 similar ones (default: 1; with --matrix 3).",
    ),
]
StudyFailureOption = Annotated[
    str | None,
    typer.Option(
        "--failure",
        autocompletion=completion.kinds,
        help=f"{KIND_HELP} (default: locked; with --hold, --recovery and --matrix several)",
    ),
]
StudySelfRotationOption = Annotated[
    SelfRotation | None,
    choice(
        "--self-rotation",
        SelfRotation,
        f"{SELF_ROTATION_HELP} Not with --transfer. (default: rear; "
        "with --hold rear for heading, otherwise none)",
    ),
]
TransferPriorOption = Annotated[
    str | None,
    typer.Option(
        "--prior",
        autocompletion=completion.priors,
        help="With --transfer, the prior of bayes: auto or a file. (default: auto)",
    ),
]
StudyWorldOption = Annotated[
    str | None,
    typer.Option(
        "--world",
        autocompletion=completion.worlds,
        help=f"{WORLD_HELP} With --transfer, --hold and --recovery: a family, transfer or real. (default: "
        "flat; with --transfer and --hold transfer, with --recovery both)",
    ),
]
StudyRobotOption = Annotated[str | None, robot_option("ant; with --matrix ant,phantomx,pexod")]
MatrixOption = Annotated[
    bool,
    typer.Option(
        "--matrix",
        help="Test the claims in several settings. --failure, --world, --robot and --time-steps take lists. "
        "Each setting varies one of them from the first of each list.",
    ),
]
TimeStepsOption = Annotated[
    str | None,
    typer.Option("--time-steps", help="With --matrix, time steps of the physics in ms. (default: 2,4)"),
]
HoldStudyOption = Annotated[
    bool,
    typer.Option(
        "--hold",
        help="Compare walks in open loop, with yaw and with pose feedback, in held-out worlds. --failure, "
        "--world and --robot take lists.",
    ),
]
HoldsOption = Annotated[
    str | None,
    typer.Option(
        "--holds",
        help="With --hold, the holds to compare: none, heading, line. (default: all)",
    ),
]
ExactSensorsOption = Annotated[
    bool,
    typer.Option(
        "--exact-sensors",
        help="With --hold and --recovery, simulate sensors without delay, noise and losses.",
    ),
]
RecoveryStudyOption = Annotated[
    bool,
    typer.Option(
        "--recovery",
        help="Compare reactions to a leg or joint that fails during a walk: detection, end and speed. "
        "--failure, --world and --robot take lists.",
    ),
]
GaitsOption = Annotated[
    str | None,
    typer.Option(
        "--gaits", help="With --recovery, gaits before the failure: names, or auto. (default: tripod)"
    ),
]
MethodsOption = Annotated[
    str | None,
    typer.Option(
        "--methods",
        help="With --recovery, the reactions: nothing (always), told, recover, stop-diagnose, decentralised, "
        "open-loop-best, or a custom package.module:Class. (default: nothing,told,recover)",
    ),
]
ProtocolsOption = Annotated[
    str | None,
    typer.Option(
        "--protocols",
        help="With --recovery: line (a leg or joint fails after 8 s of --duration, in held-out worlds), "
        "hexaheal (one or two legs lose torque after 4 s of 14 s), second (one leg after 8 s of 36 s, "
        "another 10 s later). (default: line,hexaheal)",
    ),
]
OneLegOption = Annotated[
    bool,
    typer.Option(
        "--one-leg",
        help="With --transfer, only one leg fails in each world, by turns, in a sixth of the time.",
    ),
]
ReportFolderOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        help="Folder for the report: new, empty, or of an earlier study, which is replaced. "
        "(default: runs/study-TIME)",
        show_default=False,
    ),
]


def study(
    legs: LegsOption = ALL_LEGS,
    failure: StudyFailureOption = None,
    self_rotation: StudySelfRotationOption = None,
    transfer: TransferOption = False,
    one_leg: OneLegOption = False,
    matrix: MatrixOption = False,
    hold: HoldStudyOption = False,
    holds: HoldsOption = None,
    recovery: RecoveryStudyOption = False,
    gaits: GaitsOption = None,
    methods: MethodsOption = None,
    protocols: ProtocolsOption = None,
    exact_sensors: ExactSensorsOption = False,
    time_steps: TimeStepsOption = None,
    optimizers: OptimizersOption = None,
    runs: RunsOption = None,
    budget: BudgetOption = None,
    worlds: WorldsOption = None,
    prior: TransferPriorOption = None,
    duration: TrialDurationOption = 30.0,
    robot: StudyRobotOption = None,
    world: StudyWorldOption = None,
    out: ReportFolderOption = None,
    jobs: JobsOption = None,
    dask: DaskOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Repeat the paper's experiments: all gaits of each failed leg, all optimizers, one report.

    Each gait is walked once and kept under runs/study-cache. After Ctrl-C the same command continues.
    """
    from hexctl.robot.failure_grammar import parse_legs

    kinds = {"--transfer": transfer, "--matrix": matrix, "--hold": hold, "--recovery": recovery}
    own: dict[str, dict[str, object]] = {
        "--transfer": {"--prior": prior, "--one-leg": one_leg or None},
        "--matrix": {"--time-steps": time_steps},
        "--hold": {"--holds": holds},
        "--recovery": {"--gaits": gaits, "--methods": methods, "--protocols": protocols},
    }
    _check_kind(kinds, own)
    if not (hold or recovery):
        refuse_given({"--exact-sensors": exact_sensors or None}, "with --hold or --recovery")
    folder = out or runs_folder() / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    asked_legs = parse_legs(legs, "--legs")
    options: dict[str, Any] = {"legs": asked_legs, "duration_s": duration} | with_values(worlds=worlds)
    result: StudyResult | TransferResult | MatrixResult | HoldResult | RecoveryResult
    if hold or recovery:
        flag = "--hold" if hold else "--recovery"
        refused = {"--optimizers": optimizers, "--budget": budget, "--dask": dask}
        refuse_given(refused, f"without {flag}, which searches nothing")
        options |= with_values(exact_sensors=exact_sensors or None)
        settings = with_values(robots=robot, families=world, failures=failure)
    else:
        searches = None if optimizers is None else listed(optimizers)
        options |= {"seed": seed} | with_values(optimizers=searches, runs=runs, budget=budget)
    if hold:
        refused = {"--runs": runs, "--seed": seed or None}
        refuse_given(refused, "without --hold, which searches nothing")
        options |= with_values(self_rotation=self_rotation)
        result, lines = _hold(settings | with_values(holds=holds), options, folder, jobs)
    elif recovery:
        refuse_given({"--self-rotation": self_rotation}, "without --recovery, which does not turn")
        options |= {"seed": seed} | with_values(runs=runs)
        settings |= with_values(gaits=gaits, methods=methods, protocols=protocols)
        result, lines = _recovery(settings, options, folder, jobs)
    elif transfer:
        refuse_given({"--self-rotation": self_rotation}, "without --transfer, which turns to the rear")
        options |= with_values(failure=failure) | {"one_leg": one_leg}
        result, lines = _transfer(robot or "ant", world, prior, options, folder, jobs, dask)
    elif matrix:
        options |= with_values(self_rotation=self_rotation)
        settings = with_values(robots=robot, worlds=world, failures=failure, steps=time_steps)
        result, lines = _matrix(settings, options, folder, jobs, dask)
    else:
        options |= with_values(failure=failure, self_rotation=self_rotation)
        result, lines = _study(robot or "ant", world or "flat", options, folder, jobs, dask)
    print_result(json.dumps(result.to_json()) if as_json else "\n".join([*lines, f"report: {result.report}"]))


def _not_judged(duration_s: float, budget: int | None = None) -> Iterator[str]:
    """What will have no verdict as it is too short, in lines for the user."""
    from hexctl.study.verdicts.claim_evidence import JUDGED_FROM_S, too_short
    from hexctl.study.verdicts.trajectories import LATE

    if reason := too_short(duration_s):
        yield f"hexctl: distances will not be judged: {reason} (--duration {JUDGED_FROM_S:g})"
    if budget is not None and budget <= LATE:
        yield (
            f"hexctl: claims about the first {LATE} evaluations will not be judged: {budget} evaluations, "
            f"needs more than {LATE} (--budget)"
        )


def _check_kind(kinds: Mapping[str, bool], own: Mapping[str, Mapping[str, object]]) -> None:
    """Raise InputError for two kinds of study, and for the options of one that was not asked for."""
    asked = [flag for flag, given in kinds.items() if given]
    if len(asked) > 1:
        raise InputError(f"{asked[1]}: got it with {asked[0]}; allowed: one or the other")
    for flag, options in own.items():
        if flag not in asked:
            refuse_given(options, f"with {flag}")


def _family(name: str) -> "DomainRandomization":
    """Family of worlds that `--world` names; raises InputError for any other world."""
    from hexctl.backends.sim.world import load_randomization

    try:
        return load_randomization(name)
    except InputError as error:
        raise InputError(f"--world: got {name} ({error})") from error


def _study(
    robot: str, world: str, options: dict[str, Any], folder: Path, jobs: int | None, dask: str | None
) -> "tuple[StudyResult, list[str]]":
    """Run the paper's experiments; returns the result and its verdicts as lines."""
    from hexctl.backends.sim.world import load_world
    from hexctl.robot.loader import load_robot
    from hexctl.study.study import run_study
    from hexctl.study.study_plan import StudyPlan

    plan = StudyPlan(robot=load_robot(robot), world=load_world(world), **options)
    notes = _not_judged(plan.duration_s, plan.budget)
    with interruptible(lambda cache: cache.count(plan.specs())), StudyProgress(notes) as progress:
        result = run_study(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    return result, study_lines(result)


def _transfer(
    robot: str,
    family: str | None,
    prior: str | None,
    options: dict[str, Any],
    folder: Path,
    jobs: int | None,
    dask: str | None,
) -> "tuple[TransferResult, list[str]]":
    """Run the transfer benchmark; returns the result and its verdicts as lines."""
    from hexctl.adapt.prior.prior import load_prior
    from hexctl.adapt.prior.prior_files import prior_folders
    from hexctl.robot.loader import load_robot
    from hexctl.study.study import run_transfer
    from hexctl.study.transfer.transfer_plan import UNSEEN, TransferPlan, find_transfer_prior
    from hexctl.study.transfer.transfer_report import transfer_bars

    model = load_robot(robot)
    if prior in (None, "auto"):
        folders = prior_folders(runs_folder())
        failure = options.get("failure", "locked")
        believed = find_transfer_prior(
            model, options["legs"], options["duration_s"], folders, failure=failure
        )
    else:
        believed = load_prior(Path(str(prior)))
    plan = TransferPlan(robot=model, family=_family(family or UNSEEN), prior=believed, **options)
    notes = _not_judged(plan.duration_s)
    with interruptible(lambda cache: cache.count(plan.specs())), StudyProgress(notes) as progress:
        result = run_transfer(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    return result, bar_lines(transfer_bars(result.findings))


def _matrix(
    settings: dict[str, str], options: dict[str, Any], folder: Path, jobs: int | None, dask: str | None
) -> "tuple[MatrixResult, list[str]]":
    """Run the matrix of verdicts; returns the result and its table as lines."""
    from hexctl.backends.sim.world import load_world
    from hexctl.robot.loader import load_robot
    from hexctl.study.verdicts.matrix import (
        FAILURES,
        ROBOTS,
        TIME_STEPS_S,
        WORLDS,
        MatrixPlan,
        cells_of,
        run_matrix,
    )

    def several(name: str, default: Sequence[str]) -> tuple[str, ...]:
        return listed(settings[name]) if name in settings else tuple(default)

    steps = several("steps", [f"{1000 * step_s:g}" for step_s in TIME_STEPS_S])
    cells = cells_of(
        [load_robot(name) for name in several("robots", ROBOTS)],
        {name: load_world(name) for name in several("worlds", WORLDS)},
        several("failures", FAILURES),
        [_step_s(text) for text in steps],
        **options,
    )
    plan = MatrixPlan(cells=cells)
    notes = _not_judged(cells[0].plan.duration_s, cells[0].plan.budget)
    with interruptible(lambda cache: cache.count(plan.specs())), StudyProgress(notes) as progress:
        result = run_matrix(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    return result, result.to_markdown().splitlines()


def _hold(
    settings: dict[str, str], options: dict[str, Any], folder: Path, jobs: int | None
) -> "tuple[HoldResult, list[str]]":
    """Compare holds; returns the result, its table and its verdicts as lines."""
    from hexctl.robot.loader import load_robot
    from hexctl.study.holds.hold_findings import hold_bars
    from hexctl.study.holds.hold_plan import FAMILY, HoldPlan
    from hexctl.study.holds.hold_report import holds_lines
    from hexctl.study.holds.hold_walks import HoldCache
    from hexctl.study.study import run_holds

    parts: dict[str, Any] = {name: listed(text) for name, text in settings.items()}
    robots = tuple(load_robot(name) for name in parts.pop("robots", ("ant",)))
    families = {name: _family(name) for name in parts.pop("families", (FAMILY,))}
    plan = HoldPlan(robots=robots, families=families, **parts, **options)
    with (
        interruptible(lambda cache: HoldCache(cache).count(plan.walked()), "walks"),
        StudyProgress(_not_judged(plan.duration_s)) as progress,
    ):
        result = run_holds(plan, folder=folder, jobs=jobs, progress=progress)
    return result, [*holds_lines(result.findings), *bar_lines(hold_bars(result.findings))]


def _recovery(
    settings: dict[str, str], options: dict[str, Any], folder: Path, jobs: int | None
) -> "tuple[RecoveryResult, list[str]]":
    """Run the recovery benchmark; returns the result, its table and its verdicts as lines."""
    from hexctl.robot.loader import load_robot
    from hexctl.study.recovery.recovery_criteria import recovery_bars
    from hexctl.study.recovery.recovery_plan import FAMILIES, RecoveryPlan
    from hexctl.study.recovery.recovery_report import recovery_lines
    from hexctl.study.recovery.recovery_walks import EpisodeCache
    from hexctl.study.study import run_recovery

    parts: dict[str, Any] = {name: listed(text) for name, text in settings.items()}
    robots = tuple(load_robot(name) for name in parts.pop("robots", ("ant",)))
    families = {name: _family(name) for name in parts.pop("families", FAMILIES)}
    plan = RecoveryPlan(robots=robots, families=families, **parts, **options)
    with (
        interruptible(lambda cache: EpisodeCache(cache).count(plan.walked()), "walks"),
        StudyProgress(_not_judged(plan.duration_s)) as progress,
    ):
        result = run_recovery(plan, folder=folder, jobs=jobs, progress=progress)
    return result, [*recovery_lines(result.findings), *bar_lines(recovery_bars(result.findings))]


#: Length of a tick in ms, and steps of the physics, of which it is a whole number.
TICK_MS = 20
TIME_STEP_MS = Range(low=0.5, high=5, unit="ms")


def _step_s(text: str) -> float:
    """Step of the physics in s from a text in ms; raises InputError unless the tick is a multiple of it."""
    try:
        step_ms = float(TIME_STEP_MS.parse(text))
    except ValueError as error:
        raise InputError(f"--time-steps: {error}") from None
    if abs(round(TICK_MS / step_ms) * step_ms - TICK_MS) > 1e-6:
        raise InputError(f"--time-steps: got {text}; allowed: {TICK_MS} ms divided by a whole number")
    return step_ms / 1000
