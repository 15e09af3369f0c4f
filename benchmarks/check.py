"""How far robots walk that `hexctl check` warns of: random robots, simulated, and counted by verdict.

Two surveys draw robots until each verdict has its number of them. `loads` varies mass (on the trunk),
stiffness and torque of the shipped robots; `legs` moves mounts and feet together and simulates them with legs
that pass through one another, and, where the robot walks, with solid ones. A robot walks whose trial ends
`ok`: straight ahead it makes half of its way. A third, in `benchmarks.causes`, asks why others do not.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from benchmarks.causes import cause_rows
from benchmarks.robots import ROBOTS, log_uniform, shipped, with_servos
from benchmarks.rows import Count, Row
from benchmarks.scale import Scale
from hexctl.backends.sim.servos import SimServos
from hexctl.control.checks.feasibility import gait_demand
from hexctl.control.checks.gait_load import (
    GOOD_CAPACITY,
    GOOD_LIFT,
    GaitLoad,
    gait_load,
    load_verdict,
)
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import NAMED_SLOTS, Motion, make_gait
from hexctl.ik.clearance import PARTS
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS

AHEAD = (Motion(),)

#: Seeds of the draws. On the loads of 20261122 the least good capacity was chosen, on 20261123 it was tried.
LOADS_SEED, LEGS_SEED = 20261123, 20261122

#: Draws after which a verdict that is too rare goes without its number of robots.
TRIES_PER_ROBOT = 300

#: Friction between solid legs, and share of the longest walk that these take.
LEG_FRICTION, LEGS_SHARE = 0.4, 1 / 3

Draw = Callable[[np.random.Generator], "tuple[str, Robot, str] | None"]


def check_rows(scale: Scale) -> Iterator[Row]:
    """Yield the share of robots that walk, by the verdict of `hexctl check`, and of causes that are named."""
    loads = _survey(_loaded, scale.robots, lambda robot, gait: walks(robot, gait, scale.walk_s), LOADS_SEED)
    legs = _survey(
        _crowded, scale.robots, lambda robot, gait: _solid(robot, gait, LEGS_SHARE * scale.walk_s), LEGS_SEED
    )
    for survey, counts in (("loads", loads), ("legs", legs)):
        for verdict in sorted(counts):
            yield counts[verdict].row(f"check.{survey}.{verdict}", "walked")
    yield from cause_rows(scale)


def _survey(
    draw: Draw, robots: int, judge: Callable[[Robot, str], bool | None], seed: int
) -> dict[str, Count]:
    """Robots drawn until each verdict has its number, and how many of them walked; None is not counted."""
    rng = np.random.default_rng(seed)
    of, walked = Counter[str](), Counter[str]()
    groups = 4 if draw is _crowded else 6
    for _ in range(TRIES_PER_ROBOT * robots):
        if len(of) == groups and min(of.values()) >= robots:
            break
        drawn = draw(rng)
        if drawn is None or of[drawn[0]] >= robots:
            continue
        verdict, robot, gait = drawn
        result = judge(robot, gait)
        of[verdict] += result is not None
        walked[verdict] += bool(result)
    return {verdict: Count(walked[verdict], count) for verdict, count in of.items()}


def _loaded(rng: np.random.Generator) -> tuple[str, Robot, str] | None:
    """A robot with another mass, stiffness and torque, a gait, and the verdict on them."""
    base, gait = shipped(str(rng.choice(ROBOTS))), str(rng.choice(list(NAMED_SLOTS)))
    mass = float(rng.uniform(1.0, 8.0))
    stiffness, torque = (log_uniform(rng, low, high) for low, high in LOADS)
    body = replace(base.body, mass_kg=base.body.mass_kg + (mass - 1) * base.mass_kg)
    robot = with_servos(replace(base, body=body), stiffness=stiffness, torque=torque)
    return load_name(gait_load(robot, make_gait(robot, gait), AHEAD)), robot, gait


#: Ranges of stiffness and torque, as multiples, drawn with their logarithm.
LOADS = ((0.1, 1.2), (0.02, 2.5))


def load_name(load: GaitLoad) -> str:
    """Name of the verdict on a load, without its legs."""
    if not load_verdict(load).possible:
        return "impossible"
    if load.tipping > 0 or load.capacity < GOOD_CAPACITY:
        return "weak"
    if load.lift_left >= GOOD_LIFT:
        return "good"
    return "soft_all_drag" if load.all_drag else "soft_some_drag" if load.dragging_legs else "soft_none_drag"


def _crowded(rng: np.random.Generator) -> tuple[str, Robot, str] | None:
    """A robot whose legs come near one another, and how near; None where they do not."""
    base = shipped(str(rng.choice(ROBOTS)))
    mounts, feet = base.mount_positions_body.copy(), base.stance_feet_body.copy()
    mounts[:, 0] *= rng.uniform(-0.4, 1.0)
    feet[:, 0] += mounts[:, 0] - base.mount_positions_body[:, 0]
    shift_m = float(rng.uniform(-0.25, 0.25)) if rng.random() < 0.8 else 0.0
    feet[list(PAIRS[rng.integers(len(PAIRS))]), 0] += shift_m
    stride = replace(base.gait, amplitude=float(rng.uniform(0.6, 1.3)) * base.gait.amplitude)
    robot = replace(base, mount_positions_body=mounts, stance_feet_body=feet, gait=stride)
    gait = make_gait(robot, "demo")
    if not gait_demand(robot, gait, AHEAD).possible:
        return None
    load = gait_load(robot, gait, AHEAD)
    if load.least_clearance_m > NEAR_M or not load_verdict(load).possible:
        return None
    if load.least_clearance_m > 0:
        return "near", robot, "demo"
    if not load.crossing:
        return "touch", robot, "demo"
    return "cross_short" if load.crossing_share <= CROSSING_SHORT else "cross_long", robot, "demo"


#: Share of the cycle up to which legs cross for a short time.
CROSSING_SHORT = 0.25

#: Legs, counted from 0, whose feet are moved along the body; and gaps below which legs are near.
PAIRS, NEAR_M = ((1, 4), (1,), (0, 5), (2, 3)), 0.004


def _solid(robot: Robot, gait: str, duration_s: float) -> bool | None:
    """Whether a robot walks with solid legs; None if it does not with legs that pass through either."""
    return walks(robot, gait, duration_s, solid=True) if walks(robot, gait, duration_s) else None


def walks(robot: Robot, gait: str, duration_s: float, *, solid: bool = False) -> bool:
    """Whether a robot makes half of its way straight ahead, on a flat floor."""
    with SimServos(robot) as servos:
        if solid:
            make_legs_solid(servos)
        plan = TrialPlan(gait=make_gait(robot, gait), duration_s=duration_s)
        return run_trial(Guard(servos), plan).status == "ok"


def make_legs_solid(servos: SimServos) -> None:
    """Make each leg of a connected simulation collide with the other five, besides the floor."""
    model = servos.compiled.physics.model
    for leg in range(N_LEGS):
        own = 1 << (leg + 1)
        others = sum(1 << (other + 1) for other in range(N_LEGS) if other != leg)
        for part in PARTS:
            geom = model.name2id(f"{servos.robot.name}/leg{leg + 1}/{part}", "geom")
            body = model.geom_bodyid[geom]
            model.geom_contype[geom] |= own
            model.geom_conaffinity[geom] |= others
            model.geom_friction[geom, 0] = LEG_FRICTION  # on the floor its own counts
            model.body_contype[body] |= own
            model.body_conaffinity[body] |= others
