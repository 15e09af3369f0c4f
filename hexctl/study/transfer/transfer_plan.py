"""The transfer benchmark: adaptation in worlds outside every prior."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import BAYES
from hexctl.adapt.prior.prior import WHOLE_S, Prior, PriorKey, in_whole_steps
from hexctl.adapt.prior.prior_choice import DEFAULT_TARGET_M
from hexctl.adapt.prior.samples import Samples, covers, samples_of
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.world import DomainRandomization
from hexctl.control.scoring.score import progress_floor_m
from hexctl.control.trial import LOOK_TICKS, Enough
from hexctl.control.trial_plan import DURATION_S
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.experiment import Experiment, json_value, plain, where
from hexctl.study.landscape import PATH_STRIDE, Landscape, LandscapeSpec
from hexctl.study.paper.evidence import clustered_error, cm, cm_with_error
from hexctl.study.paper.searches import curve_of
from hexctl.study.paper.study_plan import BASELINE, HEURISTICS
from hexctl.study.plan import LandscapePlan, check_legs, check_setting, check_walks
from hexctl.study.priors.prior_building import deflection_of
from hexctl.study.report_page import Section, Table, markdown, reading
from hexctl.study.study_options import ALL_LEGS, BUDGET, RUNS, STUDY_SEED, WORLDS
from hexctl.study.versions import code_versions
from hexctl.study.walking import Work
from hexctl.types import N_LEGS, FloatArray

if TYPE_CHECKING:
    from pandas import DataFrame

#: The default family of worlds.
UNSEEN = "transfer"

#: Earlier worlds of the family were used to develop `bayes`.
FIRST_WORLD = 65

MAX_WORLDS = int(WORLDS.high)

#: `bayes` with early stopping.
EARLY = "bayes-early"

#: Optimizers that use a prior.
PRIORED = (BAYES, EARLY)

#: Trials at which tables show the curves, up to the budget.
SHOWN = (1, 2, 3, 4, 6, 8, 10, 15, 20, 40, 60)

#: Statistics of curves and their titles.
STATISTICS = {"mean_m": "mean", "median_m": "median", "p90_m": "90th percentile"}


def places(runs: "DataFrame") -> int:
    """Return the number of landscapes."""
    return int(runs["place"].nunique())


@dataclass(frozen=True, kw_only=True)
class TransferPlan(LandscapePlan, Experiment["DataFrame"]):
    """Settings of the transfer benchmark; it finds a row for each run of a search, see `search_worlds`.

    Attributes:
        family: held-out worlds, never those of a prior.
        optimizers: names as in `hexctl.adapt.optimizers.shipped`, `bayes` and `bayes-early`.
        runs: seeded runs of each optimizer in each world and leg; `bayes` has no seed and one run.
        failure: of each leg, as `parse_kind` reads it; with `unknown` each world draws what breaks, and the
            searches do not know it.
        one_leg: one leg fails in each world, the next one in the next world, instead of all in every world.
    """

    NAME: ClassVar[str] = "transfer"
    REPORT: ClassVar[str] = "transfer.html"
    HEADING: ClassVar[str] = "Adaptation in worlds outside every prior"

    robot: Robot
    family: DomainRandomization
    prior: Prior
    worlds: Annotated[int, WORLDS] = 30
    legs: tuple[int, ...] = ALL_LEGS
    optimizers: tuple[str, ...] = (*PRIORED, *HEURISTICS, BASELINE)
    runs: Annotated[int, RUNS] = 5
    budget: Annotated[int, BUDGET] = 60
    duration_s: Annotated[float, DURATION_S] = 30.0
    seed: Annotated[int, STUDY_SEED] = 0
    failure: str = "locked"
    one_leg: bool = False

    def specs(self) -> list[LandscapeSpec]:
        """Specs of the landscapes, world by world; a world's number is the seed of its draws."""
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation="rear",
                duration_s=self.duration_s,
                failure=self.failure,
                seed=number,
                place=f"world {number} ({self.family.kind(number).name})",
            )
            for number, world in enumerate(self.family.members(FIRST_WORLD, self.worlds), FIRST_WORLD)
            for leg in ((self.legs[number % len(self.legs)],) if self.one_leg else self.legs)
        ]

    def kind_of(self, spec: LandscapeSpec) -> str:
        """Kind of a landscape's world."""
        return self.family.kind(spec.seed).name

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_legs(self.legs)
        parse_kind(1, self.failure)
        for name in self.optimizers:
            if name not in PRIORED:
                make_optimizer(name, GaitSpace((self.legs[0],)), self.seed, part="optimizers")
        if self.family.model_dump(mode="json") == self.prior.origin.get("family"):
            raise InputError("transfer: the prior was built from these worlds; allowed: a family of others")
        missing = [leg for leg in self.legs if not covers(self.robot, "rear", self.prior.legs, leg)]
        if missing:
            raise InputError(
                f"prior: has nothing on legs {missing}; allowed: {argument('legs')} {list(self.prior.legs)}"
            )
        whole = in_whole_steps(self.duration_s)
        check_setting("duration_s", f"{self.duration_s:g}", whole, f"multiples of {WHOLE_S:g} s")
        differences = self.prior.key.differences(PriorKey.of(self.robot, self.specs()[0].trial(1).plan))
        if differences:
            raise InputError(f"prior: is for {', '.join(differences)}; allowed: a prior for these trials")
        check_walks(self.specs())

    def seed_of(self, spec: LandscapeSpec, run: int) -> int:
        """Seed of a run."""
        return ((self.seed * MAX_WORLDS + spec.seed) * N_LEGS + spec.leg) * 1_000 + run

    def find(self, work: Work) -> "DataFrame":
        """Walk all gaits and run every optimizer in every landscape."""
        landscapes = work.evaluate(self.specs())
        work.progress.stage("searches, world by world", len(landscapes))
        return search_worlds(self, landscapes, work.progress.step)

    def numbers(self, findings: "DataFrame") -> dict[str, Any]:
        """Return settings and results as plain JSON values."""
        floor, error_m = floor_m(findings)
        names = ("worlds", "legs", "optimizers", "runs", "budget", "duration_s")
        return {
            "robot": self.robot.name,
            **plain(self, *names),
            "target_m": DEFAULT_TARGET_M,
            "code": code_versions(),
            "landscapes": places(findings),
            "landscapes_without_valid_gait": len(self.specs()) - places(findings),
            "best_of_all_m": json_value(floor),
            "best_of_all_standard_error_m": json_value(error_m),
            "optimizers_found": {
                name: self._found(where(findings, optimizer=name)) for name in self.optimizers
            },
        }

    def _found(self, runs: "DataFrame") -> dict[str, Any]:
        curve = curve_of(runs)
        curve["standard_error_m"] = standard_error_m(runs)
        return {
            **{
                name: {str(count): json_value(curve[name][count]) for count in self._shown}
                for name in (*STATISTICS, "standard_error_m")
            },
            "walked_s": json_value(walked_s(runs)),
        }

    @property
    def _shown(self) -> list[int]:
        return [count for count in SHOWN if count <= self.budget]

    def lines(self, findings: "DataFrame") -> list[str]:
        """Return the table of the curves."""
        return markdown(self._curves(findings))

    def tables(self, findings: "DataFrame") -> "Mapping[str, DataFrame]":
        """Return the table of all trials: a row for each trial of each run."""
        head, trials = ["world", "kind", "leg", "optimizer", "run"], ["best_m", "walked_s"]
        runs = findings[[*head, "codes", *trials]].rename(columns={"codes": "code"})
        for name in trials:
            pairs = zip(runs[name], runs["code"], strict=True)
            runs[name] = [values[: len(codes)] for values, codes in pairs]
        runs["trial"] = [range(1, len(codes) + 1) for codes in runs["code"]]
        table = runs[[*head, "trial", "code", *trials]].explode(["trial", "code", *trials])
        return {"transfer": table.astype({"trial": int, "code": int, "best_m": float, "walked_s": float})}

    def sections(self, findings: "DataFrame") -> Iterator[Section]:
        """Return the parts of the report."""
        settings = (
            f"Robot {self.robot.name}; legs {', '.join(str(leg) for leg in self.legs)} locked, self-rotation "
            f"rear, {self.duration_s:g} s a trial; {self.worlds} worlds; {self.budget} trials; {self.runs} "
            f"runs of each search that has a seed; prior of {self.prior.worlds} worlds a leg; "
            f"target {cm(DEFAULT_TARGET_M)}."
        )
        floor = cm_with_error(*floor_m(findings))
        reach = (
            f"{places(findings)} of {len(self.specs())} worlds and legs have a valid gait, the others are "
            f"left out. Best of all gaits {floor}. Means ± standard error over worlds."
        )
        yield Section("", [settings])
        yield reading("transfer")
        yield Section("All worlds and legs", [reach, self._curves(findings)])

    def _curves(self, runs: "DataFrame") -> Table:
        rows: list[list[str]] = []
        for name in self.optimizers:
            some = where(runs, optimizer=name)
            curve, error_m = curve_of(some), standard_error_m(some)
            means = [cm_with_error(curve["mean_m"][count], error_m[count - 1]) for count in self._shown]
            rows.append([f"{name}, mean", *means])
            rows += [
                [f"{name}, {what}", *[cm(curve[f"{what}_m"][count]) for count in self._shown]]
                for what in ("median", "p90")
            ]
        return Table(("deviation", *[f"after {count}" for count in self._shown]), rows)


