"""A small recovery benchmark with made-up walks: with nothing done they end far off and slow."""

from dataclasses import replace
from typing import Any

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.study.recovery.episodes import Episode, RecoveryCase, RecoveryConditions
from hexctl.study.recovery.methods import Alarm
from hexctl.study.recovery.recovery_criteria import recovery_bars
from hexctl.study.recovery.recovery_findings import RecoveryFindings
from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE, RecoveryPlan
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
        before_m_s=IDEAL_M_S,
        after_m_s=speed * IDEAL_M_S,
        last_m_s=(0.4 if case.method == "nothing" else 0.9) * IDEAL_M_S,
        settled_s=1.2,
    )
    return replace(usual, **changes)


def findings(**options: Any) -> RecoveryFindings:
    """Walks as they go usually, a little different in each world."""
    made, random = plan(**options), np.random.default_rng(0)
    episodes: list[tuple[RecoveryConditions, Episode]] = []
    for place, cases in made.walked():
        farther = random.uniform(0.8, 1.2)
        for case in cases:
            one = episode(case, duration_s=place.duration_s)
            if case.legs and place.protocol != HEXAHEAL:
                one = replace(one, signed_m=farther * one.signed_m)
            episodes.append((place, one))
    return RecoveryFindings(plan=made, episodes=episodes)


def changed(found: RecoveryFindings, which: Any, **changes: Any) -> RecoveryFindings:
    """The same with changes of those episodes for which `which` holds."""
    episodes = [
        (place, replace(one, **changes) if which(place, one) else one) for place, one in found.episodes
    ]
    return replace(found, episodes=episodes)


def on_line(method: str, *, legs: bool = True) -> Any:
    """Which episodes of the protocol `line` are of a method."""

    def which(place: Any, one: Episode) -> bool:
        return place.protocol == LINE and one.case.method == method and bool(one.case.legs) == legs

    return which


def bars_of(found: RecoveryFindings) -> dict[str, Any]:
    return {bar.name: bar for bar in recovery_bars(found)}
