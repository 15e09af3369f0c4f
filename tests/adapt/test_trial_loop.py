"""The loop of trials: budget, target, invalid trials, repeats, and going on after a cut."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES, as_objective
from hexctl.adapt.optimizers.bayes import REAL_NOISE_M, Bayes
from hexctl.adapt.prior.samples import FINAL
from hexctl.adapt.runner import TrialRequest, WalkedTrial, WalkTrial
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.trial_loop import AdaptLoop
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, RecordingError
from hexctl.types import FloatArray
from tests.adapt.killing import optimizer_of
from tests.adapt.priors import BAYES_SPEC, MadeUpModel, MadeUpWorld, made_up_bayes
from tests.adapt.walking import SPEC, Landscape, cut_off

MODEL = MadeUpModel()

_WORLDS = MODEL.worlds(40, 500)

_BEST_M = np.abs(_WORLDS[..., FINAL]).min(axis=1)

#: A made-up world in which some gait is within the target that is no first choice.
KIND = _WORLDS[np.flatnonzero(_BEST_M < 0.01)[3]]

NAMES = ("pso", "psosp", "dps", "debest", "derand", "random", "exhaustive")


def run(store: SessionStore, spec: SessionSpec, walk: WalkTrial | None = None) -> tuple[Session, str]:
    session = store.create(spec)
    ended = AdaptLoop(session, store, optimizer_of(spec), walk or Landscape()).run()
    return session, ended


def run_on(store: SessionStore, name: str) -> tuple[Session, str]:
    """Continue a session and return it, and why it ended."""
    session = load_session(name, store.folder)
    loop = AdaptLoop(session, store, optimizer_of(session.spec), Landscape())
    return session, loop.run()


@pytest.fixture
def store(tmp_path: Path) -> SessionStore:
    return SessionStore(tmp_path)


def test_an_objective_that_fails_is_named_with_its_trial_and_nothing_before_it_is_lost(
    store: SessionStore,
) -> None:
    whole, _ = run(store, SPEC)
    session = store.create(SPEC)

    def divides(result: TrialResult) -> float:
        return OBJECTIVES["final"].measure(result) / (len(session.trials) < 4)

    spoiled = as_objective(divides, "mine:ratio")
    with pytest.raises(InputError) as failed:
        AdaptLoop(session, store, optimizer_of(SPEC), Landscape(), objective=spoiled).run()
    code = whole.trials[4].code  # the fourth trial is invalid and not measured
    for words in ("mine:ratio", "trial 5", f"gait {code}", "ZeroDivisionError", session.name):
        assert words in str(failed.value)
    assert len(load_session(session.name, store.folder).trials) == 4
    resumed, ended = run_on(store, session.name)
    assert (ended, [trial.code for trial in resumed.trials]) == (
        "budget",
        [trial.code for trial in whole.trials],
    )


def test_it_stops_at_the_target(store: SessionStore) -> None:
    session, ended = run(store, replace(SPEC, budget=120, target_m=0.1))
    assert ended == "target"
    assert session.trials[-1].score <= 0.1
    assert all(trial.score > 0.1 for trial in session.trials[:-1])


def test_it_ends_when_every_gait_has_been_tried(store: SessionStore) -> None:
    session, ended = run(store, replace(SPEC, budget=500))
    assert ended == "exhausted"
    assert sorted(trial.code for trial in session.trials) == list(range(1, 121))


def test_the_best_is_repeated_within_the_budget(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, confirm=2))
    assert len(session.trials) == 12
    assert [trial.confirms for trial in session.trials] == [False] * 10 + [True] * 2
    assert {trial.code for trial in session.trials[-2:]} == {session.best.code if session.best else None}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cut", [0, 5, 13])
def test_a_session_that_was_cut_ends_as_if_it_had_not_been(name: str, cut: int, store: SessionStore) -> None:
    spec = replace(SPEC, optimizer=name, budget=14, confirm=1)
    whole, _ = run(store, spec)
    session, ended = run(store, spec, cut_off(Landscape(), cut))
    assert ended == "interrupted"
    assert len(session.trials) == cut
    resumed = load_session(session.name, store.folder)
    assert AdaptLoop(resumed, store, optimizer_of(spec), Landscape()).run() == "budget"
    assert resumed.trials == whole.trials
    assert load_session(session.name, store.folder).trials == whole.trials


def with_budget(session: Session, budget: int, store: SessionStore) -> Session:
    """A session from the disk after it got another budget."""
    session.spec = replace(session.spec, budget=budget)
    store.keep(session)
    return load_session(session.name, store.folder)


def test_a_greater_budget_has_the_best_confirmed_again(store: SessionStore) -> None:
    spec = replace(SPEC, budget=14, confirm=2)
    session, _ = run(store, replace(spec, budget=6))
    longer = with_budget(session, 14, store)
    assert AdaptLoop(longer, store, optimizer_of(spec), Landscape()).run() == "budget"
    assert [trial.index for trial in longer.trials if trial.confirms] == [5, 6, 13, 14]
    assert {trial.code for trial in longer.trials[-2:]} == {longer.best.code if longer.best else None}


def believing(**options: Any) -> Bayes:
    return made_up_bayes(MODEL.samples(48), **options)


def with_a_bad_start() -> FloatArray:
    """The kind world, but the gait that is tried first goes astray."""
    world: FloatArray = KIND.copy()
    world[believing().ask()[0] - 1, : FINAL + 1] = 2.5 * (np.arange(1, 11) / 10) ** 1.5
    return world


def walked_by_bayes(
    store: SessionStore, world: MadeUpWorld, spec: SessionSpec = BAYES_SPEC, **options: Any
) -> tuple[Session, str]:
    session = store.create(spec)
    return session, AdaptLoop(session, store, believing(**options), world).run()


def test_a_search_that_is_sure_ends_confirmed(store: SessionStore) -> None:
    session, ended = walked_by_bayes(store, MadeUpWorld(KIND))
    assert ended == "confirmed"
    assert len(session.trials) < 12
    assert session.best is not None
    assert session.best.score <= 0.025
    assert session.settled_on is not None
    assert session.settled_on["code"] == session.best.code
    assert 0.9 <= session.settled_on["chance"] <= 1.0
    assert session.as_json()["settled_on"] == session.settled_on


def test_a_target_that_the_optimizer_judges_is_not_judged_by_one_lucky_trial(store: SessionStore) -> None:
    """On a real floor one trial within the target is not yet the end, though the best score is below it."""
    spec = replace(BAYES_SPEC, target_m=0.025, budget=30)
    session, ended = walked_by_bayes(store, MadeUpWorld(KIND), spec, noise_m=REAL_NOISE_M)
    assert ended == "confirmed"
    first = next(trial.index for trial in session.trials if trial.score <= 0.025)
    assert first < len(session.trials)
    assert session.trials[-1].code in [trial.code for trial in session.trials[:-1]]


def test_an_early_stop_is_an_invalid_trial_that_took_less_time(store: SessionStore) -> None:
    spec = replace(BAYES_SPEC, early_stop=True, budget=60)
    session, ended = walked_by_bayes(store, MadeUpWorld(with_a_bad_start()), spec)
    cut = [trial for trial in session.trials if trial.outcome["status"] == "cut_short"]
    assert cut
    for trial in cut:
        assert trial.score == INVALID_SCORE
        assert not trial.valid
        assert trial.as_json()["score"] is None
        assert 0 < trial.as_json()["walked_s"] < 30.0
    assert ended == "confirmed"
    assert session.best is not None
    assert session.best.outcome["status"] == "ok"
    # Nothing of a walk that was cut short is asked for again.
    codes = [trial.code for trial in session.trials]
    assert len(set(codes)) == len(codes)


def test_repeats_are_of_the_gait_that_it_settles_on_and_are_learned_from(store: SessionStore) -> None:
    spec = replace(BAYES_SPEC, budget=30, confirm=2)
    session, ended = walked_by_bayes(store, MadeUpWorld(KIND), spec, noise_m=REAL_NOISE_M)
    assert ended == "confirmed"
    assert [trial.confirms for trial in session.trials[-3:]] == [False, True, True]
    assert session.settled_on is not None
    assert {trial.code for trial in session.trials[-2:]} == {session.settled_on["code"]}
    alone, _ = walked_by_bayes(
        store, MadeUpWorld(KIND), replace(spec, budget=28, confirm=0), noise_m=REAL_NOISE_M
    )
    assert alone.settled_on is not None
    assert session.settled_on["chance"] > alone.settled_on["chance"]


class NoRoom(Landscape):
    """The recording of one trial is not whole."""

    def __init__(self, full_at: int) -> None:
        super().__init__()
        self._full_at = full_at

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        walked, full = super().__call__(request), request.index == self._full_at
        return replace(walked, recording_error=OSError("disk full")) if full else walked


def test_a_recording_that_is_not_whole_costs_no_trial_and_is_reported(store: SessionStore) -> None:
    session = store.create(SPEC)
    with pytest.raises(RecordingError, match=r"trial 2 .*disk full"):
        AdaptLoop(session, store, optimizer_of(SPEC), NoRoom(2)).run()
    assert [trial.index for trial in load_session(session.name, store.folder).trials] == [1, 2]
    whole, ended = run(store, SPEC)
    resumed, ended_later = run_on(store, session.name)
    assert (resumed.trials, ended_later) == (whole.trials, ended)


BASELINE_SPEC = replace(SPEC, baseline_gaits=["demo", "tripod"])


def test_a_baseline_comes_before_the_trials_and_changes_none_of_them(store: SessionStore) -> None:
    walk = Landscape()
    session, ended = run(store, BASELINE_SPEC, walk)
    plain, _ = run(store, SPEC)
    assert (ended, [one.gait for one in session.baseline]) == ("budget", ["demo", "tripod"])
    assert walk.walked[:2] == [0, 0]
    assert [trial.code for trial in session.trials] == [trial.code for trial in plain.trials]
    assert load_session(session.name, store.folder) == session
    assert session.best == plain.best


def test_a_baseline_is_walked_once_whenever_the_session_was_cut_off(store: SessionStore) -> None:
    session = store.create(BASELINE_SPEC)
    for cut, gaits in ((1, ["demo"]), (1, ["demo", "tripod"]), (3, ["demo", "tripod"])):
        session = load_session(session.name, store.folder)
        loop = AdaptLoop(session, store, optimizer_of(session.spec), cut_off(Landscape(), cut))
        assert loop.run() == "interrupted"
        assert [one.gait for one in session.baseline] == gaits
    assert len(session.trials) == 3
    ended, whole = run_on(store, session.name)[1], run(store, SPEC)[0]
    assert ended == "budget"
    assert [trial.code for trial in load_session(session.name, store.folder).trials] == [
        one.code for one in whole.trials
    ]


def test_an_invalid_trial_is_never_the_best(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, budget=120, optimizer="exhaustive"))
    invalid = [trial for trial in session.trials if trial.code % 7 == 0]
    assert all(trial.score == INVALID_SCORE for trial in invalid)
    assert session.best is not None
    assert session.best.code == 60
    assert session.as_json()["trials"][6]["score"] is None
