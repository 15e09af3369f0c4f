"""`hexctl export`: what is typed, what is told."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adaptation import adapt
from hexctl.cli.main import exit_code
from hexctl.runs.run import run
from tests.recording.conftest import damage


@pytest.fixture(scope="module")
def recording(tmp_path_factory: Any) -> Path:
    path: Path = tmp_path_factory.mktemp("walk") / "walk.rrd"
    run(duration_s=1.0, record=path)
    return path


@pytest.mark.slow
def test_it_prints_where_the_output_lies(
    recording: Path, tmp_path: Path, capsys: Any, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, path in (
        (["ant", "--to", "urdf"], "ant.urdf"),
        (["ant", "--ros2-control", "-o", "a.urdf"], "a.urdf"),
        ([str(recording), "-o", "table.csv"], "table.csv"),
        ([str(recording), "-o", "walk.mcap"], "walk.mcap"),
    ):
        assert exit_code(["export", *arguments]) == 0
        assert capsys.readouterr().out == f"{path}\n"
        assert Path(path).stat().st_size > 1000
    assert "ros2_control" in Path("a.urdf").read_text()


def test_what_is_wrong_is_told_in_one_line_with_flags(
    recording: Path, tmp_path: Path, capsys: Any, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    walk = str(recording)
    for arguments, told in (
        ([walk], "--to: got none; allowed: mcap"),
        ([walk, "--to", "xlsx"], "--to: got xlsx; allowed: urdf"),
        ([walk, "--to", "csv", "--camera", "top"], "--camera: got it for csv; allowed: for gif and mp4"),
        ([walk, "--to", "csv", "--width", "100"], "--width: got it for csv"),
        ([walk, "--to", "gif", "--width", "7"], "--width: got 7; allowed: 64 to 1920 pixels"),
        ([walk, "--to", "gif", "--caption", "a", "--caption", "b"], "--caption: got 2 for 1 recordings"),
        ([walk, "--to", "gif", "--from", "99"], "--from: got 99; allowed: below"),
        (["ant", "--to", "csv"], "export: got the robot ant for csv"),
        ([walk, "--to", "csv", "--robot", "nobody"], "unknown robot 'nobody'"),
    ):
        assert exit_code(["export", *arguments]) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith(f"hexctl: {told}"), captured.err
        assert captured.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_damaged_recording_is_named_and_nothing_is_written(
    recording: Path, tmp_path: Path, capsys: Any, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    damaged = damage(recording)
    for kind in ("csv", "urdf"):
        assert exit_code(["export", str(damaged), "--to", kind, "-o", f"out.{kind}"]) == 2
        told = capsys.readouterr().err
        assert told.startswith(f"hexctl: recording: {damaged} is damaged")
        assert told.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_what_a_session_has_lost_is_named_and_the_rest_is_written(
    tmp_path: Path, capsys: Any, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    session = adapt(robot="ant", failed_leg=5, budget=3, duration_s=1.0, optimizer="random").session
    first, second, third = (Path(str(trial.recording)) for trial in session.trials)
    damage(first).replace(first)
    second.unlink()
    assert exit_code(["export", session.name, "--to", "mcap", "-o", "bags"]) == 3
    captured = capsys.readouterr()
    assert captured.out == "bags\n"
    assert [path.name for path in Path("bags").iterdir()] == [third.stem]
    damaged, missing = captured.err.splitlines()
    assert damaged.startswith(f"hexctl: recording: {first} is damaged")
    assert missing.startswith(f"hexctl: recording: {second} is not there")
    assert exit_code(["export", session.name, "-o", "trials.csv"]) == 0
    assert capsys.readouterr().err == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bags", "runs", "trials.csv"]
