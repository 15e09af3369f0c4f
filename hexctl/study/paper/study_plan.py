"""The paper's study: all gaits of each failed leg, all optimizers on them, and the paper's claims."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.draws import Distribution
from hexctl.backends.sim.world import World
from hexctl.control.trial_plan import DURATION_S, SelfRotation
from hexctl.errors import argument
from hexctl.options import Range
from hexctl.robot.failure import UNKNOWN
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.experiment import Experiment, json_value, plain, records
from hexctl.study.landscape import N_CODES, NUMBERS, Landscape, LandscapeSpec
from hexctl.study.paper.claims import claims_of, expected_best_rank
from hexctl.study.paper.evidence import EARLY, EARLY_M, LATE, LATE_M, Claim, cm
from hexctl.study.paper.leg_groups import experiments_of
from hexctl.study.paper.searches import ALL, BASELINE, HEURISTICS, NULL_DRAWS, WITHOUT, Findings, search_all
from hexctl.study.paper.study_figures import study_drawings
from hexctl.study.plan import LandscapePlan, check_legs, check_setting, check_walks
from hexctl.study.report_page import Section, Table, reading
from hexctl.study.study_options import ALL_LEGS, BUDGET, RUNS, STUDY_SEED
from hexctl.study.versions import code_versions
from hexctl.study.walking import Work

if TYPE_CHECKING:
    from pandas import DataFrame

#: Default self-rotation of the landscapes that the optimizers search.
WITH: SelfRotation = "rear"

#: A seed shows leg and run as decimal digits, which limits their numbers.
MAX_SEED = int(STUDY_SEED.high)


#: Factors on the world's own values that the paper leaves open. Joint offsets and a shifted trunk are not
#: among them, because they favour legs: legs of one experiment stay one.
FACTORS = {
    "friction": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "servo_stiffness": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "contact_time_s": Distribution(low=1 / 1.5, high=1.5, scale="log"),
}

#: Seed of the design: the same world always has the same neighbours.
SEED = 13

#: More worlds narrow the intervals too little for their computing time.
WORLDS = Range(low=1, high=100, whole=True)


#: Numbers of evaluations at which tables show the curves, up to the budget.
SHOWN = (1, 10, 20, 40, 60, 120)


def landscapes_of(findings: Findings) -> "DataFrame":
    """Return the landscapes of the first world in numbers, a row for each."""
    from pandas import DataFrame

    return DataFrame(
        {
            "leg": leg,
            "self_rotation": rotation,
            "gaits": len(landscape.codes),
            "valid": int(landscape.valid.sum()),
            "left_share": landscape.left_share,
            "within_0.10_m": landscape.within(EARLY_M),
            "within_0.025_m": landscape.within(LATE_M),
            "best_m": landscape.best_m,
        }
        for (world, leg, rotation), landscape in findings.landscapes.items()
        if not world
    )


def study_json(findings: Findings) -> dict[str, Any]:
    """Return settings and results of a study as JSON values; null if there is no number."""
    plan = findings.plan
    names = ("legs", "optimizers", "runs", "budget", "duration_s", "seed", "failure", "self_rotation")
    return {
        "robot": plan.robot.name,
        "world": plan.world.model_dump(mode="json"),
        **plain(plan, *names, "worlds"),
        "code": code_versions(),
        "claims": [{**asdict(claim), "verdict": claim.verdict} for claim in findings.claims],
        "landscapes": records(landscapes_of(findings)),
        "convergence": [_curve_json(findings, name) for name in plan.optimizers],
    }


def _curve_json(findings: Findings, optimizer: str) -> dict[str, Any]:
    curve = findings.curves[ALL, optimizer].loc[_shown(findings)]
    means = {
        name: {str(at): json_value(value) for at, value in curve[name].items()}
        for name in ("mean_m", "std_m", "share_of_runs")
    }
    return {"optimizer": optimizer, **means}


def _shown(findings: Findings) -> list[int]:
    return [count for count in SHOWN if count <= findings.plan.budget]


def study_tables(findings: Findings) -> "dict[str, DataFrame]":
    """Return landscapes (a row per gait), convergence (per evaluation) and runs (per run and evaluation)."""
    from pandas import concat

    head = ["leg", "optimizer"]
    curves = {key: curve for key, curve in findings.curves.items() if key[0] != ALL}
    runs = findings.first_runs[[*head, "seed", "codes", "scores", "best_m"]]
    runs = runs.rename(columns={"codes": "code", "scores": "score"})
    long = runs.assign(evaluation=[range(1, findings.plan.budget + 1)] * len(runs))
    long = long.explode(["evaluation", "code", "score", "best_m"])
    types = {"evaluation": int, "code": int, "score": float, "best_m": float}
    walked = [one for (world, *_), one in findings.landscapes.items() if not world]
    return {
        "landscapes": concat([_gaits(landscape) for landscape in walked]),
        "convergence": concat(curves, names=[*head, "evaluation"]).reset_index(),
        "runs": long[[*head, "seed", "evaluation", "code", "score", "best_m"]].astype(types),
    }


def _gaits(landscape: Landscape) -> "DataFrame":
    from pandas import DataFrame

    spec = landscape.spec
    paths = [path[np.isfinite(path[:, 0])] for path in landscape.paths_m]
    return DataFrame(
        {
            "code": landscape.codes,
            "robot": spec.robot.name,
            "leg": spec.leg,
            "failure": spec.failure,
            "self_rotation": spec.self_rotation,
            "slots": [spec.space.slots_of(code) for code in landscape.codes.tolist()],
            "status": landscape.status.tolist(),
            "final_m": landscape.final_m,
            **{name: landscape.number(name) for name in NUMBERS},
            "path_progress_m": [path[:, 0] for path in paths],
            "path_deviation_m": [path[:, 1] for path in paths],
        }
    )


def study_sections(findings: Findings) -> Iterator[Section]:
    """Return the parts of the report of a study."""
    yield Section("", [_settings(findings)])
    header = ("claim of the paper", "holds here if", "measured here", "for comparison", "verdict")
    rows = [(one.claim, one.rule, one.measured, _beside(one), one.verdict) for one in findings.claims]
    yield Section("Claims of the paper", [Table(header, rows)])
    ranks = {"early": expected_best_rank(EARLY), "late": expected_best_rank(LATE)}
    yield reading("study", draws=NULL_DRAWS, **ranks)
    yield Section("Landscapes", [_landscapes(findings)])
    yield Section("Means over all legs and runs, with standard deviation", [_means(findings)])


def _settings(findings: Findings) -> str:
    plan = findings.plan
    return (
        f"Robot {plan.robot.name}; legs {', '.join(str(leg) for leg in plan.legs)}, each {plan.failure}; all "
        f"120 gaits, {plan.duration_s:g} s each, self-rotation {' and '.join(plan.rotations)}; claims judged "
        f"over {plan.worlds} world{'s' * (plan.worlds > 1)}; then {', '.join(plan.optimizers)} with "
        f"{plan.runs} seeded runs of {plan.budget} evaluations, looked up in the landscapes with "
        f"self-rotation {plan.self_rotation}. "
        f"Seed {plan.seed}."
    )


def _beside(claim: Claim) -> str:
    null = f"random numbers: {claim.null}" if claim.null else ""
    symmetric = f"symmetry: {claim.symmetric}" if claim.symmetric else ""
    return "; ".join(text for text in (claim.beside, symmetric, null) if text)


def _landscapes(findings: Findings) -> Table:
    header = ("leg", "self-rotation", "gaits", "valid", "end left", "within 10 cm", "within 2.5 cm", "best")
    texts = {"left_share": "{:.0%}".format, "best_m": cm}
    rows = [
        [texts.get(name, str)(value) for name, value in row.items()]
        for row in landscapes_of(findings).to_dict("records")
    ]
    return Table(header, rows)


def _means(findings: Findings) -> Table:
    """A row for each optimizer, with mean, standard deviation and share of the runs at some evaluations."""

    def text(optimizer: str, after: int) -> str:
        at = findings.curves[ALL, optimizer].loc[after]
        share = "" if at["share_of_runs"] == 1 else f" [{at['share_of_runs']:.0%} of the runs]"
        return f"{cm(at['mean_m'])} ± {cm(at['std_m'])}{share}"

    cells = {f"after {after}": partial(text, after=after) for after in _shown(findings)}
    return Table.of(findings.plan.optimizers, {"optimizer": str, **cells})


@dataclass(frozen=True, kw_only=True)
class StudyPlan(LandscapePlan, Experiment[Findings]):
    """Settings of one study; the defaults are the paper's.

    Attributes:
        optimizers: names as in `hexctl.adapt.optimizers.shipped`.
        runs: seeded runs of each optimizer on each leg.
        failure: of each leg, as `parse_kind` reads it, such as `limp` or `weak:0.5`.
        self_rotation: before the walks that the optimizers search.
        worlds: number of worlds in which claims are judged: `world` and others like it (`nearby_worlds`).
        by_symmetry: simulate one leg of each experiment (`experiments_of`) and map it to the others. In the
            worlds like `world` this is always done.
        without_gaits: number of gaits walked without self-rotation, drawn from all.
    """

    NAME: ClassVar[str] = "study"
    REPORT: ClassVar[str] = "report.html"
    HEADING: ClassVar[str] = "Gaits for a failed leg: the paper's experiments repeated"

    numbers = staticmethod(study_json)
    tables = staticmethod(study_tables)
    drawings = staticmethod(study_drawings)
    sections = staticmethod(study_sections)

    robot: Robot
    world: World = field(default_factory=World)
    legs: tuple[int, ...] = ALL_LEGS
    optimizers: tuple[str, ...] = (*HEURISTICS, BASELINE)
    runs: Annotated[int, RUNS] = 30
    budget: Annotated[int, BUDGET] = 120
    duration_s: Annotated[float, DURATION_S] = 30.0
    seed: Annotated[int, STUDY_SEED] = 0
    failure: str = "locked"
    self_rotation: SelfRotation = WITH
    worlds: Annotated[int, WORLDS] = 1
    by_symmetry: bool = False
    without_gaits: Annotated[int, Range(low=1, high=N_CODES, whole=True)] = N_CODES

    @property
    def rotations(self) -> tuple[SelfRotation, ...]:
        """Self-rotations of the landscapes."""
        return tuple(dict.fromkeys((WITHOUT, self.self_rotation)))

    def specs(self) -> list[LandscapeSpec]:
        """Return the specs of all landscapes, world by world and leg by leg."""
        return [spec for specs in self.specs_by_world() for spec in specs]

    def specs_by_world(self) -> list[list[LandscapeSpec]]:
        """Return the specs of the landscapes of each world, the plan's own world first."""
        worlds = nearby_worlds(self.world, self.worlds)
        return [self._specs_in(world, number) for number, world in enumerate(worlds)]

    def _specs_in(self, world: World, number: int) -> list[LandscapeSpec]:
        walked = {rotation: self._legs_walked(world, number, rotation) for rotation in self.rotations}
        return [
            LandscapeSpec(
                robot=self.robot,
                world=world,
                leg=leg,
                self_rotation=rotation,
                duration_s=self.duration_s,
                failure=self.failure,
                seed=self.seed,
                codes=self._codes(rotation),
                place=f"world {number + 1} of {self.worlds}" if number else "",
            )
            for leg in self.legs
            for rotation in self.rotations
            if leg in walked[rotation]
        ]

    def _legs_walked(self, world: World, number: int, rotation: str) -> tuple[int, ...]:
        """Simulated legs in a world: all, or the first one of each experiment."""
        if number == 0 and not self.by_symmetry:
            return self.legs
        return tuple(group[0] for group in self.experiments(world, rotation))

    def experiments(self, world: World, rotation: str) -> tuple[tuple[int, ...], ...]:
        """Return the legs in groups of one experiment each, in a world and with a self-rotation."""
        return experiments_of(self.robot, world, rotation, self.legs, self.failure)

    def _codes(self, rotation: str) -> tuple[int, ...]:
        """Gaits of a landscape; the optimizers search all of them."""
        if rotation == self.self_rotation or self.without_gaits >= N_CODES:
            return tuple(range(1, N_CODES + 1))
        drawn = np.random.default_rng(0).permutation(N_CODES)[: self.without_gaits] + 1
        return tuple(sorted(drawn.tolist()))

    def seed_of(self, leg: int, run: int, world: int = 0) -> int:
        """Return the seed of a run, counted from 0; `hexctl adapt --seed` repeats the run with it.

        Runs in other worlds, counted from 1, have other seeds.
        """
        return world * (MAX_SEED + 1) * 10_000 + self.seed * 10_000 + leg * 1_000 + run

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        super().check()
        check_legs(self.legs)
        parse_kind(self.legs[0], self.failure)
        allowed = "one that is the same in every leg; the transfer benchmark takes unknown"
        check_setting("failure", self.failure, self.failure != UNKNOWN, allowed)
        for name in self.optimizers:
            make_optimizer(name, GaitSpace((self.legs[0],)), self.seed)
        check_walks(self.specs())

    def find(self, work: Work) -> Findings:
        """Walk all gaits, search the landscapes and judge the claims."""
        landscapes = work.evaluate(self.specs())
        searched = [spec for spec in self.specs_by_world()[0] if spec.self_rotation == self.self_rotation]
        work.progress.stage("searches, leg by leg", len(searched))
        found = search_all(self, landscapes, work.progress.step)
        return replace(found, claims=tuple(claims_of(found)))

    def lines(self, found: Findings) -> list[str]:
        """Return the verdicts in a column before the claims, and below them each reason once."""
        pairs = [(claim.verdict.partition(": "), claim.claim) for claim in found.claims]
        lines = [f"{verdict:<15} {claim}" for (verdict, _, _), claim in pairs]
        reasons = dict.fromkeys(f"{verdict}: {reason}" for (verdict, _, reason), _ in pairs if reason)
        return [*lines, *reasons]


def nearby_worlds(world: World, count: int) -> list[World]:
    """The world itself and `count` - 1 others like it.

    The others differ in friction, servo stiffness and contact time, by `FACTORS`, in a quasi-random
    design; any first part of it covers the ranges. Raises InputError for a count outside 1..`WORLDS`.
    """
    WORLDS.check(argument("worlds"), count)
    if count == 1:
        return [world]
    shares = _design(count - 1)
    return [world, *(_varied(world, row) for row in shares)]


def _design(count: int) -> list[list[float]]:
    """Points of a Sobol design in the unit cube, one row per world."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(len(FACTORS), scramble=True, rng=np.random.default_rng(SEED))
    # One at a time keeps SciPy from warning about unbalanced draws.
    return [sequence.random(1)[0].tolist() for _ in range(count)]


def _varied(world: World, shares: Sequence[float]) -> World:
    values = world.model_dump()
    for (name, factor), share in zip(FACTORS.items(), shares, strict=True):
        values[name] = float(values[name] * factor.at(np.array(share)))
    return World.model_validate(values)
