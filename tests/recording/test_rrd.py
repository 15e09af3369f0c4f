"""Rerun's files: whole, cut off, and in the hands of Rerun's own tools."""

import errno
import os
import subprocess
from pathlib import Path

import pytest

from hexctl.cli.console import in_flags
from hexctl.errors import InputError, RecordingError
from hexctl.recording import recording
from hexctl.recording.rrd import END_PADDING, check_whole, disconnect, probe_file
from hexctl.recording.viewer import viewer_binary
from tests.recording.conftest import ReadBack, Trial, write


@pytest.mark.parametrize("missing_bytes", [1, 20, 5000])
def test_a_recording_without_its_end_is_not_whole(missing_bytes: int, trial: Trial, tmp_path: Path) -> None:
    path = write(tmp_path / "trial.rrd", trial)
    check_whole(path)
    os.truncate(path, path.stat().st_size - missing_bytes - END_PADDING)
    with pytest.raises(RecordingError, match="is the disk full"):
        check_whole(path)
    os.truncate(path, 0)
    with pytest.raises(RecordingError, match="is the disk full"):
        check_whole(path)


@pytest.mark.parametrize("missing_bytes", [1, 20, 5000])
def test_a_walk_whose_index_was_lost_is_not_finished(
    missing_bytes: int, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose(stream: object) -> None:
        disconnect(stream)
        os.truncate(path, path.stat().st_size - missing_bytes - END_PADDING)

    path = tmp_path / "lost.rrd"
    monkeypatch.setattr(recording, "disconnect", lose)
    with pytest.raises(RecordingError, match="is the disk full"):
        write(path, trial)


@pytest.fixture(scope="module")
def trial_file(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("tools") / "trial.rrd", trial)


@pytest.fixture(scope="module")
def cut_off(trial_file: Path) -> Path:
    """The recording as a power cut leaves it: it ends in the middle of something."""
    path = trial_file.with_name("cut.rrd")
    content = trial_file.read_bytes()
    path.write_bytes(content[: len(content) * 9 // 10])
    return path


def rrd(tool: str, *arguments: str | Path) -> "subprocess.CompletedProcess[str]":
    command = [str(viewer_binary()), "rrd", tool, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_stats_finds_chunks_and_nothing_to_complain_of(trial_file: Path) -> None:
    done = rrd("stats", trial_file)
    assert done.returncode == 0, done.stderr
    assert "num_chunks" in done.stdout
    assert "error" not in done.stderr.lower()


def test_a_recording_equals_its_copy(trial_file: Path, trial: Trial) -> None:
    again = write(trial_file.with_name("again.rrd"), trial)
    assert ReadBack(again).temporal() == ReadBack(trial_file).temporal()


def test_what_was_cut_off_in_mid_message_can_be_repaired(cut_off: Path, trial_file: Path) -> None:
    repaired = cut_off.with_name("repaired.rrd")
    done = rrd("optimize", cut_off, "-o", repaired)
    assert done.returncode == 0, done.stderr
    assert rrd("verify", repaired).returncode == 0
    read = ReadBack(repaired)
    assert len(read.blueprints) == 1
    assert read.temporal()
    assert read.entities <= ReadBack(trial_file).entities


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_says_what_helps(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("hexctl.recording.rrd.os.posix_fallocate", refuse)
    with pytest.raises(InputError) as refused:
        probe_file(tmp_path / "walk.rrd")
    assert in_flags(refused.value).endswith(
        ": the disk is full; free some space, record elsewhere (--record), or not at all (--no-record)"
    )
    assert not list(tmp_path.iterdir())


def test_a_probe_leaves_nothing_behind(tmp_path: Path) -> None:
    probe_file(tmp_path / "new" / "folder" / "walk.rrd")
    assert not list(tmp_path.iterdir())
    (tmp_path / "kept").mkdir()
    probe_file(tmp_path / "kept" / "walk.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        probe_file(tmp_path / "file" / "folder" / "walk.rrd")
