"""The loop of trials: budget, target, invalid trials, repeats, and going on after a cut."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.adapt.catalogue import make_optimizer
from hexctl.adapt.counting import FreshCodes
from hexctl.adapt.loop import AdaptLoop
from hexctl.adapt.objective import INVALID_SCORE
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.session import Session, SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.store import SessionStore
from tests.adapt.walking import SPEC, Landscape

NAMES = ("pso", "psosp", "dps", "debest", "derand", "random", "exhaustive")


def optimizer_of(spec: SessionSpec) -> Optimizer:
    inner = make_optimizer(spec.optimizer, GaitSpace((spec.failed_leg,)), spec.seed)
    return FreshCodes(inner, spec.seed, paper_count=spec.count_repeats)


def run(store: SessionStore, spec: SessionSpec, walk: Landscape | None = None) -> tuple[Session, str]:
    session = store.create(spec)
    ended = AdaptLoop(session, store, optimizer_of(spec), walk or Landscape()).run()
    return session, ended


@pytest.fixture
def store(tmp_path: Path) -> SessionStore:
    return SessionStore(tmp_path)


def test_it_spends_its_budget_and_no_gait_twice(store: SessionStore) -> None:
    session, ended = run(store, SPEC)
    assert ended == "budget"
    assert [trial.index for trial in session.trials] == list(range(1, 13))
    codes = [trial.code for trial in session.trials]
    assert len(set(codes)) == 12


def test_the_papers_count_pays_for_repetitions(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, budget=120, count_repeats=True))
    assert len(session.trials) == 120
    assert len({trial.code for trial in session.trials}) < 120


def test_it_stops_at_the_target(store: SessionStore) -> None:
    session, ended = run(store, replace(SPEC, budget=120, target_m=0.1))
    assert ended == "target"
    assert session.trials[-1].score <= 0.1
    assert all(trial.score > 0.1 for trial in session.trials[:-1])


def test_it_ends_when_every_gait_has_been_tried(store: SessionStore) -> None:
    session, ended = run(store, replace(SPEC, budget=500))
    assert ended == "exhausted"
    assert sorted(trial.code for trial in session.trials) == list(range(1, 121))


def test_an_invalid_trial_is_never_the_best(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, budget=120, optimizer="exhaustive"))
    invalid = [trial for trial in session.trials if trial.code % 7 == 0]
    assert all(trial.score == INVALID_SCORE for trial in invalid)
    assert session.best is not None
    assert session.best.code == 60
    assert session.as_json()["trials"][6]["score"] is None


def test_the_best_is_repeated_within_the_budget(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, confirm=2))
    assert len(session.trials) == 12
    assert [trial.confirms for trial in session.trials] == [False] * 10 + [True] * 2
    assert {trial.code for trial in session.trials[-2:]} == {session.best.code if session.best else None}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cut", [0, 1, 5, 11, 12, 13])
def test_a_session_that_was_cut_ends_as_if_it_had_not_been(name: str, cut: int, store: SessionStore) -> None:
    spec = replace(SPEC, optimizer=name, budget=14, confirm=1)
    whole, _ = run(store, spec)
    session, ended = run(store, spec, Landscape(cut_after=cut))
    assert ended == "interrupted"
    assert len(session.trials) == cut
    resumed = store.load(session.name)
    assert AdaptLoop(resumed, store, optimizer_of(spec), Landscape()).run() == "budget"
    assert resumed.trials == whole.trials
    assert store.load(session.name).trials == whole.trials


def test_an_aborted_trial_is_not_kept(store: SessionStore) -> None:
    session, ended = run(store, SPEC, Landscape(cut_after=3))
    assert ended == "interrupted"
    assert len(store.load(session.name).trials) == 3


def test_each_trial_is_on_disk_before_the_next_begins(store: SessionStore, tmp_path: Path) -> None:
    seen: list[int] = []

    class Watching(Landscape):
        def __call__(  # type: ignore[override]
            self, index: int, code: int, slots: tuple[int, ...], enough: object = None
        ) -> object:
            with SessionStore(tmp_path) as other:
                seen.append(len(other.load(other.names()[-1]).trials))
            return super().__call__(index, code, slots)

    run(store, SPEC, Watching())
    assert seen == list(range(12))
