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
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.landscapes.evaluate import Silent
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryConditions
from hexctl.study.recovery.methods import RecoveryMethod
from hexctl.study.recovery.recovery_walks import EpisodeCache, walk_all, walk_episodes
from tests.control.monitor.repertoires import made_up
from tests.study.recovery.made_up import episode, plan

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


WALKED: list[tuple[RecoveryConditions, list[RecoveryCase]]] = [
    (PLACE, [case("nothing"), *(case(method, 2) for method in ("nothing", "told", "recover"))])
]


class Still(RecoveryMethod):
    """A custom method whose controller is a function: the robots keep their stance."""

    def controller(self, start: WalkStart, to_come: Any) -> StepFunction:
        return lambda _step, _state: start.robot.stance_angles_rad


def test_a_custom_method_may_lead_its_walks_by_a_function() -> None:
    (one,) = walk_episodes(replace(PLACE, duration_s=2.5), [case(f"{__name__}:Still", 2, at_s=1.0)])
    assert one.case.method.endswith(":Still")
    assert abs(one.signed_m or 0.0) < 0.05


class Counting(Silent):
    """Counts the walks, and is interrupted after some."""

    def __init__(self, interrupt_after: int | None = None) -> None:
        self.walks, self._left = 0, interrupt_after

    def step(self) -> None:
        """Count a walk."""
        self.walks += 1
        if self.walks == self._left:
            raise KeyboardInterrupt


def test_an_episode_is_its_trial_and_saved_as_it_is(tmp_path: Path) -> None:
    cache = EpisodeCache(LandscapeCache(tmp_path))
    walked = walk_all(WALKED, cache, Silent(), 2)
    intact, left, told, recovered = (one for _, one in walked)
    assert [one.case for _, one in walked] == WALKED[0][1]
    alone = run_sim_trial(PLACE.trial(case("recover", 2)), recovering_walk())
    assert alone.true_deviation is not None
    assert recovered.signed_m == alone.true_deviation.signed
    assert intact.alarms == told.alarms == ()
    assert recovered.right_kind
    assert left.alarms == recovered.alarms
    assert 0 < recovered.delay_s < 1
    assert len({one.signed_m for _, one in walked}) == 4

    progress = Counting()
    again = walk_all(WALKED, cache, progress, 1)
    assert progress.walks == 0
    assert repr(again) == repr(walked)
    assert cache.count(WALKED) == (4, 4)


def test_walks_of_a_batch_fail_and_notice_each_for_itself() -> None:
    cases = [case("recover", 5, at_s=2.4), case("recover", 1), case("recover", 2, at_s=2.2)]
    episodes = walk_episodes(PLACE, cases)
    assert [(one.alarms[0].leg, one.right_leg) for one in episodes] == [(5, True), (1, True), (2, True)]
    (alone,) = walk_episodes(PLACE, cases[2:])
    assert repr(alone) == repr(episodes[2])


def test_two_legs_may_fail_together_and_the_oracle_knows_both() -> None:
    (told, left) = (walk_episodes(PLACE, [case(method, 2, 5)])[0] for method in ("told", "nothing"))
    assert (told.ended, told.alarms) == (True, ())
    assert told.last_m_s > left.last_m_s


def test_what_was_interrupted_goes_on_from_what_has_finished(tmp_path: Path) -> None:
    walked = [(replace(PLACE, duration_s=0.5), WALKED[0][1])]
    cache = EpisodeCache(LandscapeCache(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        walk_all(walked, cache, Counting(interrupt_after=1), 1)
    assert cache.count(walked) == (2, 4)
    progress = Counting()
    walk_all(walked, cache, progress, 1)
    assert progress.walks == 2


@pytest.mark.parametrize("content", ["", "[]x", "[1]", '[{"case": {}}]', "null", '[{"case": 1}]'])
def test_a_damaged_file_is_reported_and_its_walks_are_made_again(content: str, tmp_path: Path) -> None:
    landscapes = LandscapeCache(tmp_path)
    cache = EpisodeCache(landscapes)
    cache.path_of(PLACE).write_text(content, encoding="utf-8")
    assert cache.load(PLACE) == {}
    assert [note.partition(":")[0] for note in landscapes.notes] == [str(cache.path_of(PLACE))]


def test_impossible_walks_are_not_used_and_own_methods_not_kept(tmp_path: Path) -> None:
    cache = EpisodeCache(LandscapeCache(tmp_path))
    fell = episode(case("told", 2), status="fell", signed_m=math.nan, last_m_s=math.nan)
    own = replace(fell, case=case("mine:Mine", 2))
    cache.save(PLACE, [fell, own])
    assert repr(cache.load(PLACE)) == repr({fell.case: fell})
    for bad in (replace(fell, status="danced"), replace(fell, status="ok"), replace(fell, way_m=None)):  # type: ignore[arg-type]
        cache.save(PLACE, [bad])
        assert cache.load(PLACE) == {}


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CacheError, match="cannot be written"):
        EpisodeCache(LandscapeCache(tmp_path / "file")).save(PLACE, [])


def test_walks_by_another_repertoire_are_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = PLACE.fingerprint
    save_repertoire(made_up(), tmp_path / "runs" / "repertoires" / "ant.npz")
    assert PLACE.fingerprint != before
