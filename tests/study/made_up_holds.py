"""A small comparison with made-up walks: open loop ends far off, the yaw brings it nearer, the pose near."""

import math
from typing import Any

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.study.held_out_experiment import frame_of
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.hold_walks import HoldCase, HoldWalk
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


def made_up_walks(made: HoldPlan) -> list[list[HoldWalk]]:
    """Walks that end at random, and farther in some worlds than in others."""
    random = np.random.default_rng(0)
    walks = []
    for _, cases in made.walked():
        farther = random.uniform(0.5, 1.5)
        walks.append(
            [
                walk(
                    case,
                    SCALES_M[case.hold] * farther * random.uniform(-1, 1),
                    speed=0.8 if case.hold == "none" else 0.9,
                )
                for case in cases
            ]
        )
    return walks


def rows_of(made: HoldPlan, walks: list[list[HoldWalk]]) -> Any:
    """Rows of some walks, as the plan compares them."""
    return made.columns(frame_of(made.walked(), walks))


def rows(**options: Any) -> Any:
    """Rows of the made-up walks of a plan."""
    return rows_of(plan(**options), made_up_walks(plan(**options)))
