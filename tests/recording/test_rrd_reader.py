"""Files of Rerun are read with Arrow: damage is an error in one line, never the end of the process."""

import os
import random
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.recording import recording as module
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.recording import Recording
from hexctl.recording.rrd import RERUN
from hexctl.recording.rrd_reader import (
    CHUNK,
    HEAD_BYTES,
    MAGIC,
    MESSAGE_HEAD,
    check_end,
    check_viewable,
    read_chunks,
)
from tests.recording.conftest import ReadBack, Trial, damage, messages, write
from tests.recording.made_up import damaged_recordings

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sound(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("sound") / "walk.rrd", trial)


def test_what_would_end_reruns_reader_is_refused_in_one_line(sound: Path, trial: Trial) -> None:
    damaged = damage(sound)
    for read in (read_trial, check_viewable):
        with pytest.raises(InputError) as refused:
            read(damaged)
        assert str(damaged) in str(refused.value)
        assert RERUN in str(refused.value)
        assert "\n" not in str(refused.value)
    assert len(read_trial(sound)) == len(trial.log)


def test_no_damage_ends_the_process(sound: Path, tmp_path: Path) -> None:
    chance, content = random.Random(0), sound.read_bytes()
    path, refused = tmp_path / "spoiled.rrd", 0
    for _ in range(60):
        spoiled = bytearray(content)
        at = chance.randrange(HEAD_BYTES, len(spoiled))
        spoiled[at : at + chance.choice([1, 1, 8, 512])] = bytes([chance.choice([0, 1, 127, 255])])
        path.write_bytes(spoiled)
        try:
            read_trial(path)
        except InputError:
            refused += 1
    assert refused > 20


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("number", [20, -20, -1])
def test_what_was_cut_off_is_read_up_to_there(
    number: int, share: float, sound: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Cut off at the beginning of a chunk's message, in the middle of it, or behind it."""
    cut, content = tmp_path / "cut.rrd", sound.read_bytes()
    places = list(messages(content, CHUNK))
    start, stop = places[number]
    cut.write_bytes(content[: start + round(share * (stop - start))])
    assert len(list(read_chunks(cut))) == places.index((start, stop)) + (share == 1.0)
    left_out_bytes = cut.stat().st_size - (stop if share == 1.0 else start - MESSAGE_HEAD.size)
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == (left_out_bytes > 0)
    assert all(str(cut) in text and f" {left_out_bytes} " in text for text in warned)


def test_a_damaged_length_leaves_the_rest_out_with_a_warning(
    sound: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content, damaged = bytearray(sound.read_bytes()), tmp_path / "damaged.rrd"
    start, _ = list(messages(bytes(content), CHUNK))[100]
    content[start - 1] = 127
    damaged.write_bytes(content)
    assert len(list(read_chunks(damaged))) == 100
    check_viewable(damaged)
    (warned,) = [record.getMessage() for record in caplog.records]
    assert str(damaged) in warned
    assert f" {len(content) - start + MESSAGE_HEAD.size} " in warned


@pytest.mark.parametrize("indexed_s", [0.0, 120.0])
def test_a_sound_recording_is_read_without_a_warning(
    indexed_s: float,
    trial: Trial,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(module, "INDEXED_S", indexed_s)
    check_viewable(write(tmp_path / "walk.rrd", trial))
    assert not caplog.records


@pytest.mark.parametrize("content", [b"", b"RRF1" + bytes(20), b"no recording", MAGIC, MAGIC + bytes(3)])
def test_what_holds_no_trial_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_trial(path)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    "content", damaged_recordings(), ids=["no-batch", "two-batches", "number", "no-entity"]
)
def test_a_chunk_that_is_none_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    path.write_bytes(content)
    for read in (read_trial, check_viewable):
        with pytest.raises(InputError) as refused:
            read(path)
        assert "damaged" in str(refused.value)
        assert str(path) in str(refused.value)


def test_reading_reads_what_rerun_reads(sound: Path) -> None:
    entities = {str(batch.schema.metadata[b"rerun:entity_path"], "utf-8") for batch in read_chunks(sound)}
    assert entities >= ReadBack(sound).entities


def test_the_version_is_the_one_that_is_installed_with_hexctl() -> None:
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))
    (pin,) = project["project"]["optional-dependencies"]["view"]
    assert f">={RERUN}," in pin


def test_without_arrow_the_extra_is_named(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"hexctl\[view\]"):
        read_trial(sound)


@pytest.mark.parametrize("missing_bytes", [1, 20, 500])
def test_an_incomplete_end_is_noticed(
    missing_bytes: int, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lost.rrd"
    checked: list[Path] = []

    def lose(path: Path, start: int) -> None:
        os.truncate(path, max(start, path.stat().st_size - missing_bytes))
        checked.append(path)
        check_end(path, start)

    monkeypatch.setattr(module, "INDEXED_S", 0.0)
    monkeypatch.setattr(module, "check_end", lose)
    with pytest.raises(RecordingError, match="is the disk full"):
        write(path, trial)
    assert checked == [path]


def test_messages_end_where_the_file_ends(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "INDEXED_S", 0.0)
    path = write(tmp_path / "without-index.rrd", trial)
    check_end(path, HEAD_BYTES)
    for start in (path.stat().st_size, HEAD_BYTES + 1):
        with pytest.raises(RecordingError, match="is the disk full"):
            check_end(path, start)


def test_a_walk_that_was_broken_off_is_read_up_to_there(trial: Trial, tmp_path: Path) -> None:
    path = tmp_path / "broken-off.rrd"
    with Recording(path, trial.robot, trial.plan, title="broken off") as recorded:
        recorded.write_block(trial.log, 0, 100)
    assert len(read_trial(path)) == 100
    assert "status" not in read_trial(path).properties


SHOWN = """
import sys
from pathlib import Path
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.recording.recording import Recording
from hexctl.recording.rrd_reader import read_chunks
from hexctl.robot.loader import load_robot
robot = load_robot("ant")
plan = TrialPlan(gait=make_gait(robot, "tripod"))
path = Path(sys.argv[1])
Recording(path, robot, plan, title="quiet").close()
assert list(read_chunks(path))
"""


@pytest.mark.parametrize("level", [None, "warn"])
def test_a_recording_warns_of_nothing(level: str | None, tmp_path: Path) -> None:
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
