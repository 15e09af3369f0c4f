"""Trials as tables: of a session, and of all sessions, with pandas and without."""

import builtins
from pathlib import Path
from typing import Any

import pandas
import pytest

import hexctl
from hexctl.adapt.adaptation import adapt
from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.sessions.session_tables import ASKED_COLUMNS, LAST_COLUMNS, USUAL_COLUMNS, flat_rows
from hexctl.adapt.sessions.store import SessionStore, list_sessions
from hexctl.adapt.sessions.walk_records import BaselineRecord
from tests.adapt.sessions.test_store import record
from tests.adapt.walking import SPEC, result_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """Two sessions, of two trials and of one."""
    runs: Path = tmp_path_factory.mktemp("runs")
    for leg, budget in ((5, 2), (2, 1)):
        adapt(
            leg, budget=budget, duration_s=1.0, optimizer="random", folder=runs, record=False, baseline=False
        )
    return runs


def without_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    load = builtins.__import__

    def refuse(name: str, *arguments: Any, **more: Any) -> Any:
        if name == "pandas":
            raise ModuleNotFoundError("no pandas", name="pandas")
        return load(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.slow
def test_every_trial_is_a_row(folder: Path) -> None:
    table = hexctl.sessions(folder)
    assert isinstance(table, pandas.DataFrame)
    assert len(table) == 3
    assert table.groupby("failed_leg").size().to_dict() == {2: 1, 5: 2}
    assert set(table["robot"]) == {"ant"}
    assert str(table["created"].dtype).startswith("datetime64")
    sessions = {session.name: session for session in list_sessions(folder)}
    for row in table.to_dict("records"):
        trial = sessions[row["session"]].trials[row["index"] - 1]
        assert row["slots"] == " ".join(map(str, trial.slots))
        assert row["score"] == trial.score
        assert row["status"] == trial.as_json()["status"]


def test_without_pandas_it_is_a_list(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = hexctl.sessions(folder)
    without_pandas(monkeypatch)
    rows = hexctl.sessions(folder)
    assert isinstance(rows, list)
    assert list(rows[0]) == list(table.columns)
    assert set(USUAL_COLUMNS) <= set(table.columns)
    assert [row["session"] for row in rows] == table["session"].tolist()


def test_without_sessions_it_is_empty(tmp_path: Path) -> None:
    table = hexctl.sessions(tmp_path)
    assert len(table) == 0
    assert len(table[table["status"] == "ok"].sort_values("score")) == 0
    assert not list(tmp_path.iterdir())


def test_exported_rows_are_trials_alone_and_the_baseline_is_the_last_columns(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    store.add(session, record(1), {})
    store.add(session, record(2), {})
    without = flat_rows(session)
    result = result_of(0.0, "no_progress")
    store.add(
        session,
        BaselineRecord(
            gait="tripod",
            code=None,
            slots=(1, 4, 1, 4, 1, 4),
            score=OBJECTIVES["final"](result),
            outcome=result.to_dict(),
            path_m=[],
            recording=None,
        ),
    )
    rows = flat_rows(session)
    assert [row["index"] for row in rows] == [1, 2]
    columns = list(rows[0])
    assert columns == list(without[0])
    asked = list(ASKED_COLUMNS)
    assert columns[-5:] == asked
    assert [rows[0][name] for name in asked] == ["ant", "flat", "locked", 30.0, None]
    assert columns.index("cause") == len(columns) - 13 - len(LAST_COLUMNS) - len(asked)
    assert all(row["baseline_tripod_status"] == "no_progress" for row in rows)
    assert all(row["baseline_tripod_score"] is None for row in rows)
    assert all(row[name] is None for row in without for name in columns if name.startswith("baseline_"))
