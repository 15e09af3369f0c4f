"""Walks of the recovery benchmark by each method: simulated, kept, continued; and what its rivals search."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.build_archive import cell_of
from hexctl.adapt.space import GaitSpace
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.custom_controller import StepFunction
from hexctl.control.diagnosis.standing_test import Probe
from hexctl.control.monitor.monitored_walk import recovering_walk
from hexctl.control.monitor.recovery import StopWalking
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.learning.learned_walk import OBSERVATION_SIZE
from hexctl.learning.policy import policy_file, policy_of
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.model import Robot
from hexctl.study.recovery import evolution, open_loop, shaped_walk
from hexctl.study.recovery.episodes import Episode, RecoveryCase
from hexctl.study.recovery.evolution import EvolutionSearch
from hexctl.study.recovery.methods import OracleWalk, RecoveryMethod, method_of
from hexctl.study.recovery.open_loop import rehearse
from hexctl.study.recovery.shaped_walk import FELL, scores_of, search_shapes, shape_of, trial_of
from hexctl.study.recovery.stop_and_diagnose import StopAndDiagnoseWalk
from hexctl.study.recovery.trial_and_error import (
    KIND,
    Behaviours,
    TrialAndErrorSearch,
    behaviours_file,
    behaviours_of,
)
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from hexctl.types import FloatArray
from tests.adapt.walking import result_of
from tests.robots import shipped
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
def test_the_standing_test_names_the_failure_and_the_walk_goes_on(episodes: Sequence[Episode]) -> None:
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

    def make(start: WalkStart) -> Any:
        assert all(plan.failures == () for plan in start.plans)
        return method.controller(start, [()])

    result = run_sim_trial(trial, make)
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

    def make(start: WalkStart) -> OracleWalk:
        return OracleWalk(start, [trial.events], StopWalking())

    (result,) = run_sim_trials([trial], 1, make, apart=True)
    assert (result.status, result.stopped) == ("aborted", "leg 2 limp")
    assert result.duration_s == pytest.approx(trial.events[0].at_s, abs=0.03)


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
    assert {(one.plan.hold, one.plan.failures, one.plan.duration_s) for one in tried} == {("none", (), 10.0)}
    assert {event.at_s for one in tried for event in one.events} == {0.0}


PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"), duration_s=12.0, self_rotation="none", hold="line")


def archive(count: int = 40) -> Behaviours:
    """Behaviours whose first number of the shape is their place."""
    random = np.random.default_rng(1)
    shapes = np.zeros((count, 6, 4))
    shapes[:, 0, 0] = np.arange(count) / count
    return Behaviours(
        shapes=shapes, duties=random.uniform(size=(count, 6)), speeds=np.linspace(1.0, 0.5, count),
        robot_fingerprint="ant", origin={"evaluations": 7},
    )  # fmt: skip


def told(search: TrialAndErrorSearch, score: float) -> FloatArray:
    (shape,) = search.ask()
    search.tell(np.array([score]))
    return shape


def test_trial_and_error_ends_with_a_gait_that_walks_as_in_the_archive() -> None:
    search = TrialAndErrorSearch(archive())
    assert told(search, 0.95)[0, 0] == 0, "the fastest comes first"
    assert not search.ask()


def test_trial_and_error_leaves_the_neighbourhood_of_a_gait_that_failed() -> None:
    known = archive()
    near = replace(known, duties=np.where(np.arange(40)[:, np.newaxis] < 20, 0.2, known.duties + 1))
    search = TrialAndErrorSearch(near)
    told(search, FELL)
    assert told(search, 0.1)[0, 0] >= 0.5, "the first twenty behave alike"


def test_an_archive_turns_with_the_direction_of_travel() -> None:
    known = archive()
    turned = known.towards(np.radians(-115))
    np.testing.assert_array_equal(turned.shapes[:, 4], known.shapes[:, 0])
    np.testing.assert_array_equal(turned.duties[:, 4], known.duties[:, 0])


def test_a_file_keeps_an_archive(tmp_path: Path) -> None:
    archive().save(tmp_path / "some.npz")
    found = KIND.load(tmp_path / "some.npz", Behaviours.of)
    assert (found.robot_fingerprint, found.origin) == ("ant", {"evaluations": 7})
    np.testing.assert_allclose(found.duties, archive().duties, atol=1e-3)
    np.testing.assert_allclose(found.shapes, archive().shapes, atol=1e-3)


def test_cells_are_quarters() -> None:
    assert cell_of(np.array([0.0, 0.12, 0.13, 0.5, 0.9, 1.0])) == (0, 0, 1, 2, 4, 4)


def test_evolution_finds_the_top_of_a_hill() -> None:
    search = EvolutionSearch(np.full((6, 4), 0.5), seed=2)
    heights: list[float] = []
    while shapes := search.ask():
        scores = np.array([-float(np.abs(shape - 0.7).sum()) for shape in shapes])
        search.tell(scores)
        heights.append(float(scores.max()))
    assert len(heights) == 3, "forty trials are three generations of thirteen"
    assert heights[-1] > heights[0]


@pytest.mark.slow
def test_the_shape_of_a_gait_walks_like_the_gait_and_a_search_keeps_its_best(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evolution, "MOST_TRIALS", 13)
    monkeypatch.setattr(shaped_walk, "TRIAL_S", 2.5)
    events = (parse_failure_event("2:limp@5"),)
    trial = SimTrial(robot=shipped(), plan=PLAN, failures=None, events=events)
    whole = replace(trial, events=())
    tripod, still = shape_of(PLAN.gait), np.zeros((6, 4))
    walked, stood = scores_of([(trial_of(whole), tripod), (trial_of(whole), still)])
    assert walked > 0.5
    assert abs(stood) < 0.1
    found, nothing = search_shapes(lambda _: EvolutionSearch(tripod, seed=0), [trial, whole])
    assert found is not None
    assert nothing is None
    first = EvolutionSearch(tripod, seed=0).ask()
    scores = scores_of([(trial_of(trial), shape) for shape in first])
    assert found.trials == 13
    np.testing.assert_array_equal(found.best, first[int(np.argmax(scores))])


def test_what_is_shipped_for_ant_is_small_and_says_how_it_was_made() -> None:
    behaviours, policy = behaviours_of(shipped()), policy_of(shipped())
    assert behaviours.origin["evaluations"] > len(behaviours.speeds) > 100
    assert len({cell_of(duties) for duties in behaviours.duties}) > 0.9 * len(behaviours.speeds), "rounded"
    assert policy.origin["steps"] > 10_000
    assert np.isfinite(policy(np.zeros(OBSERVATION_SIZE))).all()
    for file in (behaviours_file(shipped()), policy_file(shipped())):
        assert file.stat().st_size < 200_000, file.name


@pytest.mark.parametrize("learned", [policy_of, behaviours_of])
def test_robots_that_nothing_was_learned_for_are_refused(learned: Callable[[Robot], object]) -> None:
    with pytest.raises(InputError, match="pexod"):
        learned(shipped("pexod"))
