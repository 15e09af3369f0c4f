"""A file where a folder is expected: each command names the file and ends as for any bad input."""

import os
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code


@pytest.fixture(autouse=True)
def _in_a_folder_with_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()


@pytest.mark.parametrize(
    "command",
    [
        "run --duration 1 --record taken/walk.rrd",
        "run --duration 1 --record taken/below/walk.rrd",
        "export ant -o taken/ant.urdf",
        "export ant -o taken/below/ant.urdf",
    ],
)
def test_a_file_above_what_is_to_be_written_is_named(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(command.split()) == 2
    assert "taken is a file, not a folder" in capsys.readouterr().err
    assert Path("taken").read_bytes() == b""


@pytest.mark.parametrize(
    "command",
    [
        *("view", "view x", "export x --to csv", "adapt --resume x", "sessions list", "sessions show x"),
        *("sessions delete x --yes", "sessions export x x.csv"),
    ],
)
def test_a_file_in_place_of_the_runs_is_named(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEXCTL_RUNS", "taken")
    assert exit_code(command.split()) == 2
    printed = capsys.readouterr()
    assert (printed.out, "taken is a file, not a folder" in printed.err) == ("", True)


@pytest.mark.parametrize("there", [True, False], ids=["the runs are read-only", "their folder is"])
@pytest.mark.parametrize(
    ("command", "next_step"),
    [
        ("adapt --failed-leg 5 --duration 3 --prior none", "HEXCTL_RUNS"),
        ("demo", "HEXCTL_RUNS"),
        ("run --duration 1", "--no-record"),
    ],
)
def test_a_folder_that_may_not_be_written_to_comes_with_a_next_step(
    command: str,
    next_step: str,
    there: bool,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if there:
        Path("runs").mkdir()
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK | os.X_OK and may(path, mode))
    assert exit_code(command.split()) == 2
    printed = capsys.readouterr()
    assert (printed.out, next_step in printed.err, "runs/" in printed.err) == ("", True, True)
