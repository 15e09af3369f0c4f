"""The progress bar of a search, on a terminal and elsewhere."""

import sys
from pathlib import Path

import pytest
from rich.progress import ProgressColumn

from hexctl.adapt.adaptation import adapt
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.search_progress import CONFIRMATION_WALKS, SearchBar
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import load_session
from tests.adapt.walking import Landscape, stored_session


def searched(**options: object) -> None:
    adapt(5, optimizer="random", budget=2, record=False, **options)  # type: ignore[arg-type]


def test_python_shows_progress_on_a_terminal(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    searched()
    assert "walks" in capsys.readouterr().err
    searched(progress=False)
    assert capsys.readouterr().err == ""


def test_elsewhere_nothing_is_printed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    searched()
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "")


def test_the_time_left_is_known_from_the_first_walk_on(tmp_path: Path) -> None:
    bar = SearchBar(hidden=True)
    walked = load_session(stored_session(tmp_path, 0.1, tripod=0.2), tmp_path)
    spec = SessionSpec(failed_leg=5, budget=3, baseline_gaits=["tripod"], confirmed_uncertainty_m=0.01)
    session = Session(name="s", spec=spec, created="2026-01-01")
    bar.begin(session)
    (task,) = bar._progress.tasks
    assert task.total == 1 + 3 + CONFIRMATION_WALKS
    left = bar._progress.columns[-1]
    assert isinstance(left, ProgressColumn)
    assert "0" not in str(left(task)), "nothing is walked yet"
    session.baseline.extend(walked.baseline)
    bar.advance(session)
    assert str(left(task)).startswith("at most ")
