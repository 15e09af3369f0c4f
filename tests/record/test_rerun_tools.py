"""Recordings in the hands of Rerun's own tools, whole and cut off."""

import subprocess
from pathlib import Path

import pytest

from hexctl.record.viewer import viewer_binary
from tests.record.conftest import ReadBack, Trial, write


@pytest.fixture(scope="module")
def written(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("tools") / "trial.rrd", trial)


@pytest.fixture(scope="module")
def cut_off(written: Path) -> Path:
    """Return the recording as a power cut leaves it: it ends in the middle of something."""
    path = written.with_name("cut.rrd")
    content = written.read_bytes()
    path.write_bytes(content[: len(content) * 9 // 10])
    return path


def rrd(tool: str, *arguments: str | Path) -> "subprocess.CompletedProcess[str]":
    command = [str(viewer_binary()), "rrd", tool, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_stats_finds_chunks_and_nothing_to_complain_of(written: Path) -> None:
    done = rrd("stats", written)
    assert done.returncode == 0, done.stderr
    assert "num_chunks" in done.stdout
    assert "error" not in done.stderr.lower()


def test_a_recording_equals_its_copy(written: Path, trial: Trial) -> None:
    again = write(written.with_name("again.rrd"), trial)
    assert rrd("verify", again).returncode == 0
    assert ReadBack(again).temporal() == ReadBack(written).temporal()


def test_what_was_cut_off_in_mid_message_can_be_repaired(cut_off: Path, written: Path) -> None:
    repaired = cut_off.with_name("repaired.rrd")
    done = rrd("optimize", cut_off, "-o", repaired)
    assert done.returncode == 0, done.stderr
    assert rrd("verify", repaired).returncode == 0
    read = ReadBack(repaired)
    assert len(read.blueprints) == 1
    assert read.temporal()
    assert read.entities <= ReadBack(written).entities
