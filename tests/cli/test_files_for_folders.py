"""A file where a folder is expected: each command names the file and ends as for any bad input."""

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