def search_worlds(
    plan: TransferPlan, landscapes: Sequence[Landscape], on_landscape: Callable[[], None] = lambda: None
) -> "DataFrame":
    """Run every optimizer in every landscape with a valid gait; a row for each run.

    Columns: place (number of the landscape), world, kind, leg, deviation of the best valid gait of the
    landscape, optimizer, run, and those of `run_course`. `on_landscape` is called after each
    landscape. Raises RobotFaultError if no gait is valid anywhere.
    """
    from pandas import DataFrame

    if not any(landscape.valid.any() for landscape in landscapes):
        raise RobotFaultError("transfer: no gait is valid in any world and leg; there is nothing to search")
    samples = {leg: samples_of(plan.prior, plan.robot, leg) for leg in plan.legs}
    rows: list[dict[str, Any]] = []
    for place, landscape in enumerate(landscapes):
        if not landscape.valid.any():
            continue
        findings = {"place": place, "best_of_all_m": landscape.best_m}
        rows += [findings | row for row in _courses(plan, landscape, samples[landscape.spec.leg])]
        on_landscape()
    return DataFrame(rows)


def _courses(plan: TransferPlan, landscape: Landscape, samples: Samples) -> Iterator[dict[str, Any]]:
    spec = landscape.spec
    deflection_rad = None if plan.prior.sag_rad is None else deflection_of(spec)
    for name in plan.optimizers:
        for run in range(1 if name in PRIORED else plan.runs):
            search = make_search(plan, landscape, name, run, samples, deflection_rad)
            course = run_course(search, landscape, plan.budget, early=name == EARLY)
            head = {"world": spec.seed, "kind": plan.kind_of(spec), "leg": spec.leg}
            yield {**head, "optimizer": name, "run": run, **course}


