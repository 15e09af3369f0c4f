"""Walks of the recovery benchmark by each method: simulated, kept, continued."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.space import GaitSpace
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.custom_controller import StepFunction
from hexctl.control.diagnosis.standing_test import Probe
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.recovery import StopWalking
from hexctl.control.monitor.repertoire import save_repertoire
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_result import TrialResult
from hexctl.study.recovery import open_loop
from hexctl.study.recovery.episodes import Episode, RecoveryCase
from hexctl.study.recovery.methods import RecoveryMethod, ToldWalk, method_of
from hexctl.study.recovery.open_loop import rehearse
from hexctl.study.recovery.stop_and_diagnose import StopAndDiagnoseWalk
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.adapt.walking import result_of
from tests.control.monitor.repertoires import made_up
from tests.study.made_up import Remembering
from tests.study.made_up_recovery import episode, plan

PLACE = replace(plan().walked()[0][0], duration_s=4.0)


def case(
    method: str, *legs: int, failure: str = "limp", at_s: float = 2.5, heading_deg: float = 0.0
) -> RecoveryCase:
    """Case of failed legs, or of none."""
    return RecoveryCase(
        gait="tripod",
        legs=legs,
        failure=failure if legs else "intact",
        at_s=at_s,
        heading_deg=heading_deg,
        method=method,
    )


def open_case(*legs: int, method: str = "open-loop-best") -> RecoveryCase:
    return case(method, *legs, failure="locked", heading_deg=60.0)


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
    cases = [case("nothing"), *(case(method, 2) for method in ("nothing", "told", "recover"))]
    walked, cache, again = [(PLACE, cases)], WalkCache(tmp_path), Remembering()
    (walks,) = Work(cache=cache, jobs=2).walk(walked)
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
    assert repr(Work(cache=cache, progress=again).walk(walked)) == repr([walks])
    assert again.steps == 0


@pytest.mark.slow
def test_two_legs_may_fail_together_and_the_oracle_knows_both() -> None:
    (told, left) = (PLACE.walk([case(method, 2, 5)])[0] for method in ("told", "nothing"))
    assert (told.ended, told.alarms) == (True, ())
    assert told.last_m_s > left.last_m_s


@pytest.mark.slow
def test_walks_of_own_methods_are_not_kept(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path)
    fell = episode(case("told", 2), status="fell", signed_m=math.nan, last_m_s=math.nan)
    own = replace(fell, case=case("mine:Mine", 2))
    cache.save(PLACE, [fell, own])
    assert repr(cache.load(PLACE)) == repr({fell.case: fell})


def test_walks_by_another_repertoire_are_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = replace(PLACE).fingerprint
    save_repertoire(made_up(), tmp_path / "runs" / "repertoires" / "ant.npz")
    assert replace(PLACE).fingerprint != before


LONG = replace(plan().walked()[0][0], duration_s=24.0)

#: The soft stop, the standing test, and the rest before it take longer than this.
LEAST_S = 13.0


STOPPING = case("stop-diagnose", 2)


@pytest.fixture(scope="module")
def episodes() -> list[Episode]:
    legs = ((5, "locked"), (4, "missing"))
    failed = [case("stop-diagnose", leg, failure=failure) for leg, failure in legs]
    return LONG.walk([case("stop-diagnose"), STOPPING, *failed])


@pytest.mark.slow
def test_it_stands_says_what_failed_and_goes_on_along_the_line(episodes: Sequence[Episode]) -> None:
    intact, *failed = episodes
    assert intact.alarms == ()
    for one in failed:
        (alarm,) = one.alarms
        assert (one.right_leg, one.right_kind) == (True, True)
        assert alarm.evidence == "standing test"
        assert LEAST_S < one.delay_s < LEAST_S + 4
        assert one.ended
        assert one.final_m < 0.02
        assert 0 < one.after_m_s < 0.5 * intact.after_m_s, "it stood for most of that time"
        assert one.last_m_s > one.after_m_s


@pytest.mark.slow
def test_it_is_told_nothing_of_what_is_to_come(episodes: Sequence[Episode]) -> None:
    trial = LONG.trial(STOPPING)
    method = method_of("stop-diagnose")
    result = run_sim_trial(trial, lambda start: method.controller(_checked(start), [()]))
    assert repr(Episode.of(STOPPING, trial, result)) == repr(episodes[1])


def test_a_policy_that_stops_ends_the_walk_after_the_test() -> None:
    def make(start: WalkStart) -> StopAndDiagnoseWalk:
        lifts = (Probe("lift", (2,)), Probe("lift", (5,)))
        return StopAndDiagnoseWalk(start, StopWalking(), probes=lifts)

    result = run_sim_trial(LONG.trial(STOPPING), make)
    assert (result.status, result.stopped) == ("aborted", "leg 2 limp")
    assert result.duration_s < 12


def test_a_policy_that_stops_ends_the_walk_of_the_oracle_in_the_tick_of_the_failure() -> None:
    trial = LONG.trial(STOPPING)

    def make(start: WalkStart) -> ToldWalk:
        return ToldWalk(start, [trial.events], StopWalking())

    (result,) = run_sim_trials([trial], 1, make, apart=True)
    assert (result.status, result.stopped) == ("aborted", "leg 2 limp")
    assert result.duration_s == pytest.approx(trial.events[0].at_s, abs=0.03)


def _checked(start: WalkStart) -> WalkStart:
    assert all(plan.belief is None for plan in start.plans)
    return start


OPEN = replace(plan().walked()[0][0], duration_s=7.0)


def test_each_walk_has_the_gait_with_which_a_trial_ended_nearest_its_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[SimTrial] = []
    ends_m = iter([0.5, 0.1, 0.01, 0.3, 0.3, 0.2])
    statuses = iter(["ok", "ok", "fell", "ok", "no_progress", "ok"])

    def walk(trials: Sequence[SimTrial], _threads: int) -> list[TrialResult]:
        tried.extend(trials)
        return [result_of(next(ends_m), next(statuses)) for _ in trials]

    monkeypatch.setattr(open_loop, "run_sim_trials", walk)
    monkeypatch.setattr(open_loop, "TRIES", 3)
    walks = [OPEN.trial(one) for one in (open_case(), open_case(2), open_case(2, 5))]
    intact, single, pair = rehearse(walks)
    assert intact is None
    assert single is not None
    assert pair is not None
    assert (single.best, single.trials) == (tried[1].plan.gait, 3), "not the one that fell"
    assert (pair.best, pair.trials) == (tried[5].plan.gait, 3)
    assert len({one.plan.gait.slots for one in tried[:3]}) == 3
    assert {one.plan.gait.slots for one in tried[3:]} <= set(map(tuple, GaitSpace((2, 5)).slots.tolist()))
    assert {(one.plan.hold, one.plan.belief, one.plan.duration_s) for one in tried} == {("none", None, 10.0)}
    assert {event.at_s for one in tried for event in one.events} == {0.0}


@pytest.mark.long
def test_after_the_failure_nothing_holds_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(open_loop, "TRIES", 2)
    intact, failed = OPEN.walk([open_case(), open_case(2)])
    held_intact, held = OPEN.walk([open_case(method="nothing"), open_case(2, method="nothing")])
    assert (intact.trials, failed.trials) == (0, 2)
    assert intact.signed_m == held_intact.signed_m
    assert failed.status == "ok"
    assert failed.alarms == ()
    assert failed.final_m > 2 * held.final_m
    (alone,) = OPEN.walk([open_case(2)])
    assert repr(alone) == repr(failed)
