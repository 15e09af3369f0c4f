"""A small recovery benchmark with made-up walks: with nothing done they end far off and slow."""

from dataclasses import replace
from typing import Any

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.study.held_out_experiment import frame_of
from hexctl.study.recovery.episodes import Episode, RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import Alarm
from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE, RecoveryPlan, statistics
from tests.robots import shipped

PACE_HZ, IDEAL_M_S = 0.9, 0.15
FINAL_M = {"nothing": 0.05, "told": 0.002, "recover": 0.003}
SPEED = {"nothing": 0.5, "told": 0.9, "recover": 0.9}
DELAY_S = 0.3


def plan(**options: Any) -> RecoveryPlan:
    given: dict[str, Any] = {
        "robots": (shipped(),),
        "families": {"transfer": load_randomization("transfer"), "real": load_randomization("real")},
        "worlds": 2,
        "first_world": 200,
        "legs": (2, 5),
        "failures": ("locked", "stuck:tibia"),
        "runs": 2,
    }
    return RecoveryPlan(**given | options)


def alarm(case: RecoveryCase, *, after_s: float = DELAY_S, **changes: Any) -> Alarm:
    """The right alarm for a case, but for changes."""
    failure = case.events[0].failure
    assert failure is not None
    right = Alarm(
        at_s=case.at_s + after_s,
        leg=failure.leg,
        kind=failure.kind,
        joint=failure.joint,
        evidence="following",
    )
    return replace(right, **changes)


def episode(case: RecoveryCase, **changes: Any) -> Episode:
    """Walk as it goes usually, noticed rightly but by an oracle; with changes."""
    speed = SPEED[case.method] if case.legs else 1.0
    right = (alarm(case),) if case.legs and case.method != "told" else ()
    usual = Episode(
        case=case,
        status="ok",
        why=None,
        duration_s=30.0,
        alarms=right,
        pace_hz=PACE_HZ,
        ideal_m_s=IDEAL_M_S,
        signed_m=-FINAL_M[case.method] if case.legs else 0.001,
        way_m=0.06,
        after_m_s=speed * IDEAL_M_S,
        last_m_s=(0.4 if case.method == "nothing" else 0.9) * IDEAL_M_S,
    )
    return replace(usual, **changes)


class Found:
    """Made-up walks of a plan, and its rows of them.

    Args:
        plan: the plan.
        walks: of each place, in the order of the plan.
    """

    def __init__(self, plan: RecoveryPlan, walks: list[list[Episode]]) -> None:
        self.plan, self.walks = plan, walks
        self.rows = plan.columns(frame_of(plan.walked(), walks))

    @property
    def episodes(self) -> list[tuple[RecoveryPlace, Episode]]:
        """Each walk with its place."""
        places = [place for place, _ in self.plan.walked()]
        return [(place, one) for place, some in zip(places, self.walks, strict=True) for one in some]

    def statistics(self, method: str) -> dict[str, Any]:
        """Statistics of all judged episodes of a method."""
        return statistics(self.rows[self.rows["judged"] & (self.rows["method"] == method)])


def findings() -> Found:
    """Walks as they go usually, a little different in each world."""
    made, random = plan(), np.random.default_rng(0)
    walks = []
    for place, cases in made.walked():
        farther = random.uniform(0.8, 1.2)
        some = [episode(case, duration_s=place.duration_s) for case in cases]
        if place.protocol != HEXAHEAL:
            some = [replace(one, signed_m=farther * one.signed_m) if one.case.legs else one for one in some]
        walks.append(some)
    return Found(made, walks)


def changed(found: Found, which: Any, **changes: Any) -> Found:
    """The same with changes of those episodes for which `which` holds."""
    walks = [
        [replace(one, **changes) if which(place, one) else one for one in some]
        for (place, _), some in zip(found.plan.walked(), found.walks, strict=True)
    ]
    return Found(found.plan, walks)


def on_line(method: str) -> Any:
    """Which episodes of the protocol `line` with a failed leg are of a method."""

    def which(place: Any, one: Episode) -> bool:
        return place.protocol == LINE and one.case.method == method and bool(one.case.legs)

    return which
