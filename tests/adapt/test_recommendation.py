"""Which walk a session recommends, and which ends are confirmed by a walk at a finer time step."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.runner import TrialRequest, WalkedTrial, WalkTrial
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.trial_loop import AdaptLoop
from tests.adapt.walking import baseline_record as usual
from tests.adapt.walking import cut_off, record, result_of


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


NEAR = (
    usual("auto", 0.03, 0.04),
    usual("demo", 0.001, -0.01),
    usual("tripod", 0.02, 0.02),
)
TRIPOD = (usual("tripod", 0.001),)


@pytest.mark.parametrize(
    ("baseline", "trials", "uncertainty_m", "best"),
    [
        # Without a search, if the best trial is not resolved from it.
        (TRIPOD, (record(1, 0.0), record(2, 0.2)), 0.025, "tripod"),
        (TRIPOD, (record(1, 0.06), record(2, 0.2)), 0.025, "tripod"),
        # A trial that is resolved from all others.
        (
            (usual("auto", 0.3), usual("demo", 0.5)),
            (record(1, 0.2), record(2, 0.01)),
            0.025,
            2,
        ),
        ((usual("tripod", result_of(0.1, "fell")),), (record(1, 0.2),), 0.025, 1),
        # The largest margin among those that need no search; without margins the straightest.
        (NEAR, (record(1, 0.0, 0.1),), 0.025, "auto"),
        (NEAR, (record(1, 0.0),), 0.0001, 1),
        (NEAR, (record(1, 0.1),), 0.001, "demo"),
        ((usual("auto", 0.03), usual("demo", 0.001)), (record(1, 0.0),), 0.025, "demo"),
        # The straightest, if nothing is known of the resolution; not by less than half a millimetre.
        (TRIPOD, (record(1, 0.0006),), 0.0, "tripod"),
        (TRIPOD, (record(1, 0.0),), 0.0, 1),
        (TRIPOD, (record(1, 0.001),), 0.0, "tripod"),
        (TRIPOD, (), 0.025, None),
    ],
)
def test_the_walk_that_is_recommended(
    baseline: tuple[BaselineRecord, ...],
    trials: tuple[TrialRecord, ...],
    uncertainty_m: float,
    best: str | int | None,
) -> None:
    assert recommended(*baseline, trials=trials, uncertainty_m=uncertainty_m) == best


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
    """Walks gaits to given ends; NaN is a fall."""

    def __init__(self, ends: Mapping[int, float]) -> None:
        self.ends = ends
        self.walked: list[int] = []

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        code = request.code
        self.walked.append(code)
        fell = math.isnan(self.ends[code])
        return WalkedTrial(result=result_of(0.0 if fell else self.ends[code], "fell" if fell else "ok"))


def search(store: SessionStore, finely: WalkTrial, *, name: str | None = None, **spec: float) -> Session:
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


def test_a_target_that_single_trials_cannot_resolve_is_confirmed(store: SessionStore) -> None:
    near = search(store, Ends({1: 0.3, 2: 0.01, 3: 0.0, 4: 0.0, 5: 0.0}), target_m=NEVER_M)
    near.spec = replace(near.spec, target_m=0.025)
    assert near.within_target == pytest.approx(0.9696, abs=1e-3)  # 1.9 and 4.4 standard deviations
    far = search(store, Ends({0: 0.5, 1: 0.3, 2: 0.05, 3: 0.06, 4: 0.07}), target_m=NEVER_M)
    far.spec = replace(far.spec, target_m=0.025)
    assert far.within_target is not None
    assert far.within_target < 0.01


@pytest.mark.parametrize(
    ("tripod_m", "finely_m", "walked", "best"),
    [
        (0.5, {0: 0.5, 2: 0.09, 3: 0.03}, [2, 3, 0], 3),
        (0.5, {2: 0.5, 3: 0.6, 4: 0.45, 0: 0.46}, [2, 3, 4, 0], None),
        (0.5, {0: 0.01, 2: 0.05, 3: 0.06, 4: 0.07}, [2, 3, 4, 0], None),
        (0.06, {2: 0.01, 0: 0.02}, [2, 0], None),
        (0.06, {2: 0.01, 0: 0.06}, [2, 0], 2),
        (0.5, {2: math.nan, 3: 0.01}, [2, 3], 3),
    ],
    ids=[
        "it ends worse than another trial",
        "at most three, and the tripod that is not resolved",
        "the tripod beats all at the finer step",
        "the tripod is not resolved",
        "two confirmed walks resolve 5 cm",
        "it falls at the finer step",
    ],
)
def test_ends_at_the_finer_step_decide(
    tripod_m: float,
    finely_m: dict[int, float],
    walked: list[int],
    best: int | None,
    store: SessionStore,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Codes that are walked, 0 being the tripod, and the code of the recommendation, None being its."""
    monkeypatch.setitem(ENDS, 0, tripod_m)
    finely = Ends(finely_m)
    session = search(store, finely, target_m=NEVER_M)
    assert finely.walked == walked
    assert session.best_walk is not None
    assert session.best_walk.code == best


def test_an_interrupted_confirmation_loses_nothing(store: SessionStore) -> None:
    cut = search(store, cut_off(Ends({}), 0), target_m=NEVER_M)
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


@pytest.mark.slow
def test_a_simulated_search_confirms_in_its_own_world_at_a_finer_step(tmp_path: Path) -> None:
    """Walks of 2 s: what is compared is the end of the same gait at both steps, not a recording."""
    options: dict[str, Any] = {"prior": "none", "optimizer": "random", "baseline": False}
    spec = new_spec(failed_leg=2, budget=1, duration_s=2.0, world="slope", **options)
    spec = replace(spec, uncertainty_m=0.02, confirmed_uncertainty_m=0.005)
    seen: list[Walk] = []
    result = Adaptation(spec, folder=tmp_path, record=False).run(on_stored=lambda _, walk: seen.append(walk))
    confirmed = result.session.confirmations
    assert seen == [*result.trials, *confirmed]
    assert {walk.time_step_s for walk in confirmed} == {0.0005}
    assert confirmed
    best = {walk.slots: walk for walk in (*result.baseline, *result.trials)}
    for walk in confirmed:
        assert 0 < abs(walk.score - best[walk.slots].score) < 0.02
