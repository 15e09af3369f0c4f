"""All sessions as one table: with pandas and without."""

import builtins
from pathlib import Path
from typing import Any

import pandas
import pytest

import hexctl
from hexctl.adapt.adaptation import adapt
from hexctl.adapt.sessions.table import USUAL_COLUMNS


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


def test_every_trial_is_a_row(folder: Path) -> None:
    table = hexctl.sessions(folder)
    assert isinstance(table, pandas.DataFrame)
    assert len(table) == 3
    assert table.groupby("failed_leg").size().to_dict() == {2: 1, 5: 2}
    assert set(table["robot"]) == {"ant"}
    assert str(table["created"].dtype).startswith("datetime64")
    sessions = {session.name: session for session in hexctl.list_sessions(folder)}
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
