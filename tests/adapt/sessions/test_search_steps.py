"""The steps of a session's search: beliefs that are those of the search, and nothing where they are not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS, TRIM
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions import search_steps as module
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.search_steps import search_steps
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.setting import load_setting
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.trial_loop import AdaptLoop
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, MadeUpWorld
from tests.adapt.walking import SPEC, Landscape

TRIALS, REPEATS = 5, 1


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, list[FloatArray]]:
    """A session with a shipped prior in a made-up world, and what the search itself expected on its way."""
    folder = tmp_path_factory.mktemp("runs")
    spec = new_spec(failed_leg=5, budget=TRIALS, confirm=REPEATS, worth_m=0.0, baseline=False, folder=folder)
    setting = load_setting(spec)
    search = make_search(spec, setting.robot, setting.plan, setting.prior)
    assert isinstance(search, Bayes)
    expected = [search.forecast().mean_m]
    store = SessionStore(folder)
    session = store.create(spec)
    world = MadeUpWorld(MadeUpModel().worlds(1, 7)[0])
    AdaptLoop(
        session, store, search, world, on_trial=lambda *_: expected.append(search.forecast().mean_m)
    ).run()
    return load_session(session.name, store.folder), expected


def test_beliefs_are_those_of_the_search_after_each_trial(walked: tuple[Session, list[FloatArray]]) -> None:
    session, expected = walked
    steps = search_steps(session)
    assert [step.trials for step in steps] == list(range(len(session.trials) + 1))
    for step, mean_m in zip(steps, expected, strict=True):
        assert step.beliefs is not None
        np.testing.assert_array_equal(step.beliefs.signed_m, mean_m)
    assert len({step.beliefs.signed_m.tobytes() for step in steps if step.beliefs is not None}) == len(steps)


def test_the_next_gait_has_the_interval_that_was_stored_with_it(
    walked: tuple[Session, list[FloatArray]],
) -> None:
    session, _ = walked
    for step, trial in zip(search_steps(session), session.trials, strict=False):
        assert step.next_code == trial.code
        assert step.beliefs is not None
        assert trial.expected is not None
        row = trial.code - 1
        # The simulation's own uncertainty is in the chance to reach the target, and so in the interval.
        reach_m = np.hypot(
            trial.expected["high_m"] - trial.expected["signed_m"], 1.645 * session.spec.uncertainty_m
        )
        assert session.spec.uncertainty_m > 0
        assert step.beliefs.signed_m[row] == pytest.approx(trial.expected["signed_m"], abs=1e-9)
        assert step.beliefs.high_m[row] - step.beliefs.signed_m[row] == pytest.approx(reach_m, rel=1e-3)
        assert step.beliefs.signed_m[row] - step.beliefs.low_m[row] == pytest.approx(reach_m, rel=1e-3)


def test_notes_say_why_a_gait_was_chosen_and_why_the_search_ended(
    walked: tuple[Session, list[FloatArray]],
) -> None:
    session, _ = walked
    notes = [step.note for step in search_steps(session)]
    assert "Before the first trial" in notes[0]
    first = session.trials[0]
    assert f"**next: gait {first.code}**, the greatest expected gain of this trial and the next" in notes[0]
    assert f"trial 1, gait {first.code}: ok" in notes[1]
    assert "the greatest expected gain of one trial" in notes[2]
    assert "a repeat of the best gait after the search" in notes[len(session.trials) - REPEATS]
    assert f"the search ended: {session.ended}" in notes[-1]
    assert all("| gait | expected | 90 % interval | within 2.5 cm |" in note for note in notes)


def test_beliefs_that_are_not_those_of_the_session_are_not_shown(
    walked: tuple[Session, list[FloatArray]], tmp_path: Path
) -> None:
    session, _ = walked
    second = session.trials[1]
    assert second.expected is not None
    other = replace(second, expected=second.expected | {"signed_m": second.expected["signed_m"] + 0.01})
    unknown = replace(second, expected=None)
    another = replace(second, code=second.code % 120 + 1)
    spec = replace(session.spec, prior=str(tmp_path / "gone.npz"))
    for changed, why in (
        (replace(session, trials=[session.trials[0], other, *session.trials[2:]]), "another version"),
        (replace(session, trials=[session.trials[0], unknown, *session.trials[2:]]), "another version"),
        (replace(session, trials=[session.trials[0], another, *session.trials[2:]]), "other trials"),
        (replace(session, spec=spec), "gone.npz"),
        (replace(session, spec=replace(session.spec, prior_digest="0" * 64)), "is not the one"),
        (replace(session, spec=replace(session.spec, robot_fingerprint="")), "robot"),
        (replace(session, optimizer_state={"search": {}}), "cannot be shown"),
    ):
        steps = search_steps(changed)
        assert len(steps) == len(session.trials) + 1
        assert all(step.beliefs is None for step in steps)
        assert all(
            "what was expected of the gaits cannot be shown" in step.note and why in step.note
            for step in steps
        )
        assert all("greatest expected gain" not in step.note for step in steps)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        *((name, f"{name} expects nothing of gaits that it has not walked") for name in (*OPTIMIZERS, TRIM)),
        ("no.such.module:Search", "what no.such.module:Search expects of the gaits is not known here"),
    ],
)
def test_searches_without_beliefs_say_less(name: str, said: str, tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(replace(SPEC, budget=3))
    search = make_optimizer("random", GaitSpace((5,)), 0)
    AdaptLoop(session, store, search, Landscape()).run()
    session.spec = replace(session.spec, optimizer=name)
    steps = search_steps(session)
    assert [step.beliefs for step in steps] == [None] * 4
    assert [step.next_code for step in steps] == [*(trial.code for trial in session.trials), None]
    assert all(said in step.note for step in steps)
    assert all("9 of 10" not in step.note for step in steps)


def test_after_many_trials_no_more_beliefs_are_computed(
    walked: tuple[Session, list[FloatArray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    session, _ = walked
    monkeypatch.setattr(module, "MOST_TRIALS", 2)
    steps = search_steps(session)
    assert [step.beliefs is not None for step in steps] == [True] * 3 + [False] * (len(steps) - 3)
    assert "is shown until trial 2" not in steps[2].note
    assert all("is shown until trial 2" in step.note for step in steps[3:])
    assert steps[3].next_code == session.trials[3].code


def test_a_session_that_is_not_at_its_end_goes_on(walked: tuple[Session, list[FloatArray]]) -> None:
    session = replace(walked[0], ended=None)
    assert "the session goes on" in search_steps(session)[-1].note


def test_steered_walks_have_scores_and_no_ends_to_show(walked: tuple[Session, list[FloatArray]]) -> None:
    steered = replace(walked[0].spec, hold="line", objective="speed")
    steps = search_steps(replace(walked[0], spec=steered))
    assert all(step.beliefs is None for step in steps)
    assert "expects scores and not ends of walks" in steps[0].note
