"""Build the archive of the method `trial-and-error`: `python -m benchmarks.build_archive FILE [MINUTES]`.

MAP-Elites with the intact `ant` on a flat floor, for MINUTES of one core. The published archive took 40
million evaluations. New gaits are mixed of two of the archive (V. Vassiliades and J.-B. Mouret, "Discovering
the Elite Hypervolume by Leveraging Interspecies Correlation", GECCO 2018).
"""

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import NAMED_SLOTS, make_gait
from hexctl.robot.loader import load_robot
from hexctl.study.recovery.shaped_walk import TRIAL_S, ShapedWalk, score_of, shape_of
from hexctl.study.recovery.trial_and_error import Behaviours
from hexctl.types import N_LEGS, FloatArray, RobotState

ROBOT = "ant"

#: The world, whose physics has the longest time step of all.
WORLD = "flat@4ms"

#: Gaits that walk together, and drawn ones among the first.
TOGETHER, FIRST = 64, 256

#: Standard deviations of a new gait: of each number, and along the line to another gait.
STEP, ALONG = 0.03, 0.2

#: Time after which the contacts of the feet count.
COUNTED_S = 2.0


class CountedWalk(ShapedWalk):
    """A shaped walk that counts the contacts of its feet."""

    contacts: FloatArray = np.zeros(())
    ticks = 0

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step."""
        if step * self._period_s >= COUNTED_S and state.foot_contacts is not None:
            self.contacts, self.ticks = self.contacts + state.foot_contacts, self.ticks + 1
        return super().targets_rad(step, state)


def evaluated(shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Duty factors, (n, 6), and scores, (n,), of shapes (n, 6, 4)."""
    robot, walks = load_robot(ROBOT), list[CountedWalk]()
    plan = TrialPlan(gait=make_gait(robot, "tripod"), duration_s=TRIAL_S, self_rotation="none", hold="line")
    trials = [SimTrial(robot=robot, plan=replace(plan), failures=None, world=WORLD) for _ in shapes]

    def make(start: WalkStart) -> CountedWalk:
        walks.append(CountedWalk(start, hold="line", failure_s=np.zeros(len(start.plans)), shapes=shapes))
        return walks[-1]

    results = run_sim_trials(trials, 1, make)
    return np.asarray(walks[0].contacts) / walks[0].ticks, np.array([score_of(one) for one in results])


def cell_of(duties: FloatArray) -> tuple[int, ...]:
    """Cell of the archive: each duty factor to the nearest quarter, as published."""
    return tuple(np.rint(4 * duties).astype(int).tolist())


#: Score, shape and duty factors of the best gait of each cell.
Cells = dict[tuple[int, ...], tuple[float, FloatArray, FloatArray]]


def build(path: Path, minutes: float) -> None:
    """Fill an archive for some minutes of one core; the file is written after each round."""
    random = np.random.default_rng(0)
    named = [shape_of(make_gait(load_robot(ROBOT), name)) for name in NAMED_SLOTS]
    waiting = [*named, *random.uniform(size=(FIRST - len(named), N_LEGS, 4))]
    cells: Cells = {}
    evaluations = 0
    while time.process_time() < 60 * minutes:
        shapes = np.array(waiting[:TOGETHER]) if waiting else children(cells, random)
        waiting = waiting[TOGETHER:]
        for shape, duty, score in zip(shapes, *evaluated(shapes), strict=True):
            kept = cells.get(cell_of(duty))
            if score > 0 and (kept is None or score > kept[0]):
                cells[cell_of(duty)] = float(score), shape, duty
        evaluations += len(shapes)
        spent = round(time.process_time() / 60, 2)
        archive_of(cells, {"evaluations": evaluations, "core_minutes": spent, "world": WORLD}).save(path)
        print(
            evaluations, spent, len(cells), round(max(score for score, _, _ in cells.values()), 3), flush=True
        )


def archive_of(cells: Cells, origin: dict[str, Any]) -> Behaviours:
    """The archive, the fastest gait first."""
    best = sorted(cells.values(), key=lambda one: -one[0])
    return Behaviours(
        shapes=np.stack([shape for _, shape, _ in best]),
        duties=np.stack([duty for _, _, duty in best]),
        speeds=np.array([score for score, _, _ in best]),
        robot_fingerprint=load_robot(ROBOT).fingerprint,
        origin=origin,
    )


def children(cells: Cells, random: np.random.Generator) -> FloatArray:
    """New shapes, (n, 6, 4), each of two in the archive."""
    kept = np.stack([shape for _, shape, _ in cells.values()])
    one, other = kept[random.integers(len(kept), size=(2, TOGETHER))]
    apart = ALONG * random.standard_normal((TOGETHER, 1, 1)) * (other - one)
    return np.asarray(np.clip(one + apart + STEP * random.standard_normal(one.shape), 0.0, 1.0))


if __name__ == "__main__":
    build(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 15.0)
