"""A tiny plan: one failure in two directions, in one world of a family."""

from typing import Any

from hexctl.backends.sim.world import load_randomization
from hexctl.study.repertoire_plan import RepertoirePlan
from tests.robots import shipped


def plan(name: str = "ant", **options: Any) -> RepertoirePlan:
    """Plan with the settings of a test."""
    asked: dict[str, Any] = {
        "robot": shipped(name),
        "families": {"transfer": load_randomization("transfer")},
        "worlds": 1,
        "directions": 2,
        "failures": ("stuck:femur",),
        "pair_failures": (),
        "codes": 0,
    }
    return RepertoirePlan(**asked | options)
