"""What the overview takes from a session, and the beliefs of its search step by step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions import search_steps as module
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.search_steps import search_steps
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.session_viewing import make_overview
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.adapt.setting import load_setting
from hexctl.adapt.space import GaitSpace
from hexctl.adapt.trial_loop import AdaptLoop
from hexctl.control.trial_result import TrialResult
from hexctl.recording.sessions.session_overview import make_table
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, MadeUpWorld
from tests.adapt.walking import SPEC, Landscape, baseline_record, record, result_of


def make_session(*results: TrialResult) -> Session:
    trials = [record(index, result) for index, result in enumerate(results, start=1)]
    return Session(name="20260101-000000-leg5-pso", spec=SPEC, created="2026-01-01", trials=trials)


def test_trials_keep_their_numbers_and_invalid_ones_have_no_score() -> None:
    overview = make_overview(make_session(result_of(-0.3), result_of(0.0, "no_progress"), result_of(0.02)))
    assert [trial.score_m for trial in overview.trials] == [0.3, None, 0.02]
    assert [trial.deviation_m for trial in overview.trials] == [-0.3, 0.0, 0.02]
    assert [trial.status for trial in overview.trials] == ["ok", "no_progress", "ok"]
    assert overview.best is overview.trials[2]
    assert overview.course_m == 4.455


def test_a_trial_that_never_set_out_or_diverged_has_no_impossible_points() -> None:
    lost = replace(
        result_of(0.0, "aborted"),
        distance_m=None,
        deviation=None,
        path_m=np.zeros((0, 2)),
        yaw_change_rad=None,
    )
    wild = replace(result_of(0.0, "diverged"), path_m=np.full((40, 2), np.nan))
    overview = make_overview(make_session(lost, wild))
    assert [len(trial.path_m) for trial in overview.trials] == [0, 1]
    assert overview.best is None


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
        session, store, search, world, on_stored=lambda *_: expected.append(search.forecast().mean_m)
    ).run()
    return load_session(session.name, store.folder), expected


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


def test_beliefs_that_are_not_those_of_the_session_are_not_shown(
    walked: tuple[Session, list[FloatArray]], tmp_path: Path
) -> None:
    session, _ = walked
    second = session.trials[1]
    another = replace(second, code=second.code % 120 + 1)
    spec = replace(session.spec, prior=str(tmp_path / "gone.npz"))
    for changed, why in (
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


def test_the_baseline_is_shown_before_the_trials_and_is_never_the_best() -> None:
    session = make_session(result_of(-0.3))
    session.trials.append(record(2, result_of(-0.3), confirms=True))
    session.baseline.append(baseline_record("tripod", result_of(0.01)))
    overview = make_overview(session)
    assert overview.best is overview.trials[0]
    assert overview.trials[1].status == "ok (repeat)"
    assert "without a search: tripod 1.0 cm" in overview.facts
    rows = [row for row in make_table(overview).splitlines() if row.startswith("| ")]
    assert rows[1].startswith("| 0 | tripod | 1,4,1,4,1,4 | 1.0 cm left |")


def test_beliefs_are_shown_until_a_trial_and_a_session_without_an_end_goes_on(
    walked: tuple[Session, list[FloatArray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_TRIALS", 2)
    steps = search_steps(replace(walked[0], ended=None))
    assert [step.beliefs is not None for step in steps] == [True] * 3 + [False] * (len(steps) - 3)
    assert ["until trial 2" in step.note for step in steps] == [False] * 3 + [True] * (len(steps) - 3)
    assert steps[3].next_code == walked[0].trials[3].code
    assert "goes on" in steps[-1].note


def test_a_search_without_beliefs_expects_nothing(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(replace(SPEC, budget=3))
    AdaptLoop(session, store, make_optimizer("random", GaitSpace((5,)), 0), Landscape()).run()
    session.spec = replace(session.spec, optimizer="random")
    steps = search_steps(session)
    assert [step.beliefs for step in steps] == [None] * 4
    assert [step.next_code for step in steps] == [*(trial.code for trial in session.trials), None]
    assert all("expected" not in step.note for step in steps)
