"""Bars of the recovery benchmark."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from hexctl.study.recovery import recovery_report as module
from hexctl.study.recovery.episodes import Episode, RecoveryPlace
from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE, SECOND
from tests.robots import shipped
from tests.study.recovery.made_up import Found, alarm, bars_of, changed, findings, on_line, plan

EVERY_BAR = {
    "right_leg",
    "right_joint",
    "delay",
    "false_alarms",
    "settled",
    "deviation",
    "falls",
    "kept",
    "pairs",
}


def test_bars_are_judged_by_enough_episodes_of_30_s(monkeypatch: pytest.MonkeyPatch) -> None:
    made = findings()
    bars = bars_of(made)
    assert set(bars) == EVERY_BAR
    few = {name for name, bar in bars.items() if bar.verdict.startswith("not judged: ")}
    assert few == {"right_leg", "right_joint", "falls"}
    assert {bar.verdict for name, bar in bars.items() if name not in few} == {"holds"}
    monkeypatch.setattr(module, "ENOUGH", 5)
    monkeypatch.setattr(module, "ENOUGH_JOINTS", 5)
    assert {bar.verdict for bar in bars_of(made).values()} == {"holds"}
    assert bars["pairs"].measured == "1 of 1; 2 of 2 walks"
    short = bars_of(Found(plan(duration_s=20.0), made.walks))
    assert short.pop("pairs").verdict == "holds"
    assert {bar.verdict for bar in short.values()} == {"not judged: walks of 20 s, needs at least 30 s"}


def test_bars_are_missed_by_what_they_forbid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ENOUGH", 5)
    monkeypatch.setattr(module, "ENOUGH_JOINTS", 5)
    made = findings()

    def missed(which: Any, **changes: Any) -> set[str]:
        return {name for name, bar in bars_of(changed(made, which, **changes)).items() if not bar.holds}

    recover = on_line("recover")
    case = next(one.case for place, one in made.episodes if recover(place, one))
    assert missed(recover, alarms=()) == {"right_leg", "right_joint", "delay"}
    late = (alarm(case, at_s=12.0),)
    of_case = (case.legs, case.failure)
    assert missed(lambda _, one: (one.case.legs, one.case.failure) == of_case, alarms=late) == {"delay"}
    assert missed(on_line("nothing", legs=False), alarms=late) == {"false_alarms"}
    assert missed(recover, settled_s=2.6) == missed(recover, settled_s=math.nan) == {"settled"}
    assert bars_of(changed(made, recover, settled_s=math.nan))["settled"].measured == "never"
    assert bars_of(changed(made, recover, after_m_s=math.nan))["kept"].measured.startswith("mean -, ")
    assert missed(recover, signed_m=0.009) == {"deviation"}
    assert missed(recover, after_m_s=0.1) == {"kept"}
    assert missed(lambda place, _: place.protocol == HEXAHEAL, last_m_s=0.0) == {"pairs"}


def test_bars_are_those_of_what_was_walked() -> None:
    assert set(bars_of(findings(protocols=(HEXAHEAL,)))) == {"pairs"}
    assert set(bars_of(findings(protocols=(LINE,)))) == EVERY_BAR - {"pairs"}
    assert bars_of(findings(methods=("nothing", "told"))) == {}


def test_a_second_leg_is_judged_among_the_pairs_that_recover_when_told() -> None:
    made = findings(legs=(2, 4, 5), protocols=(SECOND,), runs=4)
    numbers = made.plan.numbers(made.rows)
    sets = [one["legs"] for one in numbers["second_sets"] if one["method"] == "told"]
    assert (sets, numbers["hexaheal_sets"]) == ([[2, 4], [2, 5], [4, 5]], [])

    def of(method: str, legs: tuple[int, int]) -> Callable[[RecoveryPlace, Episode], bool]:
        return lambda _, one: one.case.method == method and tuple(sorted(one.case.legs)) == legs

    unable = changed(made, of("told", (2, 4)), last_m_s=0.0)
    assert bars_of(unable).keys() == {"second"}
    assert bars_of(unable)["second"].holds
    fails = changed(unable, of("recover", (2, 5)), status="fell")
    assert not bars_of(fails)["second"].holds
    assert "1 of 2 (of 3 pairs)" in bars_of(fails)["second"].measured
    two = findings(robots=(shipped(), shipped("pexod")), legs=(2, 4, 5), protocols=(SECOND,), runs=4)

    def by_pexod(place: RecoveryPlace, one: Episode) -> bool:
        return place.robot.name == "pexod" and one.case.method == "recover"

    one_fails = changed(two, by_pexod, status="fell")
    assert "3 of 6 (of 6 pairs)" in bars_of(one_fails)["second"].measured
    nobody = changed(made, lambda _, one: one.case.method == "told", last_m_s=0.0)
    assert bars_of(nobody)["second"].holds is None