def make_search(
    plan: TransferPlan,
    landscape: Landscape,
    optimizer: str,
    run: int,
    samples: Samples,
    deflection_rad: FloatArray | None = None,
) -> Optimizer:
    """Return the search of a run; some priors need `deflection_rad`, static and in the stance."""
    spec = landscape.spec
    seed = plan.seed_of(spec, run)
    if optimizer not in PRIORED:
        return Deduplication(make_optimizer(optimizer, spec.space, seed), seed)
    # No `uncertainty_m`: the simulated world stands for the robot here, and its walks are the truth.
    return Bayes(
        spec.space,
        seed,
        sag_rad=deflection_rad,
        samples=samples,
        target_m=DEFAULT_TARGET_M,
        duration_s=plan.duration_s,
        floor_m=progress_floor_m(plan.robot, spec.trial(1).plan, plan.duration_s),
    )


def run_course(
    search: Optimizer, landscape: Landscape, budget: int, *, early: bool = False
) -> dict[str, Any]:
    """Run a search that looks up every walk in a landscape; `early` ends decided walks early.

    Returns:
        `codes`: the gaits walked, in order, (T,); fewer than the budget if the search was sure.
        `best_m`: deviation of the best gait after each trial, (budget,), constant after the last one; before
            a valid gait was found, that of the worst valid gait.
        `walked_s`: the time walked, likewise.
    """
    codes: list[int] = []
    bests, walked = [], []
    best_m, walked_s = landscape.worst_m, 0.0
    while len(codes) < budget and not search.finished and not search.exhausted:
        (code,) = search.ask(1)
        shown = walk_of(landscape, code, search.early_stopping(code) if early else None)
        row = landscape.row_of(code)
        score = float(landscape.scores[row]) if shown.status == "ok" else INVALID_SCORE
        search.tell([code], [score], [shown])
        codes.append(code)
        best_m, walked_s = min(best_m, score), walked_s + shown.duration_s
        bests.append(best_m)
        walked.append(walked_s)
    left = budget - len(codes)
    return {
        "codes": np.array(codes, dtype=np.int64),
        "best_m": np.array(bests + [best_m] * left),
        "walked_s": np.array(walked + [walked_s] * left),
    }


