"""Gain of a search over its trials: in speed of steered walks, in distance from the line in open loop.

Speed: all gaits walk once in held-out worlds, and searches are replayed on these walks. Each search can
therefore be judged after any number of trials. `python -m benchmarks.search_gain` prints by how much the best
gait of each search is slower than the fastest one.

Open loop: searches walk in held-out worlds, one locked leg in each, legs in turn, with 1 cm of noise on the
path. `python -m benchmarks.search_gain open-loop transfer 8110 30 trim` prints the figures of one search of
`OPEN_LOOP`. Every walk counts, and there is no baseline. The best walk is the one with the smallest measured
distance; its true distance is printed.

Fast: the gait `auto` walks at the pace of a robot and with `fast`, with three failed legs in each world, in
turn locked, limp and missing. `python -m benchmarks.search_gain fast transfer 9800 8 phantomx` prints both.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer, Trim
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.score_bayes import ScoreBayes
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.drift_belief import DriftBelief
from hexctl.adapt.prior.prior import ScorePrior, load_prior, load_score_prior
from hexctl.adapt.prior.prior_choice import DEFAULT_TARGET_M
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import DriftSamples, drift_samples_of, ranked_codes, score_samples_of
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import DomainRandomization, World, load_randomization
from hexctl.control.assessment.score import progress_floor_m
from hexctl.control.assessment.static_stability import slots_by_stability, stable_slots_of, usual_posture
from hexctl.control.assessment.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.turning import body_heading_rad
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec, plan_of
from hexctl.study.held_out import with_sensors
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.walk_cache import FOLDER, WalkCache
from hexctl.study.walking import Work
from hexctl.types import N_LEGS, FloatArray

#: The family of the worlds and its members, which nothing was built or tuned with.
FAMILY, FIRST_WORLD, WORLDS = "transfer", 300, 10

#: The prior that is believed.
PRIOR = "ant-locked-none-30s-line.npz"

#: Numbers of trials after which regrets are printed; 0 is `--gait auto` alone.
AFTER = (0, 1, 2, 3, 5, 10)

#: Runs of searches that draw random numbers.
RUNS = 100

#: Kept points, five a second, over whose mean the way of a walk is taken for the regret: with position noise
#: of a centimetre the last one alone would make the luckiest gait the best.
END_POINTS = 10

#: The prior of walks in open loop.
OPEN_LOOP_PRIOR = "ant-locked-rear-30s.npz"

#: Makes the search of a run.
MakeSearch = Callable[[int], Optimizer]


def specs(robot: Robot, family: DomainRandomization, first: int, worlds: int) -> list[LandscapeSpec]:
    """Landscapes of some members of a family under the hold `line`, one locked leg in each, legs in turn."""
    return [
        LandscapeSpec(
            robot=robot,
            world=with_sensors(world),
            leg=1 + (number - first) % N_LEGS,
            self_rotation="none",
            seed=number,
            hold="line",
            posture=usual_posture("line"),
            place=f"world {number} ({family.kind(number).name})",
        )
        for number, world in enumerate(family.members(first, worlds), first)
    ]


def session_scores(landscape: Landscape) -> FloatArray:
    """Scores of the gaits in a session: time per metre, (gaits,)."""
    distance_m = np.where(landscape.valid, landscape.number("distance_m"), 1.0)
    return np.where(landscape.valid, landscape.spec.duration_s / distance_m, INVALID_SCORE)


def losses(landscape: Landscape) -> FloatArray:
    """By which share each gait is slower than the fastest valid one, (gaits,); 1 for an invalid one."""
    way_m = np.nanmean(np.where(landscape.valid[:, np.newaxis], _ends_m(landscape), 0.0), axis=1)
    return np.asarray(1 - way_m / way_m.max())


def _ends_m(landscape: Landscape) -> FloatArray:
    ends_m: FloatArray = landscape.paths_m[:, -END_POINTS:, 0].astype(float)
    return ends_m


def codes_of(search: Optimizer, scores: FloatArray, trials: int) -> list[int]:
    """Codes that a search walks, told their scores."""
    codes: list[int] = []
    while len(codes) < trials:
        asked = search.ask(1)
        search.tell(asked, [float(scores[code - 1]) for code in asked])
        codes += asked
    return codes


def regrets(landscape: Landscape, codes: Sequence[int]) -> list[float]:
    """Loss of the best gait so far by its score after each of `AFTER`, the gait `auto` walked before."""
    spec, scores, lost = landscape.spec, session_scores(landscape), losses(landscape)
    auto = spec.space.code_of(stable_slots_of(spec.robot, spec.trial(1).plan))
    walked = [auto, *codes]
    return [float(lost[min(walked[: 1 + count], key=lambda code: scores[code - 1]) - 1]) for count in AFTER]


def searches(prior: ScorePrior, robot: Robot, leg: int) -> Mapping[str, tuple[int, MakeSearch]]:
    """Searches of a leg by name: how many runs each has, and what makes the search of a run."""
    space, samples = GaitSpace((leg,)), score_samples_of(prior, robot, leg, "speed")

    def shuffled(run: int) -> Optimizer:
        order = np.random.default_rng(run).permutation(space.size)
        told = replace(samples, log_scores=samples.log_scores[:, order], valid=samples.valid[order])
        return ScoreBayes(space, 0, samples=told)

    return {
        "bayes": (1, lambda _run: ScoreBayes(space, 0, samples=samples)),
        "random": (RUNS, lambda run: Deduplication(RandomSearch(space, run), run)),
        "bayes, codes of the prior shuffled": (RUNS, shuffled),
    }


def table(prior: ScorePrior, landscapes: Sequence[Landscape]) -> dict[str, FloatArray]:
    """Regrets of each search in each world after each of `AFTER`, the mean over its runs, (worlds, n)."""
    rows: dict[str, list[FloatArray]] = {}
    for landscape in landscapes:
        spec, scores = landscape.spec, session_scores(landscape)
        ranking = ranked_codes(prior, spec.robot, spec.leg)
        rows.setdefault("order of the prior", []).append(np.array(regrets(landscape, ranking)))
        for name, (runs, make) in searches(prior, spec.robot, spec.leg).items():
            each = [regrets(landscape, codes_of(make(run), scores, AFTER[-1])) for run in range(runs)]
            rows.setdefault(name, []).append(np.mean(each, axis=0))
    return {name: np.array(values) for name, values in rows.items()}


def lines_of(rows: Mapping[str, FloatArray]) -> list[str]:
    """Table in Markdown: mean regret over the worlds, its standard error and the maximum, in percent."""
    head = ["slower by, in %", *(f"after {count}" for count in AFTER)]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, values in rows.items():
        cells = [_cell(100 * column) for column in values.T]
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def _cell(percent: FloatArray) -> str:
    return f"{_mean(percent)} ({percent.max():.1f})"


def _mean(percent: FloatArray) -> str:
    return f"{percent.mean():.1f} ± {percent.std(ddof=1) / np.sqrt(percent.size):.1f}"


#: Sensors of walks in open loop, and the target.
POSITION_NOISE_M, TARGET_M = 0.01, DEFAULT_TARGET_M

#: Walks of an open-loop search whose end is not confirmed.
MOST_WALKS = 6


class SureOfGain(DriftBelief):
    """Learns no gain of the turn."""

    gain_sd = 1e-6


class KnownGain(TrimSearch):
    """Trims the turn by its usual gain."""

    belief = SureOfGain


class NoCourse(TrimSearch):
    """Trims only the turn."""

    def trim(self, code: int) -> Trim:
        """Trim without a course."""
        return Trim(0.0, super().trim(code).turn_rad_s)


def _trim(
    known: DriftSamples, stable: Sequence[int], *, kind: type[TrimSearch] = TrimSearch, prior: bool = True
) -> Optimizer:
    robot = load_robot("ant")
    plan = TrialPlan(gait=make_gait(robot, "demo"))
    floor_m = progress_floor_m(robot, plan, plan.duration_s)
    cycle_s = 1 / robot.gait.pace_hz
    samples = known if prior else None
    return kind(GaitSpace((known.leg,)), 0, codes=stable, samples=samples, cycle_s=cycle_s, floor_m=floor_m)


#: Searches in open loop by name, and what they leave out.
OPEN_LOOP: dict[str, Callable[[DriftSamples, Sequence[int]], Optimizer]] = {
    "trim": _trim,
    "no-prior": partial(_trim, prior=False),
    "no-offset": partial(_trim, kind=NoCourse),
    "no-secant": partial(_trim, kind=KnownGain),
    "random": lambda known, _: Deduplication(RandomSearch(GaitSpace((known.leg,)), known.leg), 0),
}


@dataclass(kw_only=True)
class OpenLoop:
    """A search in one world: its walks by measured and true distance from the line, in their order.

    `confirmed` is the number of walks after which one within the target was repeated within it, 0 for none.
    """

    number: int
    world: World
    leg: int
    search: Optimizer
    walks_m: list[tuple[float, float]] = field(default_factory=list)
    codes: list[int] = field(default_factory=list)
    confirmed: int = 0
    again: Trim | None = None

    def trial(self) -> SimTrial:
        """The next walk, or the last one again to confirm it."""
        code, trim = self.codes[-1] if self.again else 0, self.again
        if trim is None:
            (code,) = self.search.ask()
            trim = self.search.trim(code)
        self.codes.append(code)
        gait = replace(make_gait(load_robot("ant"), "demo"), slots=self.search.space.slots_of(code))
        plan = TrialPlan(gait=gait, belief=Failure(leg=self.leg))
        if trim is not None:
            plan = replace(plan, trim_rad=trim.course_rad, turn_trim_rad_s=trim.turn_rad_s)
        return SimTrial(
            robot="ant",
            plan=plan,
            failure=plan.belief,
            world=self.world,
            seed=self.number,
            trial=len(self.codes),
        )

    def take(self, result: TrialResult) -> None:
        """Learn from a walk, and have one that is within the target confirmed."""
        code, seen = self.codes[-1], Observation.of(result)
        off_m = result.deviation.final if result.valid and result.deviation else INVALID_SCORE
        true_m = result.true_deviation.final if result.true_deviation else 1.0
        self.walks_m.append((off_m, true_m))
        if self.again is not None:
            self.search.repeat(code, off_m, seen)
            self.confirmed = len(self.codes) if off_m <= TARGET_M else 0
            self.again = None
            return
        self.search.tell([code], [off_m], [seen])
        self.again = seen.trim if off_m <= TARGET_M and self.search.trims else None

    def best_m(self, walks: int) -> float:
        """True distance of the walk that was measured to end nearest."""
        return min(self.walks_m[:walks])[1]


#: Makes what a search knows of a failed leg in a world of a number.
Knowledge = Callable[[World, int, int], DriftSamples]


def shipped_knowledge(_world: World, _number: int, leg: int) -> DriftSamples:
    """What the shipped prior knows."""
    return drift_samples_of(load_prior(shipped_priors() / OPEN_LOOP_PRIOR), load_robot("ant"), leg)


def walk_open_loop(
    family: str,
    first: int,
    worlds: int,
    name: str,
    walks: int = MOST_WALKS,
    known: Knowledge = shipped_knowledge,
) -> list[OpenLoop]:
    """Search in members of a family until an end is confirmed, all worlds walk by walk together."""
    robot, members = load_robot("ant"), load_randomization(family).members(first, worlds)
    searched = []
    for number, member in enumerate(members, first):
        leg = 1 + number % N_LEGS
        noise = member.sensor_noise.model_copy(update={"position_m": POSITION_NOISE_M})
        plan = TrialPlan(gait=make_gait(robot, "demo"), belief=Failure(leg=leg))
        heading_rad, space = body_heading_rad(robot, plan), GaitSpace((leg,))
        ranked = slots_by_stability(robot, heading_rad=heading_rad, failure=plan.belief)
        search = OPEN_LOOP[name](known(member, number, leg), [space.code_of(slots) for slots in ranked])
        world = member.model_copy(update={"sensor_noise": noise, "time_step_s": CONFIRM_STEP_S})
        searched.append(OpenLoop(number=number, world=world, leg=leg, search=search))
    for _ in range(walks):
        left = [one for one in searched if not one.confirmed]
        for one, result in zip(left, run_sim_trials([one.trial() for one in left]), strict=True):
            one.take(result)
    return searched


def open_loop_lines(searched: Sequence[OpenLoop]) -> list[str]:
    """Figures in cm after each number of walks: mean, median and 90th percentile; and walks to confirm."""
    lines = []
    for walks in range(1, max(len(one.codes) for one in searched) + 1):
        off_cm = 100 * np.array([one.best_m(walks) for one in searched])
        ranks = np.percentile(off_cm, [50, 90])
        lines.append(f"after {walks}: {off_cm.mean():.1f} cm, median {ranks[0]:.1f}, 90th {ranks[1]:.1f}")
    counts = np.array([one.confirmed or np.inf for one in searched])
    lines.append(f"confirmed: {np.isfinite(counts).mean():.0%}, after {np.median(counts):g} walks (median)")
    return lines


#: Failed legs of a world, after the one of its number; and seconds that a fast walk and its rival last.
LEGS_AFTER, FAST_S = (0, 2, 4), 15.0


def walk_fast(robot: str, family: str, first: int, worlds: int, *, fast: bool) -> list[TrialResult]:
    """Walks with the gait `auto` along a line in members of a family, three failed legs in each."""
    trials = []
    for number in range(first, first + worlds):
        for place, after in enumerate(LEGS_AFTER):
            kind = ("locked", "limp", "missing")[(number + place) % 3]
            failure = Failure(leg=1 + (number + after) % N_LEGS, kind=kind)
            spec = RunSpec(gait="auto", failure=(failure,), fast=fast, duration_s=FAST_S)
            plan = plan_of(spec, load_robot(robot))
            world = f"{family}:{number}"
            trials.append(SimTrial(robot=robot, plan=plan, failure=failure, world=world, seed=number))
    return run_sim_trials(trials)


def fast_lines(usual: Sequence[TrialResult], fast: Sequence[TrialResult]) -> list[str]:
    """Speed of fast walks over that of the usual ones, and what it costs."""
    each_m = np.array([[one.distance_m or 0.0 for one in walks] for walks in (usual, fast)])
    over = (each_m[1] / each_m[0]).reshape(-1, len(LEGS_AFTER)).mean(axis=1)  # a mean of each world
    lines = [f"speed over the usual: {over.mean():.2f} ± {over.std(ddof=1) / np.sqrt(over.size):.2f}"]
    for name, walks in (("usual", usual), ("fast", fast)):
        clipped = np.mean([one.clipped_ticks for one in walks])
        off_cm = 100 * np.array([one.true_deviation.final for one in walks if one.true_deviation])
        bad = f"{sum(not one.valid for one in walks)} of {len(walks)} not ok"
        lines.append(f"{name}: {bad}, {clipped:.1f} clipped, {off_cm.mean():.1f} cm off the line")
    return lines


def main(folder: Path = FOLDER) -> None:
    """Walk the gaits that the cache lacks, and print the table."""
    if sys.argv[1:2] == ["open-loop"]:
        family, first, worlds, name = sys.argv[2:6]
        searched = walk_open_loop(family, int(first), int(worlds), name)
        sys.stdout.write("\n".join([f"{name}, {family}:{first}, n {worlds}", *open_loop_lines(searched), ""]))
        return
    if sys.argv[1:2] == ["fast"]:
        family, first, worlds, name = sys.argv[2:6]
        walks = [walk_fast(name, family, int(first), int(worlds), fast=fast) for fast in (False, True)]
        sys.stdout.write("\n".join([f"{name}, {family}:{first}, n {worlds}", *fast_lines(*walks), ""]))
        return
    robot = load_robot("ant")
    asked = specs(robot, load_randomization(FAMILY), FIRST_WORLD, WORLDS)
    landscapes = Work(cache=WalkCache(folder)).evaluate(asked)
    rows = table(load_score_prior(shipped_priors() / PRIOR), landscapes)
    sys.stdout.write("\n".join([*lines_of(rows), ""]))


if __name__ == "__main__":
    main()
