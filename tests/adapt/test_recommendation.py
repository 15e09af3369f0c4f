"""Which walk a session recommends, and which ends are confirmed by a walk at a finer time step."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.runner import WalkedTrial
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import FILE_NAME, SessionStore, StoreError, load_session
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.trial_loop import AdaptLoop
from hexctl.control.trial import Enough
from hexctl.gait.encoding import Slots
from tests.adapt.walking import result_of


def stored(off_m: float, margin_m: float | None = None) -> dict[str, Any]:
    return {
        "score": abs(off_m),
        "outcome": result_of(off_m).to_dict(),
        "path_m": [],
        "recording": None,
        "margin_m": margin_m,
    }


def trial(index: int, off_m: float, margin_m: float | None = None) -> TrialRecord:
    return TrialRecord(index=index, code=index, slots=(1, 2, 3, 4, 5, 6), **stored(off_m, margin_m))


def walk(gait: str, off_m: float, margin_m: float | None = None) -> BaselineRecord:
    return BaselineRecord(gait=gait, code=None, slots=(1, 4, 1, 4, 1, 4), **stored(off_m, margin_m))


def recommended(
    *baseline: BaselineRecord, trials: tuple[TrialRecord, ...], uncertainty_m: float = 0.025, **spec: Any
) -> str | int | None:
    """Name of the gait of the baseline, or index of the trial, that a session recommends."""
    session = Session(
        name="s",
        spec=SessionSpec(failed_leg=5, uncertainty_m=uncertainty_m, **spec),
        created="2026-01-01",
        trials=list(trials),
        baseline=list(baseline),
    )
    best = session.best_walk
    return None if best is None else best.gait if isinstance(best, BaselineRecord) else best.index


@pytest.mark.parametrize("trial_m", [0.0, 0.06])
def test_a_gait_without_a_search_is_recommended_if_the_best_trial_is_not_resolved_from_it(
    trial_m: float,
) -> None:
    """The best trial, 6 cm off, was recommended though the tripod was 0.1 cm off: 5.9 cm are not resolved."""
    assert recommended(walk("tripod", 0.001), trials=(trial(1, trial_m), trial(2, 0.2))) == "tripod"


def test_a_trial_that_is_resolved_from_every_other_walk_is_recommended() -> None:
    assert recommended(walk("auto", 0.3), walk("demo", 0.5), trials=(trial(1, 0.2), trial(2, 0.01))) == 2
    assert recommended(walk("tripod", INVALID_SCORE), trials=(trial(1, 0.2),)) == 1


def test_of_gaits_that_need_no_search_the_one_with_the_largest_margin_is_recommended() -> None:
    near = (walk("auto", 0.03, 0.04), walk("demo", 0.001, -0.01), walk("tripod", 0.02, 0.02))
    assert recommended(*near, trials=(trial(1, 0.0, 0.1),)) == "auto"
    assert recommended(*near, trials=(trial(1, 0.0),), uncertainty_m=0.0001) == 1
    assert recommended(*near, trials=(trial(1, 0.1),), uncertainty_m=0.001) == "demo"
    unknown = (walk("auto", 0.03), walk("demo", 0.001))
    assert recommended(*unknown, trials=(trial(1, 0.0),)) == "demo", "without margins: the straightest"


def test_if_nothing_is_known_of_the_resolution_the_straightest_is_recommended() -> None:
    assert recommended(walk("tripod", 0.001), trials=(trial(1, 0.0),), uncertainty_m=0.0) == 1
    assert recommended(walk("tripod", 0.001), trials=(trial(1, 0.001),), uncertainty_m=0.0) == "tripod"


def test_before_the_first_trial_nothing_is_recommended() -> None:
    assert recommended(walk("tripod", 0.001), trials=()) is None


SPEC = SessionSpec(
    failed_leg=5,
    optimizer="exhaustive",
    budget=5,
    target_m=0.025,
    uncertainty_m=0.025,
    confirmed_uncertainty_m=0.008,
    baseline_gaits=["tripod"],
)

#: Ends of the five trials by code, and of the tripod as code 0.
ENDS = {0: 0.5, 1: 0.30, 2: 0.01, 3: -0.02, 4: 0.04, 5: 0.20}


class Ends:
    """Walks gaits to given ends."""

    def __init__(self, ends: Mapping[int, float], *, aborted: bool = False, status: str = "ok") -> None:
        self.ends, self.aborted, self.status = ends, aborted, status
        self.walked: list[int] = []

    def __call__(self, index: int, code: int, slots: Slots, should_stop: Enough | None = None) -> WalkedTrial:
        if self.aborted:
            return WalkedTrial(result=result_of(0.0, "aborted"))
        self.walked.append(code)
        return WalkedTrial(result=result_of(self.ends[code], self.status))


def search(store: SessionStore, finely: Ends, *, name: str | None = None, **spec: float) -> Session:
    """A session, new or continued, of trials with the ends `ENDS`, confirmed by walks with other ends."""
    session = store.create(replace(SPEC, **spec)) if name is None else load_session(name, store.folder)  # type: ignore[arg-type]
    optimizer = make_optimizer("exhaustive", GaitSpace((5,)), 0)
    loop = AdaptLoop(
        session,
        store,
        Deduplication(optimizer, 0, paper_count=False),
        Ends(ENDS),
        walk_finely=finely,
    )
    loop.run()
    return session


@pytest.fixture
def store(tmp_path: Path) -> SessionStore:
    return SessionStore(tmp_path)


#: A target that is never reached: all five are walked.
NEVER_M = 1e-6


def test_the_candidate_walks_once_more_and_its_own_end_counts(store: SessionStore) -> None:
    finely = Ends({2: -0.012})
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked == [2]
    assert session.best_walk is not None
    assert session.best_walk.code == 2
    printed = session.as_json()["recommended"]
    assert (printed["code"], printed["confirmed"]) == (2, True)
    assert (printed["score"], printed["uncertainty_m"]) == (pytest.approx(0.012), 0.008)
    assert session.as_json()["confirmations"][0]["time_step_s"] == 0.0005
    assert load_session(session.name, store.folder) == session


def test_a_target_that_single_trials_cannot_resolve_is_confirmed(store: SessionStore) -> None:
    near = search(store, Ends({1: 0.3, 2: 0.01, 3: 0.0, 4: 0.0, 5: 0.0}), target_m=NEVER_M)
    near.spec = replace(near.spec, target_m=0.025)
    assert near.within_target is not None
    assert near.within_target > 0.9
    assert near.spec.greatest_chance is not None
    assert near.spec.greatest_chance < 0.7
    far = search(store, Ends({0: 0.5, 1: 0.3, 2: 0.05, 3: 0.06, 4: 0.07}), target_m=NEVER_M)
    far.spec = replace(far.spec, target_m=0.025)
    assert far.within_target is not None
    assert far.within_target < 0.01


def test_a_candidate_that_ends_worse_than_another_trial_gives_way_to_it(store: SessionStore) -> None:
    finely = Ends({0: 0.5, 2: 0.09, 3: 0.03})
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked == [2, 3, 0]
    assert session.best_walk is not None
    assert session.best_walk.code == 3


def test_at_most_three_trials_are_confirmed(store: SessionStore) -> None:
    finely = Ends({2: 0.5, 3: 0.6, 4: 0.45, 0: 0.46})
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked == [2, 3, 4, 0], "the tripod is not resolved from the best of them"
    assert isinstance(session.best_walk, BaselineRecord)


def test_a_baseline_that_is_not_resolved_walks_too_and_is_preferred(
    store: SessionStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ENDS, 0, 0.06)
    finely = Ends({2: 0.01, 0: 0.02})
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked == [2, 0]
    assert isinstance(session.best_walk, BaselineRecord)
    worse = search(store, Ends({2: 0.01, 0: 0.06}), target_m=NEVER_M)
    assert worse.best_walk is not None
    assert worse.best_walk.code == 2, "5 cm are resolved by two confirmed walks"


def test_no_trial_is_recommended_that_a_baseline_beats_at_the_finer_step(store: SessionStore) -> None:
    finely = Ends({0: 0.01, 2: 0.05, 3: 0.06, 4: 0.07})
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked[-1] == 0, "0.5 m at the usual step, resolved from the trials"
    assert isinstance(session.best_walk, BaselineRecord)


def test_a_candidate_that_falls_at_the_finer_step_is_not_recommended(store: SessionStore) -> None:
    class Falling(Ends):
        def __call__(self, index: int, code: int, *rest: object) -> WalkedTrial:
            self.status = "fell" if code == 2 else "ok"
            return super().__call__(index, code, *rest)  # type: ignore[arg-type]

    session = search(store, Falling({2: 0.0, 3: 0.01}), target_m=NEVER_M)
    assert session.best_walk is not None
    assert session.best_walk.code == 3


def test_an_interrupted_confirmation_loses_nothing(store: SessionStore) -> None:
    cut = search(store, Ends({}, aborted=True), target_m=NEVER_M)
    assert (cut.ended, len(cut.trials), cut.confirmations) == (None, 5, [])
    finely = Ends({2: 0.01})
    whole = search(store, finely, name=cut.name)
    assert (whole.ended, whole.trials, finely.walked) == ("budget", cut.trials, [2])
    again = Ends({})
    assert search(store, again, name=cut.name).confirmations == whole.confirmations
    assert again.walked == []


def test_what_cannot_be_known_better_is_not_walked_again(store: SessionStore) -> None:
    finely = Ends({})
    session = search(store, finely, target_m=NEVER_M, confirmed_uncertainty_m=0.0)
    assert finely.walked == []
    assert session.as_json()["recommended"]["confirmed"] is False
    assert session.within_target is None


def test_a_damaged_confirmation_is_named(store: SessionStore) -> None:
    name = search(store, Ends({2: 0.01}), target_m=NEVER_M).name
    path = store.folder / name / FILE_NAME
    path.write_text(path.read_text().replace('"time_step_s": 0.0005', '"time_step_s": -1.0'))
    told: list[StoreError] = []
    session = load_session(name, store.folder, on_damage=told.append)
    assert session.confirmations == []
    assert "time_step_s" in str(told[0])


def test_a_simulated_search_confirms_in_its_own_world_at_a_finer_step(tmp_path: Path) -> None:
    """Walks of 2 s: what is compared is the end of the same gait at both steps, not a recording."""
    options: dict[str, Any] = {"prior": "none", "optimizer": "random", "baseline": False}
    spec = new_spec(failed_leg=2, budget=1, duration_s=2.0, world="slope", **options)
    spec = replace(spec, uncertainty_m=0.02, confirmed_uncertainty_m=0.005)
    seen: list[float] = []
    result = Adaptation(spec, folder=tmp_path, record=False).run(
        on_confirmation=lambda _, walk: seen.append(walk.time_step_s)
    )
    confirmed = result.session.confirmations
    assert seen == [0.0005] * len(confirmed)
    assert confirmed
    best = {walk.slots: walk for walk in (*result.baseline, *result.trials)}
    for walk in confirmed:
        assert 0 < abs(walk.score - best[walk.slots].score) < 0.02
