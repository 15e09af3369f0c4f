"""What trials bring to steered walks: how much slower than the fastest of all gaits the best one tried is.

All gaits walk once in worlds outside every prior, and searches are replayed on what they did, so that each of
them could be judged after any number of trials. `python -m benchmarks.search_gain` prints the table `speed`
of the results; with `--save` it writes it, too.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.results import put, results
from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.score_bayes import ScoreBayes
from hexctl.adapt.prior.prior import ScorePrior, load_score_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import ranked_codes, score_samples_of
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import DomainRandomization, load_randomization
from hexctl.control.assessment.static_stability import stable_slots_of, usual_posture
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.study.held_out import with_sensors
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.walk_cache import FOLDER, WalkCache
from hexctl.study.walking import evaluate
from hexctl.types import N_LEGS, FloatArray

#: The family of the worlds and its members, which nothing was built or tuned with.
FAMILY, FIRST_WORLD, WORLDS = "transfer", 300, 10

#: The prior that is believed.
PRIOR = "ant-locked-none-30s-line.npz"

#: Numbers of trials after which regrets are told; 0 is `--gait auto` alone.
AFTER = (0, 1, 2, 3, 5, 10)

#: Runs of searches that draw random numbers.
RUNS = 100

#: Searches, and their rows in the table `speed` of the results.
SAVED_AS = {
    "bayes": "bayes",
    "order of the prior": "ranking",
    "random": "random",
    "bayes, codes of the prior shuffled": "shuffled",
}

#: Kept points, five a second, over whose mean the way of a walk is taken for the regret: with position noise
#: of a centimetre the last one alone would make the luckiest gait the best.
END_POINTS = 10

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


def told_scores(landscape: Landscape) -> FloatArray:
    """What a session is told of each gait: its time per metre, (gaits,)."""
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
    spec, scores, lost = landscape.spec, told_scores(landscape), losses(landscape)
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
        spec, scores = landscape.spec, told_scores(landscape)
        ranking = ranked_codes(prior, spec.robot, spec.leg)
        rows.setdefault("order of the prior", []).append(np.array(regrets(landscape, ranking)))
        for name, (runs, make) in searches(prior, spec.robot, spec.leg).items():
            each = [regrets(landscape, codes_of(make(run), scores, AFTER[-1])) for run in range(runs)]
            rows.setdefault(name, []).append(np.mean(each, axis=0))
    return {name: np.array(values) for name, values in rows.items()}


def lines_of(rows: Mapping[str, FloatArray]) -> list[str]:
    """Table in Markdown: mean regret over the worlds, its standard error and the greatest one, in percent."""
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


def main(folder: Path = FOLDER, *, save: bool = False) -> None:
    """Walk the gaits that the cache lacks, and print the table."""
    robot = load_robot("ant")
    asked = specs(robot, load_randomization(FAMILY), FIRST_WORLD, WORLDS)
    landscapes = evaluate(asked, WalkCache(folder))
    rows = table(load_score_prior(shipped_priors() / PRIOR), landscapes)
    sys.stdout.write("\n".join([*lines_of(rows), ""]))
    if save:
        put(figures_of(rows))


def figures_of(rows: Mapping[str, FloatArray]) -> dict[str, str]:
    """Mean regrets in percent by their keys in the file of results."""
    columns = results()["speed"]["columns"]
    return {
        f"speed.{row}.t{count}": _mean(100 * values)
        for name, row in SAVED_AS.items()
        for count, values in zip(AFTER, rows[name].T, strict=True)
        if f"t{count}" in columns
    }


if __name__ == "__main__":
    main(save="--save" in sys.argv)
