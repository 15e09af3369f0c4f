"""Adaptation with a prior for an identified robot, compared with the shipped prior and random codes.

`python -m benchmarks.identified_prior real 9960 6 [FOLDER]`: in each world `ant` is identified on a stand and
on a walk, 120 gaits of its robot file walk in worlds of `randomised`, and the search starts from this prior.
"""

import sys
from functools import partial
from pathlib import Path

from benchmarks.identify import stand_and_walk
from benchmarks.search_gain import (
    OPEN_LOOP_PRIOR,
    Knowledge,
    open_loop_lines,
    shipped_knowledge,
    walk_open_loop,
)
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import DriftSamples, drift_samples_of
from hexctl.backends.sim.world import World, load_randomization
from hexctl.identify.identification import identify
from hexctl.identify.identified_file import write_identified
from hexctl.robot.loader import load_robot
from hexctl.study.priors.prior_building import PriorPlan, build_prior
from hexctl.study.walking import Work

#: Keeps logs, robot files and priors: the same command continues.
FOLDER = Path("runs/identified")

#: Number of walks of each search.
WALKS = 10


def identified_knowledge(folder: Path, world: World, number: int, leg: int) -> DriftSamples:
    """What a prior for the identified robot knows; the prior stays in the folder."""
    path = folder / f"{number}-{leg}.npz"
    if not path.exists():
        plan = PriorPlan(
            robot=load_robot(_identified(folder, world, number)),
            family=load_randomization("randomised"),
            legs=(leg,),
        )
        build_prior(plan, path, Work(jobs=1))
    return drift_samples_of(load_prior(path), load_robot("ant"), leg)


def _identified(folder: Path, world: World, number: int) -> Path:
    """Robot file of `ant` as it is in a world."""
    file = folder / f"{number}.yaml"
    if not file.exists():
        logs = stand_and_walk(load_robot("ant"), world, number, folder)
        write_identified("ant", identify(logs), file)
    return file


def one_leg_knowledge(_world: World, _number: int, leg: int) -> DriftSamples:
    """What the shipped prior knows from the leg alone: as many samples as of an identified robot."""
    prior = load_prior(shipped_priors() / OPEN_LOOP_PRIOR)
    row = prior.legs.index(leg)
    arrays = {name: values[row : row + 1].astype(float) for name, values in prior.arrays.items()}
    alone = type(prior)(key=prior.key, legs=(leg,), origin=prior.origin, **arrays)
    return drift_samples_of(alone, load_robot("ant"), leg)


def main(family: str, first: int, worlds: int, folder: Path = FOLDER) -> None:
    """Print the figures of each search."""
    folder.mkdir(parents=True, exist_ok=True)
    searches: dict[str, tuple[str, Knowledge]] = {
        "identified robot": ("trim", partial(identified_knowledge, folder)),
        "shipped": ("trim", shipped_knowledge),
        "shipped, this leg": ("trim", one_leg_knowledge),
        "none": ("no-prior", shipped_knowledge),
        "random": ("random", shipped_knowledge),
    }
    for title, (name, known) in searches.items():
        searched = walk_open_loop(family, first, worlds, name, WALKS, known)
        print("\n".join([f"{title}, {family}:{first}, n {worlds}", *open_loop_lines(searched)]), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), *map(Path, sys.argv[4:]))
