"""A small comparison with made-up walks: open loop ends far off, the yaw brings it nearer, the pose near."""

import math
from typing import Any

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.study.holds.hold_conditions import HoldCase, HoldConditions
from hexctl.study.holds.hold_findings import HoldFindings
from hexctl.study.holds.hold_plan import HoldPlan
from hexctl.study.holds.hold_walks import HoldWalk
from tests.robots import shipped

IDEAL_M = 4.0
SCALES_M = {"none": 0.5, "heading": 0.04, "line": 0.003}


def plan(**options: Any) -> HoldPlan:
    given: dict[str, Any] = {
        "robots": (shipped(),),
        "families": {"transfer": load_randomization("transfer"), "real": load_randomization("real")},
        "worlds": 3,
        "legs": (2, 5),
        "failures": ("locked", "limp"),
    }
    return HoldPlan(**given | options)


def walk(case: HoldCase, final_m: float, *, status: str = "ok", speed: float = 0.9) -> HoldWalk:
    return HoldWalk(
        case=case,
        slots=(1, 2, 3, 4, 5, 6),
        body_raise=0.0,
        held=case.hold,
        status=status,
        why=None,
        duration_s=30.0,
        signed_m=math.nan if status == "fell" else final_m,
        mean_m=abs(final_m) / 2,
        max_m=2 * abs(final_m),
        distance_m=speed * IDEAL_M,
        ideal_distance_m=IDEAL_M,
        yaw_change_rad=0.1,
        clipped_ticks=3,
    )


def findings(**options: Any) -> HoldFindings:
    """Walks that end at random, and farther in some worlds than in others."""
    made, random = plan(**options), np.random.default_rng(0)
    walks: list[tuple[HoldConditions, HoldWalk]] = []
    for place in made.conditions():
        farther = random.uniform(0.5, 1.5)
        for case in made.cases():
            final_m = SCALES_M[case.hold] * farther * random.uniform(-1, 1)
            walks.append((place, walk(case, final_m, speed=0.8 if case.hold == "none" else 0.9)))
    return HoldFindings(plan=made, walks=walks)
