"""Recordings of long walks: without an index while they are written, with one when they are done."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import RecordingError
from hexctl.recording import recording, rerun_program
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.recording import Recording
from hexctl.recording.rerun_program import write_index
from hexctl.recording.rrd import check_messages, check_whole, has_index
from hexctl.runs.run import run
from tests.recording.conftest import ReadBack, Trial, make_plan, write


def write_long(path: Path, trial: Trial, block_ticks: int = 20) -> Recording:
    """Record a finished trial as a long walk, without an index as yet."""
    recorded = Recording(path, trial.robot, trial.plan, title="a trial", floor=trial.floor, long=True)
    for start in range(0, len(trial.log), block_ticks):
        recorded.write_block(trial.log, start, min(start + block_ticks, len(trial.log)))
    recorded.finish(trial.result, {"world": "flat", "seed": 0})
    return recorded


@pytest.fixture(autouse=True)
def pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many small pieces, as a walk in real time writes them."""
    monkeypatch.setattr(recording, "BLOCK_TICKS", 20)


def test_a_long_walk_gets_its_index_when_it_is_done(trial: Trial, tmp_path: Path) -> None:
    path, usual = tmp_path / "long.rrd", write(tmp_path / "usual.rrd", trial, block_ticks=20)
    recorded = write_long(path, trial)
    assert not has_index(path)
    before = read_trial(path)
    recorded.write_index()
    check_whole(path)
    assert sorted(os.listdir(tmp_path)) == ["long.rrd", "usual.rrd"]
    after = read_trial(path)
    assert after == replace(before, path=path)
    read, as_usual = ReadBack(path), ReadBack(usual)
    assert read.temporal() == as_usual.temporal()
    assert read.entities == as_usual.entities
    assert len(read.blueprints) == 1
    assert after.properties == read_trial(usual).properties


def test_the_plan_says_whether_a_walk_is_long(trial: Trial, tmp_path: Path) -> None:
    for name, duration_s, indexed in (
        ("short", recording.LONG_S, True),
        ("long", recording.LONG_S + 1, False),
    ):
        path = tmp_path / f"{name}.rrd"
        plan = make_plan(trial.robot, duration_s=duration_s)
        Recording(path, trial.robot, plan, title=name).close()
        assert has_index(path) is indexed


def test_a_run_writes_the_index_of_a_long_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "LONG_S", 0.5)
    path = tmp_path / "run.rrd"
    done = run(duration_s=1.0, record=path)
    assert done.recording_error is None
    check_whole(path)
    assert len(read_trial(path)) == len(done.log)
    assert read_trial(path).properties["status"] == "ok"


def test_a_drive_or_a_walk_that_was_broken_off_gets_one_too(trial: Trial, tmp_path: Path) -> None:
    path = tmp_path / "broken-off.rrd"
    with Recording(path, trial.robot, trial.plan, title="broken off", long=True) as recorded:
        recorded.write_block(trial.log, 0, 100)
        recorded.write_index()  # too early: nothing is done
    assert not has_index(path)
    recorded.write_index()
    check_whole(path)
    assert len(read_trial(path)) == 100
    assert "status" not in read_trial(path).properties


@pytest.mark.parametrize("missing_bytes", [1, 20, 500])
def test_without_an_index_too_an_incomplete_end_is_noticed(
    missing_bytes: int, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lost.rrd"
    checked: list[Path] = []

    def lose(path: Path, start: int) -> None:
        os.truncate(path, max(start, path.stat().st_size - missing_bytes))
        checked.append(path)
        check_messages(path, start)

    monkeypatch.setattr(recording, "check_messages", lose)
    with pytest.raises(RecordingError, match="is the disk full"):
        write_long(path, trial)
    assert checked == [path]


def test_what_the_disk_has_lost_is_not_made_to_look_whole(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lost.rrd"
    recorded = Recording(path, trial.robot, trial.plan, title="lost", long=True)
    recorded.write_block(trial.log, 0, 100)

    def refuse(_stream: object, path: Path) -> None:
        raise RecordingError(f"{path}: the recording is incomplete")

    with monkeypatch.context() as full:
        full.setattr(recording, "flush", refuse)
        with pytest.raises(RecordingError, match="incomplete"):
            recorded.finish(trial.result, {})
    recorded.close()
    recorded.write_index()
    assert not has_index(path)


def test_messages_end_where_the_file_ends(trial: Trial, tmp_path: Path) -> None:
    path = tmp_path / "messages.rrd"
    write_long(path, trial)
    header_bytes = 12
    check_messages(path, header_bytes)
    for start in (path.stat().st_size, header_bytes + 1):
        with pytest.raises(RecordingError, match="is the disk full"):
            check_messages(path, start)


@pytest.mark.parametrize("binary", ["/bin/false", "/no/such/program"])
def test_where_rerun_fails_the_recording_stays_as_it_was(
    binary: str, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "long.rrd"
    write_long(path, trial)
    content = path.read_bytes()
    monkeypatch.setattr(rerun_program, "viewer_binary", lambda: Path(binary))
    assert not write_index(path)
    assert path.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_a_process_that_hangs_is_ended(trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, hangs = tmp_path / "long.rrd", tmp_path / "hangs"
    write_long(path, trial)
    hangs.write_text("#!/bin/sh\nexec sleep 60\n")
    hangs.chmod(0o755)
    monkeypatch.setattr(rerun_program, "viewer_binary", lambda: hangs)
    monkeypatch.setattr(rerun_program, "time_limit_s", lambda _: 0.1)
    assert not write_index(path)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["hangs", "long.rrd"]


def test_ctrl_c_while_it_is_written_costs_no_result(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "long.rrd"
    write_long(path, trial)
    content = path.read_bytes()

    wait = subprocess.Popen.wait

    def interrupt(process: "subprocess.Popen[bytes]", timeout: float | None = None) -> int:
        if timeout is not None:  # for the end of the process that was killed there is none
            raise KeyboardInterrupt
        return wait(process)

    with monkeypatch.context() as interrupted:
        interrupted.setattr(subprocess.Popen, "wait", interrupt)
        assert not write_index(path)
    assert path.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_no_recording_no_index(tmp_path: Path) -> None:
    assert not write_index(tmp_path / "missing.rrd")
    (tmp_path / "text.rrd").write_text("no recording")
    assert not write_index(tmp_path / "text.rrd")
    assert (tmp_path / "text.rrd").read_text() == "no recording"


def test_an_index_that_is_there_is_left_alone(trial: Trial, tmp_path: Path) -> None:
    path = write(tmp_path / "usual.rrd", trial)
    content = path.read_bytes()
    assert write_index(path)
    assert path.read_bytes() == content


SHOWN = """
import sys
from pathlib import Path
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.recording.recording import Recording
from hexctl.robot.loader import load_robot
robot = load_robot("ant")
plan = TrialPlan(gait=make_gait(robot, "tripod"))
Recording(Path(sys.argv[1]), robot, plan, title="quiet", long=True).close()
"""


@pytest.mark.parametrize("level", [None, "warn"])
def test_a_long_recording_warns_of_nothing(level: str | None, tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "RUST_LOG"}
    if level is not None:
        environment["RUST_LOG"] = level
    done = subprocess.run(
        [sys.executable, "-c", SHOWN, str(tmp_path / "quiet.rrd")],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("", "")
    assert not has_index(tmp_path / "quiet.rrd")


def test_reading_one_without_an_index_is_quiet_too(
    trial: Trial, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    path = tmp_path / "long.rrd"
    write_long(path, trial)
    assert np.isfinite(read_trial(path).commanded_rad).all()
    assert not recwarn.list
