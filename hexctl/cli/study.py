"""`hexctl study`: the paper's experiments and the transfer benchmark."""

import json
import signal
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Protocol, Self

import typer

from hexctl.cli import completion
from hexctl.cli.console import INTERRUPTED, RUNS, SIGNALS, make_bar, print_above, print_note, print_result
from hexctl.cli.options import (
    ALL_LEGS,
    FAILURE_HELP,
    ROBOT_HELP,
    SELF_ROTATION_HELP,
    WORLD_HELP,
    DaskOption,
    JobsOption,
    JsonOption,
    LegsOption,
    Range,
    SeedOption,
    SelfRotation,
    TrialDurationOption,
    choice,
    listed,
    listed_legs,
    number,
    refuse_given,
)
from hexctl.errors import InputError

if TYPE_CHECKING:
    from hexctl.study.landscape import Landscape, LandscapeSpec
    from hexctl.study.matrix import MatrixResult
    from hexctl.study.study import StudyResult, TransferResult

RUN_COUNT = Range(low=1, high=999, whole=True)
BUDGET = Range(low=1, high=10_000, whole=True)
WORLDS = Range(low=1, high=1000, whole=True)

TransferOption = Annotated[
    bool,
    typer.Option(
        "--transfer", help="Ask another question: how do all searches do in worlds that no prior has seen."
    ),
]
OptimizersOption = Annotated[
    str | None,
    typer.Option(
        "--optimizers",
        help="Searches, with commas: of pso, psosp, dps, debest, derand, random, exhaustive, or your "
        "own package.module:Class; with --transfer also "
        "bayes and bayes-early. (default: all of those but exhaustive, and the bayes ones)",
    ),
]
RunsOption = Annotated[
    int | None,
    number("--runs", RUN_COUNT, "Runs of each optimizer on each leg, {}. (default: 30; with --transfer 5)"),
]
BudgetOption = Annotated[
    int | None, number("--budget", BUDGET, "Trials of a run, {}. (default: 120; with --transfer 60)")
]
WorldsOption = Annotated[
    int | None,
    number(
        "--worlds",
        WORLDS,
        "In how many worlds, {}: with --transfer unseen ones (default: 30), else --world and others like it, "
        "up to 100, over which claims have intervals (default: 1; with --matrix 3).",
    ),
]
StudyFailureOption = Annotated[
    str | None,
    typer.Option(
        "--failure",
        autocompletion=completion.failures,
        help=f"{FAILURE_HELP} (default: locked)",
    ),
]
StudySelfRotationOption = Annotated[
    SelfRotation | None,
    choice(
        "--self-rotation",
        SelfRotation,
        f"{SELF_ROTATION_HELP} The optimizers search in these walks. Not with --transfer. (default: rear)",
    ),
]
TransferPriorOption = Annotated[
    str | None,
    typer.Option(
        "--prior",
        autocompletion=completion.priors,
        help="With --transfer, what bayes believes: auto or a file. (default: auto)",
    ),
]
StudyWorldOption = Annotated[
    str | None,
    typer.Option(
        "--world",
        autocompletion=completion.worlds,
        help=f"{WORLD_HELP} With --transfer a family of worlds, transfer or real. (default: flat; transfer)",
    ),
]
StudyRobotOption = Annotated[
    str | None,
    typer.Option(
        "--robot",
        autocompletion=completion.robots,
        help=f"{ROBOT_HELP} (default: ant; with --matrix ant,phantomx,pexod)",
    ),
]
MatrixOption = Annotated[
    bool,
    typer.Option(
        "--matrix",
        help="Judge the claims in many settings: --failure, --world, --robot and --time-steps take several "
        "with commas; each failure is walked in the first of each, and in every other one of each.",
    ),
]
TimeStepsOption = Annotated[
    str | None,
    typer.Option(
        "--time-steps", help="With --matrix, steps of the physics in ms, with commas. (default: 2,4)"
    ),
]
OneLegOption = Annotated[
    bool,
    typer.Option(
        "--one-leg",
        help="With --transfer, one leg fails in each world, the next one in the next: a sixth of the time.",
    ),
]
ReportFolderOption = Annotated[
    Path | None,
    typer.Option(
        "--out",
        help="Folder for the report, new or empty. (default: runs/study-TIME)",
        show_default=False,
    ),
]


class Simulated(Protocol):
    """A plan whose landscapes are simulated."""

    def specs(self) -> "list[LandscapeSpec]":
        """Specs of the landscapes."""


