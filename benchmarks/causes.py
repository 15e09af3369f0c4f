"""Causes that `hexctl.control.scoring.cause` names: random robots, one defect each, that make no progress.

A defect is too little torque, soft servos or a slippery slope, each drawn from hardly noticed to hopeless.
Robots are drawn until enough of each defect make no progress. The cause that is named is counted, and the
range of each symptom stands next to it.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from benchmarks.robots import ROBOTS, log_uniform, shipped, with_servos
from benchmarks.rows import Count, Row
from benchmarks.scale import Scale
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.scoring.cause import SAMPLE_TICKS, Samples, Symptoms, symptoms
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import NAMED_SLOTS, make_gait
from hexctl.robot.model import Robot

Draw = Callable[[np.random.Generator, Robot], tuple[Robot, World]]

#: Seed of the draws, which had no part in the choice of the thresholds.
SEED = 20261124

#: Draws after which a defect goes without its number of robots.
TRIES_PER_ROBOT = 20

#: Share of the longest walk that these take.
WALK_SHARE = 1 / 3


def _weak(rng: np.random.Generator, robot: Robot) -> tuple[Robot, World]:
    return with_servos(robot, torque=log_uniform(rng, 0.005, 0.5)), World()


def _soft(rng: np.random.Generator, robot: Robot) -> tuple[Robot, World]:
    return with_servos(robot, stiffness=log_uniform(rng, 0.01, 0.5)), World()


def _slippery(rng: np.random.Generator, robot: Robot) -> tuple[Robot, World]:
    return robot, World(friction=log_uniform(rng, 0.02, 0.4), slope_deg=float(rng.uniform(0, 15)))


#: What is wrong with a robot, and the cause that should be named.
DEFECTS: dict[str, tuple[Draw, str]] = {
    "weak": (_weak, "saturation"),
    "soft": (_soft, "sag"),
    "slippery": (_slippery, "slip"),
}


def cause_rows(scale: Scale) -> Iterator[Row]:
    """Yield the share of robots without progress whose defect is named, by the defect."""
    for index, (defect, (draw, cause)) in enumerate(DEFECTS.items()):
        rng = np.random.default_rng([SEED, index])
        found = list(_without_progress(draw, rng, scale.robots, WALK_SHARE * scale.walk_s))
        named = Counter(str(one.cause) for one in found)
        row = Count(named[cause], len(found)).row(f"check.causes.{defect}", f"named {cause}")
        others = "".join(f", {count} {name}" for name, count in named.items() if name != cause)
        yield replace(row, note=f"{row.note}{others}{_ranges(found)}")


def _without_progress(
    draw: Draw, rng: np.random.Generator, robots: int, duration_s: float
) -> Iterator[Symptoms]:
    """Symptoms of robots with a defect, drawn until as many as wanted make no progress."""
    left = robots
    for _ in range(TRIES_PER_ROBOT * robots):
        robot, world = draw(rng, shipped(str(rng.choice(ROBOTS))))
        gait = make_gait(robot, str(rng.choice(list(NAMED_SLOTS))))
        seen = _walked(robot, world, TrialPlan(gait=gait, duration_s=duration_s))
        if seen is not None:
            yield seen
            left -= 1
        if left == 0:
            return


def _walked(robot: Robot, world: World, plan: TrialPlan) -> Symptoms | None:
    """Symptoms of a walk without progress; None for any other."""
    log = TickLog()
    with SimServos(robot, world=world) as servos:
        if run_trial(Guard(servos), plan, recorders=[log]).status != "no_progress":
            return None
    rows = log.rows_of("walk")
    names = ("measured_rad", "commanded_rad", "foot_contacts")
    samples = Samples(*(log[name][rows][::SAMPLE_TICKS] for name in names))
    poses = (log[name][rows] for name in ("base_position_world", "base_quaternion_world"))
    return symptoms(robot, plan, samples, *poses)


def _ranges(found: list[Symptoms]) -> str:
    """Range of each symptom, for a note."""
    if not found:
        return ""
    names = ("saturated", "tracking_error", "slip")
    each = {name: [getattr(one, name) for one in found] for name in names}
    return "".join(f"; {name} {min(values):.2f} to {max(values):.2f}" for name, values in each.items())
