"""Rerun's files: whole, cut off, damaged, and in the hands of Rerun's own tools."""

import os
import shutil
from pathlib import Path

import pytest

from hexctl.errors import InputError, RecordingError
from hexctl.recording.rrd import probe_file
from hexctl.recording.rrd_reader import (
    CHUNK,
    MESSAGE_HEAD,
    check_end,
    read_chunks,
)
from tests.recording.conftest import ReadBack, Trial, messages, write


@pytest.mark.parametrize("missing_bytes", [1, 5000])
def test_a_recording_without_its_end_is_not_whole(
    missing_bytes: int, trial_file: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copy(trial_file, tmp_path / "trial.rrd"))
    check_end(path)
    os.truncate(path, path.stat().st_size - missing_bytes)
    with pytest.raises(RecordingError):
        check_end(path)
    os.truncate(path, 0)
    with pytest.raises(RecordingError):
        check_end(path)


def test_a_recording_that_cannot_be_read_is_not_called_deleted(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="was deleted or moved"):
        check_end(tmp_path / "gone.rrd")
    with pytest.raises(RecordingError, match="cannot be read"):
        check_end(tmp_path)


@pytest.fixture(scope="module")
def trial_file(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("tools") / "trial.rrd", trial)


def test_a_probe_leaves_nothing_behind(tmp_path: Path) -> None:
    probe_file(tmp_path / "new" / "folder" / "walk.rrd")
    assert not list(tmp_path.iterdir())
    (tmp_path / "kept").mkdir()
    probe_file(tmp_path / "kept" / "walk.rrd")
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        probe_file(tmp_path / "file" / "folder" / "walk.rrd")


def test_a_probe_that_is_interrupted_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.posix_fallocate", interrupt)
    with pytest.raises(KeyboardInterrupt):
        probe_file(tmp_path / "folder" / "walk.rrd")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(("number", "share"), [(20, 0.0), (20, 0.5), (20, 1.0), (-1, 0.5)])
def test_what_was_cut_off_is_read_up_to_there(
    number: int, share: float, trial_file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Cut off at the beginning of a chunk's message, in the middle of it, or behind it."""
    cut, content = tmp_path / "cut.rrd", trial_file.read_bytes()
    places = list(messages(content, CHUNK))
    start, stop = places[number]
    cut.write_bytes(content[: start + round(share * (stop - start))])
    assert len(list(read_chunks(cut))) == places.index((start, stop)) + (share == 1.0)
    left_out_bytes = cut.stat().st_size - (stop if share == 1.0 else start - MESSAGE_HEAD.size)
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == (left_out_bytes > 0)
    assert all(str(cut) in text and f" {left_out_bytes} " in text for text in warned)


@pytest.mark.slow
def test_reading_reads_what_rerun_reads(trial_file: Path) -> None:
    entities = {
        str(batch.schema.metadata[b"rerun:entity_path"], "utf-8") for batch in read_chunks(trial_file)
    }
    assert entities >= ReadBack(trial_file).entities