def study(
    legs: LegsOption = ALL_LEGS,
    failure: StudyFailureOption = None,
    self_rotation: StudySelfRotationOption = None,
    transfer: TransferOption = False,
    one_leg: OneLegOption = False,
    matrix: MatrixOption = False,
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
    """Repeat the paper's experiments: all gaits of each failed leg, all searches, one report.

    Gaits are walked once and kept under runs/study-cache; Ctrl-C, then the same command continues.
    """
    _check_kind(transfer, matrix, self_rotation, time_steps, prior, one_leg)
    folder = out or RUNS / f"study-{datetime.now():%Y%m%d-%H%M%S}"
    options: dict[str, Any] = {"legs": listed_legs(legs), "duration_s": duration, "seed": seed}
    searches = None if optimizers is None else listed(optimizers)
    options |= _given(optimizers=searches, runs=runs, budget=budget, worlds=worlds)
    result: StudyResult | TransferResult | MatrixResult
    if transfer:
        options |= _given(failure=failure) | {"one_leg": one_leg}
        result, lines = _transfer(robot or "ant", world, prior, options, folder, jobs, dask)
    elif matrix:
        options |= _given(self_rotation=self_rotation)
        settings = _given(robots=robot, worlds=world, failures=failure, steps=time_steps)
        result, lines = _matrix(settings, options, folder, jobs, dask)
    else:
        options |= _given(failure=failure, self_rotation=self_rotation)
        result, lines = _study(robot or "ant", world or "flat", options, folder, jobs, dask)
    print_result(json.dumps(result.to_json()) if as_json else "\n".join([*lines, f"report: {result.report}"]))


def _check_kind(
    transfer: bool,
    matrix: bool,
    self_rotation: str | None,
    time_steps: str | None,
    prior: str | None,
    one_leg: bool,
) -> None:
    """Raise InputError for options that the kind of study does not take."""
    if transfer and matrix:
        raise InputError("--matrix: got it with --transfer; allowed: one or the other")
    if transfer:
        refuse_given({"--self-rotation": self_rotation}, "without --transfer, which turns to the rear")
    else:
        refuse_given({"--prior": prior, "--one-leg": one_leg or None}, "with --transfer")
    if not matrix:
        refuse_given({"--time-steps": time_steps}, "with --matrix")


def _study(
    robot: str, world: str, options: dict[str, Any], folder: Path, jobs: int | None, dask: str | None
) -> "tuple[StudyResult, list[str]]":
    """Run the paper's experiments; returns the result and its verdicts as lines."""
    from hexctl.backends.sim.world import load_world
    from hexctl.robot.loader import load_robot
    from hexctl.study.plan import StudyPlan
    from hexctl.study.study import run_study

    plan = StudyPlan(robot=load_robot(robot), world=load_world(world), **options)
    with interruptible(plan), StudyProgress() as progress:
        result = run_study(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    return result, _study_lines(result)


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
    from hexctl.adapt.prior.find import prior_folders
    from hexctl.adapt.prior.prior import load_prior
    from hexctl.backends.sim.world import load_randomization
    from hexctl.robot.loader import load_robot
    from hexctl.study.study import run_transfer
    from hexctl.study.transfer.plan import UNSEEN, TransferPlan, find_transfer_prior
    from hexctl.study.transfer.report import transfer_bars

    model = load_robot(robot)
    if prior in (None, "auto"):
        folders = prior_folders(RUNS)
        failure = options.get("failure", "locked")
        believed = find_transfer_prior(
            model, options["legs"], options["duration_s"], folders, failure=failure
        )
    else:
        believed = load_prior(Path(str(prior)))
    plan = TransferPlan(robot=model, family=load_randomization(family or UNSEEN), prior=believed, **options)
    with interruptible(plan), StudyProgress() as progress:
        result = run_transfer(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    bars = transfer_bars(result.findings)
    return result, _verdict_lines((bar.verdict, f"{bar.asked}: {bar.measured}") for bar in bars)


def _matrix(
    settings: dict[str, str], options: dict[str, Any], folder: Path, jobs: int | None, dask: str | None
) -> "tuple[MatrixResult, list[str]]":
    """Run the matrix of verdicts; returns the result and its table as lines."""
    from hexctl.backends.sim.world import load_world
    from hexctl.robot.loader import load_robot
    from hexctl.study.matrix import FAILURES, ROBOTS, TIME_STEPS_S, WORLDS, MatrixPlan, cells_of, run_matrix

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
    with interruptible(plan), StudyProgress() as progress:
        result = run_matrix(plan, folder=folder, jobs=jobs, dask=dask, progress=progress)
    return result, result.to_markdown().splitlines()


#: Length of a tick in ms, and steps of the physics, of which it is a whole number.
TICK_MS = 20
TIME_STEP_MS = Range(low=0.5, high=5, unit="ms")


def _step_s(text: str) -> float:
    """Step of the physics in s from a text in ms; raises InputError unless the tick is a multiple of it."""
    try:
        step_ms = float(TIME_STEP_MS.parse(text))
    except typer.BadParameter as error:
        raise InputError(f"--time-steps: {error.message}") from None
    if abs(round(TICK_MS / step_ms) * step_ms - TICK_MS) > 1e-6:
        raise InputError(f"--time-steps: got {text}; allowed: {TICK_MS} ms divided by a whole number")
    return step_ms / 1000


def _given(**options: Any) -> dict[str, Any]:
    """Options that were given; the plan has the defaults of the others."""
    return {name: value for name, value in options.items() if value is not None}


def _verdict_lines(verdicts: Iterable[tuple[str, str]]) -> list[str]:
    """Verdicts in a column before their statements; reasons why there is none in lines of their own below."""
    pairs = [(verdict.partition(": "), statement) for verdict, statement in verdicts]
    lines = [f"{verdict:<15} {statement}" for (verdict, _, _), statement in pairs]
    reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
    return [*lines, *reasons]


def _study_lines(result: "StudyResult") -> list[str]:
    """Claims, bars that are missed, and the time spent."""
    from hexctl.study.bars import bar_rows
    from hexctl.study.evidence import cm

    findings = result.findings
    lines = _verdict_lines((claim.verdict, claim.claim) for claim in result.claims)
    rows = [row for row in bar_rows(findings, paper_count=False) if row.leg is None and row.holds is not None]
    missed = [row for row in rows if not row.holds]
    lines += [
        f"bar missed: {row.optimizer} {cm(row.mean_m)} after {row.evaluations} evaluations, "
        f"{cm(row.over_m)} over"
        for row in missed
    ]
    if rows and not missed:
        lines.append("bar held by all optimizers, each gait paid for once")
    lines += result.uncertainty.lines
    return [*lines, ", ".join(f"{name} {spent_s:.0f} s" for name, spent_s in result.times_s.items())]


@contextmanager
def interruptible(plan: "Simulated") -> Iterator[None]:
    """Take SIGTERM like Ctrl-C, also where a shell ignores that, and turn either into exit code 130.

    What was simulated of the plan until then is saved; a line on stderr says how much.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    except KeyboardInterrupt:
        from hexctl.study.cache import LandscapeCache

        cache = LandscapeCache()
        saved, total = cache.count(plan.specs())
        print_note(
            f"interrupted: {saved} of {total} gaits are saved in {cache.folder}; the same command continues"
        )
        raise typer.Exit(INTERRUPTED) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


#: More landscapes than this are counted, not named one by one.
MOST_NAMED = 12


class StudyProgress:
    """Progress on stderr: a bar on a terminal, else one line per landscape."""

    def __init__(self) -> None:
        self._bar = make_bar()
        self._task = self._bar.add_task("", total=None, visible=False)
        self._began_s: dict[str, float] = {}

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def begin(self, landscapes: "Sequence[Landscape]") -> None:
        """Show what the cache has and how many gaits are left to simulate."""
        self._now_s = time.perf_counter()
        left = [landscape for landscape in landscapes if not landscape.complete]
        known = [landscape for landscape in landscapes if landscape.complete]
        if len(known) > MOST_NAMED:
            self._line(f"{len(known)} of {len(landscapes)} sets of gaits: from the cache")
            known = []
        for landscape in known:
            self._line(f"{landscape.spec.title}: from the cache")
        gaits = sum(len(landscape.missing) for landscape in left)
        if gaits:
            self._stage("gaits walked (Ctrl-C stops, the same command continues)", gaits)

    def advance(self, landscape: "Landscape", gaits: int) -> None:
        """Count some gaits of a landscape."""
        title, now_s = landscape.spec.title, time.perf_counter()
        spent_s = self._began_s.get(title, 0.0) + now_s - self._now_s
        self._began_s[title], self._now_s = spent_s, now_s
        self._bar.update(self._task, advance=gaits, description=f"{title} (Ctrl-C stops, continue later)")
        if landscape.complete:
            gaits_valid = f"{int(landscape.valid.sum())} of {len(landscape.codes)} gaits valid"
            self._line(f"{title}: {gaits_valid}, {spent_s:.1f} s")

    def stage(self, what: str, total: int) -> None:
        """Begin another part of the work."""
        self._stage(what, total)

    def step(self) -> None:
        """Count one step of the current part."""
        self._bar.update(self._task, advance=1)

    def note(self, text: str) -> None:
        """Print a line above the bar."""
        self._line(text)

    def _stage(self, what: str, total: int) -> None:
        self._bar.remove_task(self._task)
        self._task = self._bar.add_task(what, total=total)

    def _line(self, text: str) -> None:
        print_above(self._bar, text, err=True)