def walk_of(landscape: Landscape, code: int, enough: Enough | None = None) -> Observation:
    """Walk of a gait as a session would observe it, cut short where early stopping ends it."""
    row = landscape.row_of(code)
    path = landscape.paths_m[row]
    path = path[np.isfinite(path[:, 0])].astype(float)
    point_s = PATH_STRIDE * PERIOD_S
    if enough is not None:
        # A point of the path stands for all ticks up to it; `enough` needs no more.
        per_look = LOOK_TICKS // PATH_STRIDE
        for points in range(per_look, len(path), per_look):
            if enough(np.repeat(path[:points], PATH_STRIDE, axis=0)):
                seconds = points * point_s
                return Observation(
                    path_m=path[:points], duration_s=seconds, yaw_change_rad=None, status="cut_short"
                )
    yaw_rad = float(landscape.number("yaw_change_rad")[row])
    return Observation(
        path_m=path,
        duration_s=len(path) * point_s,
        yaw_change_rad=yaw_rad if np.isfinite(yaw_rad) else None,
        status=str(landscape.status[row]),
    )


def floor_m(runs: "DataFrame") -> tuple[float, float]:
    """Mean deviation of the best of all gaits, a lower bound of every search, and its standard error."""
    places = runs.drop_duplicates("place")
    best_m = places["best_of_all_m"].to_numpy()
    return float(np.mean(best_m)), float(clustered_error(best_m, places["world"].to_numpy()))


def standard_error_m(runs: "DataFrame") -> FloatArray:
    """Standard error over worlds of the mean after each trial, (B,), in m; NaN for a single world."""
    places = [some for _, some in runs.groupby("place", sort=False)]
    means_m = np.array([np.mean(some["best_m"].to_list(), axis=0) for some in places])
    return clustered_error(means_m, np.array([some["world"].iloc[0] for some in places]))


def walked_s(runs: "DataFrame") -> float:
    """Mean walking time of a run, in s."""
    return float(np.mean([seconds[-1] for seconds in runs["walked_s"]]))
