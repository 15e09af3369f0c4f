"""What the overview takes from a session."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_viewing import make_overview, write_overview
from hexctl.adapt.sessions.walk_records import BaselineRecord, TrialRecord
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.recording.sessions.session_overview import make_table
from tests.adapt.walking import SPEC, result_of


def record(index: int, result: TrialResult, *, confirms: bool = False) -> TrialRecord:
    return TrialRecord(
        index=index,
        code=index,
        slots=(1, 2, 3, 4, 5, 6),
        score=OBJECTIVES["final"](result),
        outcome=result.to_dict(),
        path_m=np.round(result.path_m[::10], 4).tolist(),
        recording=None,
        confirms=confirms,
    )


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


def test_a_trajectory_ends_where_the_trial_is_scored() -> None:
    (trial,) = make_overview(make_session(result_of(-0.3))).trials
    assert trial.path_m[0].tolist() == [0.0, 0.0]
    assert trial.end_m.tolist() == [4.0, -0.3]
    assert len(trial.path_m) == 11


def test_the_facts_say_what_was_asked_and_what_came_of_it() -> None:
    facts = " / ".join(make_overview(make_session(result_of(0.3), result_of(0.02))).facts)
    assert "leg 5 locked" in facts
    assert "pso, seed 3: 2 of 12 trials" in facts
    assert "best: trial 2, code 2, score 2.0 cm" in facts
    assert "within 10 cm after 2 trials" in facts
    assert "within 2.5 cm after 2 trials" in facts


def test_the_facts_have_the_simulations_own_uncertainty_once() -> None:
    session = make_session(result_of(0.3), result_of(0.02))
    session.spec = replace(session.spec, uncertainty_m=0.027)
    facts = make_overview(session).facts
    assert sum("± 2.7 cm" in fact for fact in facts) == 1


def test_a_repeat_says_so() -> None:
    session = make_session(result_of(0.3))
    session.trials.append(record(2, result_of(0.3), confirms=True))
    assert make_overview(session).trials[1].status == "ok (repeat)"


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


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_every_objective_has_a_name(objective: str) -> None:
    session = replace(make_session(result_of(0.3)), spec=replace(SPEC, objective=objective))
    assert make_overview(session).objective


def test_it_is_written_beside_the_trials_and_replaced_after_more(tmp_path: Path) -> None:
    session = make_session(result_of(0.3))
    path = write_overview(session, tmp_path / "session")
    assert path == tmp_path / "session" / "overview.rrd"
    session.trials.append(record(2, result_of(0.2)))
    assert write_overview(session, tmp_path / "session") == path
    entities = {chunk.entity_path for chunk in rr.chunk.RrdReader(path).stream().to_chunks()}
    assert {"/above/trials/001", "/above/trials/002", "/table"} <= entities


def test_a_session_without_trials_has_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no trials"):
        write_overview(make_session(), tmp_path)


def test_the_baseline_is_shown_before_the_trials_and_is_never_the_best() -> None:
    session = make_session(result_of(-0.3))
    result = result_of(0.01)
    session.baseline.append(
        BaselineRecord(
            gait="tripod",
            code=None,
            slots=(1, 4, 1, 4, 1, 4),
            score=0.01,
            outcome=result.to_dict(),
            path_m=np.round(result.path_m[::10], 4).tolist(),
            recording=None,
        )
    )
    overview = make_overview(session)
    assert overview.best is overview.trials[0]
    assert "without a search: tripod 1.0 cm" in overview.facts
    rows = [row for row in make_table(overview).splitlines() if row.startswith("| ")]
    assert rows[1].startswith("| 0 | tripod | 1,4,1,4,1,4 | 1.0 cm left |")
