"""The compared walks: simulated, kept, continued."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.control.batch import run_sim_trial
from hexctl.study.holds import hold_walks as walks_module
from hexctl.study.holds.hold_conditions import HoldCase
from hexctl.study.holds.hold_walks import HoldCache, HoldWalk, walk_all
from hexctl.study.landscapes.cache import CacheError, LandscapeCache
from hexctl.study.landscapes.evaluate import Silent
from tests.study.holds.made_up import plan, walk

PLAN = plan(worlds=1, legs=(2,), failures=("limp",), duration_s=1.0)


class Counting(Silent):
    """Counts the walks, and is interrupted after some."""

    def __init__(self, interrupt_after: int | None = None) -> None:
        self.walks, self._left = 0, interrupt_after

    def step(self) -> None:
        """Count a walk."""
        self.walks += 1
        if self.walks == self._left:
            raise KeyboardInterrupt


def same(one: HoldWalk, other: HoldWalk) -> bool:
    return repr(one) == repr(other)


def test_a_walk_is_the_trial_of_its_case_and_saved_as_it_is(tmp_path: Path) -> None:
    cache = HoldCache(LandscapeCache(tmp_path))
    walked = walk_all(PLAN, cache, Silent(), 2)
    assert [(place.family, one.case) for place, one in walked] == [
        (family, case) for family in ("transfer", "real") for case in PLAN.cases()
    ]
    for place, one in (walked[1], walked[-1]):
        alone = run_sim_trial(place.trial(one.case))
        assert alone.true_deviation is not None
        assert (one.held, one.signed_m, one.distance_m) == (
            one.case.hold,
            alone.true_deviation.signed,
            alone.distance_m,
        )
    progress = Counting()
    again = walk_all(PLAN, cache, progress, 1)
    assert progress.walks == 0
    assert all(same(one, other) for (_, one), (_, other) in zip(walked, again, strict=True))
    assert cache.count(PLAN.walked()) == (len(walked), len(walked))


def test_what_was_interrupted_goes_on_from_what_has_finished(tmp_path: Path) -> None:
    cache = HoldCache(LandscapeCache(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        walk_all(PLAN, cache, Counting(interrupt_after=1), 1)
    assert cache.count(PLAN.walked()) == (2, 12)
    progress = Counting()
    walk_all(PLAN, cache, progress, 1)
    assert progress.walks == 10


@pytest.mark.parametrize(
    "content", ["", "[]x", "{}", "[1]", '[{"case": {}}]', "null", '[{"case": 1, "slots": []}]']
)
def test_a_damaged_file_is_reported_and_its_walks_are_made_again(content: str, tmp_path: Path) -> None:
    landscapes = LandscapeCache(tmp_path)
    cache, place = HoldCache(landscapes), PLAN.conditions()[0]
    cache.path_of(place).write_text(content, encoding="utf-8")
    assert cache.load(place) == {}
    if content != "{}":
        assert [note.partition(":")[0] for note in landscapes.notes] == [str(cache.path_of(place))]


def test_impossible_walks_in_a_file_are_not_used(tmp_path: Path) -> None:
    cache, place = HoldCache(LandscapeCache(tmp_path)), PLAN.conditions()[0]
    case = HoldCase(leg=2, failure="limp", hold="line")
    fell = replace(walk(case, 0.1, status="fell"), distance_m=math.nan)
    cache.save(place, [fell])
    assert same(cache.load(place)[case], fell)
    for bad in (replace(fell, status="danced"), replace(fell, status="ok"), replace(fell, max_m=None)):  # type: ignore[arg-type]
        cache.save(place, [bad])
        assert cache.load(place) == {}


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CacheError, match="cannot be written"):
        HoldCache(LandscapeCache(tmp_path / "file")).save(PLAN.conditions()[0], [])


def test_files_are_named_by_what_decides_the_walks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = HoldCache(LandscapeCache(tmp_path))
    walk_all(
        plan(worlds=1, legs=(2,), failures=("limp",), holds=("none",), duration_s=0.2), cache, Silent(), 1
    )
    assert len(list(tmp_path.glob("hold-250-*.json"))) == 2
    (path, _) = sorted(tmp_path.glob("*.json"))
    assert json.loads(path.read_text())[0]["case"]["failure"] == "intact"
    monkeypatch.setattr(walks_module, "walk_cases", None)
    longer = plan(worlds=1, legs=(2,), failures=("limp",), holds=("none",), duration_s=0.4)
    with pytest.raises(TypeError):
        walk_all(longer, cache, Silent(), 1)
