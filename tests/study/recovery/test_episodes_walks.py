"""The walks of the recovery benchmark: simulated, kept, continued."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.control.batch import run_sim_trial
from hexctl.control.custom_controller import StepFunction
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.repertoire_store import save_repertoire
from hexctl.control.preparation import WalkStart
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import RecoveryMethod
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import walk_all
from tests.control.monitor.repertoires import made_up
from tests.study.recovery.made_up import episode, plan
from tests.study.watching import Remembering

PLACE = replace(plan().walked()[0][0], duration_s=4.0)


def case(method: str, *legs: int, at_s: float = 2.0) -> RecoveryCase:
    """Case of limp legs, or of none."""
    return RecoveryCase(
        gait="tripod",
        legs=legs,
        failure="limp" if legs else "intact",
        at_s=at_s,
        heading_deg=0.0,
        method=method,
    )


WALKED: list[tuple[RecoveryPlace, list[RecoveryCase]]] = [
    (PLACE, [case("nothing"), *(case(method, 2) for method in ("nothing", "told", "recover"))])
]


class Still(RecoveryMethod):
    """A custom method whose controller is a function: the robots keep their stance."""

    def controller(self, start: WalkStart, to_come: Any) -> StepFunction:
        return lambda _step, _state: start.robot.stance_angles_rad


def test_a_custom_method_may_lead_its_walks_by_a_function() -> None:
    (one,) = replace(PLACE, duration_s=2.5).walk([case(f"{__name__}:Still", 2, at_s=1.0)])
    assert one.case.method.endswith(":Still")
    assert abs(one.signed_m or 0.0) < 0.05


@pytest.mark.slow
def test_an_episode_is_its_trial_and_saved_as_it_is(tmp_path: Path) -> None:
    cases, cache, again = WALKED[0][1], WalkCache(tmp_path), Remembering()
    (walks,) = walk_all(WALKED, cache, jobs=2)
    intact, left, told, recovered = walks
    assert [one.case for one in walks] == cases
    alone = run_sim_trial(PLACE.trial(case("recover", 2)), recovering_walk())
    assert alone.true_deviation is not None
    assert recovered.signed_m == alone.true_deviation.signed
    assert intact.alarms == told.alarms == ()
    assert recovered.right_kind
    assert left.alarms == recovered.alarms
    assert 0 < recovered.delay_s < 1
    assert len({one.signed_m for one in walks}) == 4
    assert repr(walk_all(WALKED, cache, progress=again)) == repr([walks])
    assert again.steps == 0


@pytest.mark.slow
def test_walks_of_a_batch_fail_and_notice_each_for_itself() -> None:
    cases = [case("recover", 5, at_s=2.4), case("recover", 1), case("recover", 2, at_s=2.2)]
    episodes = PLACE.walk(cases)
    assert [(one.alarms[0].leg, one.right_leg) for one in episodes] == [(5, True), (1, True), (2, True)]
    (alone,) = PLACE.walk(cases[2:])
    assert repr(alone) == repr(episodes[2])


def test_two_legs_may_fail_together_and_the_oracle_knows_both() -> None:
    (told, left) = (PLACE.walk([case(method, 2, 5)])[0] for method in ("told", "nothing"))
    assert (told.ended, told.alarms) == (True, ())
    assert told.last_m_s > left.last_m_s


def test_impossible_walks_are_not_used_and_own_methods_not_kept(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path)
    fell = episode(case("told", 2), status="fell", signed_m=math.nan, last_m_s=math.nan)
    own = replace(fell, case=case("mine:Mine", 2))
    cache.save(PLACE, [fell, own])
    assert repr(cache.load(PLACE)) == repr({fell.case: fell})
    cache.save(PLACE, [replace(fell, status="ok")])
    assert cache.load(PLACE) == {}


def test_walks_by_another_repertoire_are_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = replace(PLACE).fingerprint
    save_repertoire(made_up(), tmp_path / "runs" / "repertoires" / "ant.npz")
    assert replace(PLACE).fingerprint != before
