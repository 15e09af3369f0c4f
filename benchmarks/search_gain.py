"""Gain of a search over its trials in open loop, and of fast walks.

Open loop: searches walk in held-out worlds, one locked leg in each, legs in turn, with 1 cm of noise on the
path. `python -m benchmarks.search_gain open-loop transfer 8110 30 trim` prints the figures of one search of
`OPEN_LOOP`. Every walk counts, and there is no baseline. The best walk is the one with the smallest measured
distance; its true distance is printed.

Fast: the gait `auto` walks at the pace of a robot and with `fast`, with three failed legs in each world, in
turn locked, limp and missing. `python -m benchmarks.search_gain fast transfer 9800 8 phantomx` prints both.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation, Optimizer, Trim
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_choice import DEFAULT_TARGET_M
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import DriftSamples, drift_samples_of
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.planning.static_stability import slots_by_stability
from hexctl.control.scoring.score import progress_floor_m
from hexctl.control.scoring.uncertainty_store import CONFIRM_STEP_S
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.turning import body_heading_rad
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.types import N_LEGS

#: The prior of walks in open loop.
OPEN_LOOP_PRIOR = "ant-locked-rear-30s.npz"

#: Sensors of walks in open loop, and the target.
POSITION_NOISE_M, TARGET_M = 0.01, DEFAULT_TARGET_M

#: Walks of an open-loop search whose end is not confirmed.
MOST_WALKS = 6


def _trim(known: DriftSamples, stable: Sequence[int], *, prior: bool = True) -> Optimizer:
    robot = load_robot("ant")
    plan = TrialPlan(gait=make_gait(robot, "demo"))
    floor_m = progress_floor_m(robot, plan, plan.duration_s)
    cycle_s = 1 / robot.gait.pace_hz
    space = GaitSpace((known.leg,))
    return TrimSearch(
        space, 0, codes=stable, samples=known if prior else None, cycle_s=cycle_s, floor_m=floor_m
    )


#: Searches in open loop by name.
OPEN_LOOP: dict[str, Callable[[DriftSamples, Sequence[int]], Optimizer]] = {
    "trim": _trim,
    "no-prior": partial(_trim, prior=False),
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
        plan = TrialPlan(gait=gait, failures=(Failure(leg=self.leg),))
        if trim is not None:
            plan = replace(plan, trim_rad=trim.course_rad, turn_trim_rad_s=trim.turn_rad_s)
        return SimTrial(
            robot="ant",
            plan=plan,
            failures=plan.failures,
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


#: What a search knows of a world, by its number, and a failed leg.
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
    knowledge: Knowledge = shipped_knowledge,
) -> list[OpenLoop]:
    """Search in members of a family until an end is confirmed, all worlds walk by walk together."""
    robot, members = load_robot("ant"), load_randomization(family).members(first, worlds)
    searched = []
    for number, member in enumerate(members, first):
        leg = 1 + number % N_LEGS
        noise = member.sensor_noise.model_copy(update={"position_m": POSITION_NOISE_M})
        plan = plan_walk(RunSpec(gait="demo", failed_leg=leg, hold="none"), robot)
        heading_rad, space = body_heading_rad(robot, plan), GaitSpace((leg,))
        ranked = slots_by_stability(robot, heading_rad=heading_rad, failure=plan.failures)
        known = knowledge(member, number, leg)
        search = OPEN_LOOP[name](known, [space.code_of(slots) for slots in ranked])
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
            plan = plan_walk(spec, load_robot(robot))
            world = f"{family}:{number}"
            trials.append(SimTrial(robot=robot, plan=plan, failures=failure, world=world, seed=number))
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


def main(kind: str, family: str, first: int, worlds: int, name: str) -> list[str]:
    """Walk, and return the figures as lines."""
    if kind == "open-loop":
        lines = open_loop_lines(walk_open_loop(family, first, worlds, name))
    else:
        lines = fast_lines(*(walk_fast(name, family, first, worlds, fast=fast) for fast in (False, True)))
    return [f"{name}, {family}:{first}, n {worlds}", *lines]


if __name__ == "__main__":
    kind, family, first, worlds, name = sys.argv[1:]
    print("\n".join(main(kind, family, int(first), int(worlds), name)))
