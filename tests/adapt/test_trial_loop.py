"""The loop of trials, going on after a cut, and the walk that a session recommends and confirms."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES, as_objective
from hexctl.adapt.optimizer import Optimizer
from hexctl.adapt.optimizers.bayes import REAL_NOISE_M, Bayes
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.prior.samples import FINAL
from hexctl.adapt.runner import TrialRequest, WalkedTrial, WalkTrial
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.adapt.setting import budget_note
from hexctl.adapt.trial_loop import AdaptLoop
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, RecordingError
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, MadeUpWorld, made_up_bayes, optimizer_of
from tests.adapt.walking import SPEC, Landscape, cut_off, record, result_of
from tests.adapt.walking import baseline_record as usual

BAYES_SPEC = SessionSpec(failed_leg=5, optimizer="bayes", budget=12, prior="made-up.npz")

MODEL = MadeUpModel()

_WORLDS = MODEL.worlds(40, 500)

_BEST_M = np.abs(_WORLDS[..., FINAL]).min(axis=1)

#: A made-up world in which some gait is within the target that is no first choice.
KIND = _WORLDS[np.flatnonzero(_BEST_M < 0.01)[3]]


def run(
    store: SessionStore, spec: SessionSpec, walk: WalkTrial | None = None, search: Optimizer | None = None
) -> tuple[Session, str]:
    """A new session of a spec, and why it ended."""
    return run_on(store, store.create(spec).name, walk, search)


def run_on(
    store: SessionStore, name: str, walk: WalkTrial | None = None, search: Optimizer | None = None
) -> tuple[Session, str]:
    """A session that was continued, and why it ended."""
    session = load_session(name, store.folder)
    return session, AdaptLoop(session, store, search or optimizer_of(session.spec), walk or Landscape()).run()


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
    assert (ended, resumed.trials) == ("budget", whole.trials)


def test_it_stops_at_the_target(store: SessionStore) -> None:
    session, ended = run(store, replace(SPEC, budget=120, target_m=0.1))
    assert ended == "target"
    assert session.trials[-1].score <= 0.1
    assert all(trial.score > 0.1 for trial in session.trials[:-1])


def test_it_ends_when_every_gait_has_been_tried(store: SessionStore) -> None:
    spec = replace(SPEC, budget=500)
    session, ended = run(store, spec)
    assert ended == "exhausted"
    assert sorted(trial.code for trial in session.trials) == list(range(1, 121))
    assert "at most 120 are walked" in str(budget_note(spec))
    for enough in ({"budget": 122, "confirm": 2}, {"count_repeats": True}, {"optimizer": "bayes"}):
        assert budget_note(replace(spec, **enough)) is None


def test_the_best_is_repeated_within_the_budget(store: SessionStore) -> None:
    session, _ = run(store, replace(SPEC, confirm=2))
    assert len(session.trials) == 12
    assert [trial.confirms for trial in session.trials] == [False] * 10 + [True] * 2
    assert {trial.code for trial in session.trials[-2:]} == {session.best.code if session.best else None}


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("cut", [0, 5, 13])
def test_a_session_that_was_cut_ends_as_if_it_had_not_been(name: str, cut: int, store: SessionStore) -> None:
    spec = replace(SPEC, optimizer=name, budget=14, confirm=1)
    whole, _ = run(store, spec)
    session, ended = run(store, spec, cut_off(Landscape(), cut))
    assert ended == "interrupted"
    assert len(session.trials) == cut
    resumed, ended = run_on(store, session.name)
    assert (ended, resumed.trials) == ("budget", whole.trials)
    assert load_session(session.name, store.folder).trials == whole.trials


def test_a_greater_budget_has_the_best_confirmed_again(store: SessionStore) -> None:
    spec = replace(SPEC, budget=14, confirm=2)
    session, _ = run(store, replace(spec, budget=6))
    session.spec = spec
    store.keep(session)
    longer, ended = run_on(store, session.name)
    assert ended == "budget"
    assert [trial.index for trial in longer.trials if trial.confirms] == [5, 6, 13, 14]
    assert {trial.code for trial in longer.trials[-2:]} == {longer.best.code if longer.best else None}


def believing(**options: Any) -> Bayes:
    return made_up_bayes(MODEL.samples(48), **options)


def test_a_search_that_is_sure_ends_confirmed(store: SessionStore) -> None:
    session, ended = run(store, BAYES_SPEC, MadeUpWorld(KIND), believing())
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
    session, ended = run(store, spec, MadeUpWorld(KIND), believing(noise_m=REAL_NOISE_M))
    assert ended == "confirmed"
    first = next(trial.index for trial in session.trials if trial.score <= 0.025)
    assert first < len(session.trials)
    assert session.trials[-1].code in [trial.code for trial in session.trials[:-1]]


def test_an_early_stop_is_an_invalid_trial_that_took_less_time(store: SessionStore) -> None:
    spec = replace(BAYES_SPEC, early_stop=True, budget=60)
    world: FloatArray = KIND.copy()  # but the gait that is tried first goes astray
    world[believing().ask()[0] - 1, : FINAL + 1] = 2.5 * (np.arange(1, 11) / 10) ** 1.5
    session, ended = run(store, spec, MadeUpWorld(world), believing())
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
    session, ended = run(store, spec, MadeUpWorld(KIND), believing(noise_m=REAL_NOISE_M))
    assert ended == "confirmed"
    assert [trial.confirms for trial in session.trials[-3:]] == [False, True, True]
    assert session.settled_on is not None
    assert {trial.code for trial in session.trials[-2:]} == {session.settled_on["code"]}
    unrepeated = replace(spec, budget=28, confirm=0)
    bare, _ = run(store, unrepeated, MadeUpWorld(KIND), believing(noise_m=REAL_NOISE_M))
    assert bare.settled_on is not None
    assert session.settled_on["chance"] > bare.settled_on["chance"]


def test_a_recording_that_is_not_whole_costs_no_trial_and_is_reported(store: SessionStore) -> None:
    session, walk = store.create(SPEC), Landscape()

    def no_room(request: TrialRequest) -> WalkedTrial:
        walked = walk(request)
        return replace(walked, recording_error=OSError("disk full")) if request.index == 2 else walked

    with pytest.raises(RecordingError, match=r"trial 2 .*disk full"):
        run_on(store, session.name, no_room)
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
    name = store.create(BASELINE_SPEC).name
    for cut, gaits in ((1, ["demo"]), (1, ["demo", "tripod"]), (3, ["demo", "tripod"])):
        session, ended = run_on(store, name, cut_off(Landscape(), cut))
        assert ended == "interrupted"
        assert [one.gait for one in session.baseline] == gaits
    assert len(session.trials) == 3
    session, ended = run_on(store, name)
    assert ended == "budget"
    assert [trial.code for trial in session.trials] == [trial.code for trial in run(store, SPEC)[0].trials]


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


CONFIRMED_SPEC = SessionSpec(
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


def confirmed(store: SessionStore, finely: WalkTrial, *, name: str | None = None, **spec: float) -> Session:
    """A session, new or continued, of trials with the ends `ENDS`, confirmed by walks with other ends."""
    asked = replace(CONFIRMED_SPEC, **spec)  # type: ignore[arg-type]
    session = load_session(store.create(asked).name if name is None else name, store.folder)
    AdaptLoop(session, store, optimizer_of(asked), Ends(ENDS), walk_finely=finely).run()
    return session


#: A target that is never reached: all five are walked.
NEVER_M = 1e-6


def test_a_target_that_single_trials_cannot_resolve_is_confirmed(store: SessionStore) -> None:
    near = confirmed(store, Ends({1: 0.3, 2: 0.01, 3: 0.0, 4: 0.0, 5: 0.0}), target_m=NEVER_M)
    near.spec = replace(near.spec, target_m=0.025)
    assert near.within_target == pytest.approx(0.9696, abs=1e-3)  # 1.9 and 4.4 standard deviations
    far = confirmed(store, Ends({0: 0.5, 1: 0.3, 2: 0.05, 3: 0.06, 4: 0.07}), target_m=NEVER_M)
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
    session = confirmed(store, finely, target_m=NEVER_M)
    assert finely.walked == walked
    assert session.best_walk is not None
    assert session.best_walk.code == best


def test_an_interrupted_confirmation_loses_nothing(store: SessionStore) -> None:
    cut = confirmed(store, cut_off(Ends({}), 0), target_m=NEVER_M)
    assert (cut.ended, len(cut.trials), cut.confirmations) == (None, 5, [])
    finely = Ends({2: 0.01})
    whole = confirmed(store, finely, name=cut.name)
    assert (whole.ended, whole.trials, finely.walked) == ("budget", cut.trials, [2])
    again = Ends({})
    assert confirmed(store, again, name=cut.name).confirmations == whole.confirmations
    assert again.walked == []


def test_what_cannot_be_known_better_is_not_walked_again(store: SessionStore) -> None:
    finely = Ends({})
    session = confirmed(store, finely, target_m=NEVER_M, confirmed_uncertainty_m=0.0)
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
