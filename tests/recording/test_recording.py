"""Recordings as they are written and read: in blocks, on full disks, by killed programs, cut off, damaged."""

import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.backends.clock import PERIOD_S
from hexctl.control.log import TickLog
from hexctl.errors import HexctlError, InputError, RecordingError
from hexctl.ik.legs import foot_positions_body
from hexctl.recording import paths, rrd, rrd_reader
from hexctl.recording import recording as module
from hexctl.recording.recording import Recording
from hexctl.recording.rrd import probe_file
from hexctl.recording.rrd_reader import CHUNK, END, MESSAGE_HEAD, check_end, read_chunks, viewable
from hexctl.recording.viewer import viewer_binary
from tests.recording.conftest import ReadBack, Trial, write
from tests.recording.made_up import HEAD, arrow_stream, recording_of


@pytest.fixture(scope="module")
def written(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recording") / "runs" / "trial.rrd", trial)


@pytest.fixture(scope="module")
def read(written: Path) -> ReadBack:
    return ReadBack(written)


def test_the_drawn_feet_are_where_the_kinematics_put_them(read: ReadBack, trial: Trial) -> None:
    row = len(trial.log) // 4 * 2  # they are drawn at every second tick
    expected = foot_positions_body(trial.robot, trial.log["measured_rad"][row])
    for leg in range(1, 7):
        path = f"/{paths.foot_path(leg)}"
        point = np.array(read.values(path, "Points3D:positions")[0][0])
        while (path := path.rpartition("/")[0]) != "/world/robot":
            point = _placed(read, path, row, point)
        np.testing.assert_allclose(point, expected[leg - 1], atol=4e-4)  # drawn angles are rounded


def _placed(read: ReadBack, path: str, row: int, point: np.ndarray) -> np.ndarray:
    """A point of an entity in its parent; what is static has one row."""
    starts, turns = (
        read.values(path, f"Transform3D:{part}") for part in ("translation", "rotation_axis_angle")
    )
    if turns:  # an angle is sent when it changes
        times_s = read.times_s(path, "Transform3D:rotation_axis_angle")
        turn = turns[np.searchsorted(times_s, row * PERIOD_S + 1e-6) - 1][0]
        point = Rotation.from_rotvec(turn["angle"] * np.array(turn["axis"])).apply(point)
    placed: np.ndarray = point + (np.array(starts[0][0]) if starts else 0.0)
    return placed


def test_rerun_finds_nothing_wrong_and_adds_the_index_of_a_long_walk(
    written: Path, trial: Trial, tmp_path: Path
) -> None:
    path, indexed = tmp_path / "long.rrd", tmp_path / "indexed.rrd"
    write(path, replace(trial, plan=replace(trial.plan, duration_s=150.0)))
    assert END not in path.read_bytes()
    spoiled = bytearray(written.read_bytes())
    zeros(spoiled, len(spoiled) // 2, 16)
    (damaged := tmp_path / "damaged.rrd").write_bytes(spoiled)
    intact = viewable(damaged, tmp_path / "spare")  # without an index, which Rerun names and makes
    for *words, refusal in (
        ("optimize", path, "-o", indexed, ""),
        ("verify", indexed, ""),
        ("verify", written, ""),
        ("verify", intact, f'"{intact}": Missing RRD footer / no RRD manifests'),
    ):
        command = [str(viewer_binary()), "rrd", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == bool(refusal), done.stderr
        assert refusal in done.stderr


def test_a_killed_program_loses_four_seconds_at_most(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times_s = trial.log["time_s"] - trial.log["time_s"][0]
    now_s = [0.0]
    monkeypatch.setattr(module, "time", SimpleNamespace(time=time.time, monotonic=lambda: now_s[0]))
    with Recording(tmp_path / "killed.rrd", trial.robot, trial.plan, title="killed") as recording:
        unsent_s = []
        for stop in range(1, len(times_s) + 1):
            now_s[0] = float(times_s[stop - 1])
            recording.write_block(trial.log, stop - 1, stop)
            sent = 0 if recording._last is None else recording._last.stop
            unsent_s.append(now_s[0] - float(times_s[min(sent, stop - 1)]))
    assert times_s[-1] > 4.0
    assert max(unsent_s) < 4.0


@pytest.mark.slow
def test_blocks_give_the_same_recording(
    read: ReadBack, trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BLOCK_TICKS", 1)
    blocks = ReadBack(write(tmp_path / "blocks.rrd", trial, block_ticks=37))
    assert blocks.temporal() == read.temporal()
    assert blocks.entities == read.entities


@pytest.mark.slow
def test_where_the_position_is_lost_for_a_while_nothing_is_drawn(trial: Trial, tmp_path: Path) -> None:
    lost = slice(100, 110)
    position = trial.log["base_position_world"].copy()
    position[lost] = np.nan
    changed = trial.with_columns(base_position_world=position)
    whole, parts = (
        ReadBack(write(tmp_path / f"{block_ticks}.rrd", changed, block_ticks)) for block_ticks in (None, 7)
    )
    assert whole.temporal() == parts.temporal()
    ticks = np.round(whole.times_s("/world/robot", "Transform3D:translation") * 50).astype(int)
    np.testing.assert_array_equal(ticks, np.delete(np.arange(len(trial.log)), lost))
    for entity, component in (
        ("/world/trail", "LineStrips3D:strips"),
        ("/world/ribbon", "Mesh3D:vertex_positions"),
    ):
        assert np.isfinite(
            np.concatenate([np.ravel(value) for value in whole.values(entity, component)])
        ).all()


def test_a_place_that_is_taken_is_refused_and_kept(trial: Trial, tmp_path: Path) -> None:
    path = tmp_path / "trial.rrd"
    path.write_bytes(b"precious")
    for wrong in (path, path / "below.rrd"):
        with pytest.raises(InputError):
            Recording(wrong, trial.robot, trial.plan, title="again")
    assert path.read_bytes() == b"precious"


def test_a_recording_without_a_tick_leaves_no_file(trial: Trial, tmp_path: Path) -> None:
    with Recording(tmp_path / "trial.rrd", trial.robot, trial.plan, title="nothing") as recording:
        assert recording.path.exists()
    assert not list(tmp_path.iterdir())


def test_an_interrupt_during_the_beginning_leaves_no_file(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "send_scene", interrupt)
    with pytest.raises(KeyboardInterrupt):
        Recording(tmp_path / "trial.rrd", trial.robot, trial.plan, title="interrupted")
    assert not list(tmp_path.iterdir())


def test_a_recording_that_is_deleted_meanwhile_is_reported_at_the_end(trial: Trial, tmp_path: Path) -> None:
    path = tmp_path / "runs" / "trial.rrd"
    with Recording(path, trial.robot, trial.plan, title="deleted") as recording:
        recording.write_block(trial.log, 0, 10)
        shutil.rmtree(path.parent)
        with pytest.raises(RecordingError):
            recording.finish(trial.result, {})
    assert not path.exists()


WRITES_ON = """
import pickle, sys, time
from pathlib import Path
from hexctl.recording import recording as module
from hexctl.recording import rrd_reader
module.BLOCK_TICKS = 1
trial = pickle.load(sys.stdin.buffer)
recording = module.Recording(Path(sys.argv[1]), trial["robot"], trial["plan"], title="interrupted")
recording.write_block(trial["log"], 0, 200)
while recording._parts is not None:  # each tick writes a part
    recording.write_block(trial["log"], 0, 200)
time.sleep(1.0)
print("written", flush=True)
time.sleep(60)
"""


@pytest.mark.slow
def test_a_killed_process_leaves_a_readable_recording(trial: Trial, tmp_path: Path) -> None:
    path, log = tmp_path / "killed.rrd", TickLog()
    log._rows, log.frame = trial.log._rows, trial.log.frame
    child = subprocess.Popen(
        [sys.executable, "-c", WRITES_ON, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(pickle.dumps({"robot": trial.robot, "plan": trial.plan, "log": log}))
    child.stdin.close()
    try:
        assert child.stdout.readline() == b"written\n"
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait(10)
        child.stdout.close()
    read = ReadBack(path)
    assert len(read.values("/observation/state", "Scalars:scalars")) == 200
    assert len(read.blueprints) == 1


def test_without_rerun_the_extra_is_named(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(HexctlError, match=r"\.\[view\]"):
        Recording(tmp_path / "trial.rrd", trial.robot, trial.plan, title="none")
    assert not (tmp_path / "trial.rrd").exists()


class NeverBack:
    """A stream whose writer has died: its calls come back only when the test lets them."""

    def __init__(self) -> None:
        self.released = Event()

    def flush(self, timeout_sec: float) -> None:
        self.released.wait(60)

    def disconnect(self) -> None:
        self.released.wait(60)


def test_a_flush_that_never_comes_back_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rrd, "FLUSH_TIMEOUT_S", 0.05)
    monkeypatch.setattr(rrd, "FULL_TIMEOUT_S", 0.05)
    stream = NeverBack()
    with pytest.raises(RecordingError):
        rrd.flush(stream, tmp_path / "walk.rrd")
    rrd.disconnect(stream)
    assert rrd.stuck(), "so that the command does not wait for it at its end"
    stream.released.set()
    for thread in rrd._abandoned:
        thread.join(10)
    assert not rrd.stuck()
    freed: list[None] = []
    bindings = rrd.load_rerun().bindings
    monkeypatch.setattr(bindings, "flush_and_cleanup_orphaned_recordings", lambda: freed.append(None))
    rrd.free_streams()
    assert freed, "streams are freed again once the calls have come back"


@pytest.mark.parametrize("missing_bytes", [1, 5000])
def test_a_recording_without_its_end_is_not_whole(missing_bytes: int, written: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(written, tmp_path / "trial.rrd"))
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

    monkeypatch.setattr("os.ftruncate", interrupt)
    with pytest.raises(KeyboardInterrupt):
        probe_file(tmp_path / "folder" / "walk.rrd")
    assert not list(tmp_path.iterdir())


def zeros(data: bytearray, at: int, count: int) -> None:
    data[at : at + count] = bytes(count)


@pytest.mark.parametrize(
    ("spoil", "lost"),
    [
        (lambda data, at: zeros(data, at, 16), 1),
        (lambda data, at: zeros(data, at, 1), 1),
        (lambda data, at: zeros(data, at + 8, 1), 1),
        (lambda data, at: zeros(data, at + 40, 60), 1),
        (lambda data, at: zeros(data, at - 60, 120), 2),
        (lambda data, at: zeros(data, at + 20, len(data)), 3),
        (lambda data, at: data.__delitem__(slice(at, None)), 3),
        (lambda data, at: data.__delitem__(slice(at + 5, None)), 3),
        (lambda data, at: data.__delitem__(slice(at + 80, None)), 3),
        (lambda data, at: data.__delitem__(slice(at + 5, at + 15)), 1),
        (lambda data, at: data.__setitem__(slice(at + 30, at + 30), b"\2" + bytes(30)), 1),
    ],
    ids=[
        *("head", "kind", "length", "middle", "end and head", "tail", "cut off", "cut off in a head"),
        *("cut off in a chunk", "missing", "inserted"),
    ],
)
def test_damage_costs_the_chunks_that_it_hits(
    spoil: Callable[[bytearray, int], None], lost: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, chunk = tmp_path / "walk.rrd", recording_of(arrow_stream())[len(HEAD) :]
    path.write_bytes(HEAD + 5 * chunk)
    assert viewable(path, tmp_path / "spare") == path
    spoiled = bytearray(path.read_bytes())
    spoil(spoiled, len(HEAD) + 2 * len(chunk))
    spoiled = spoiled[: len(HEAD) + 5 * len(chunk) + 31]
    path.write_bytes(spoiled)
    assert len(list(read_chunks(path))) == 5 - lost
    left_out_bytes = len(spoiled) - len(HEAD) - (5 - lost) * len(chunk)
    assert caplog.text.count(f" {left_out_bytes} of its {len(spoiled)} bytes") == (left_out_bytes > 0)
    intact = HEAD + (5 - lost) * chunk
    copied = viewable(path, tmp_path / "spare").read_bytes()
    assert copied == (intact if left_out_bytes > 5 else spoiled), "the beginning of a head hurts no viewer"


def test_what_begins_like_chunks_is_not_decoded_to_its_end_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers, varint, path = [0], rrd_reader._varint, tmp_path / "hostile.rrd"

    def counted(message: bytes, at: int) -> tuple[int, int]:
        numbers[0] += 1
        return varint(message, at)

    monkeypatch.setattr(rrd_reader, "_varint", counted)
    path.write_bytes(HEAD + 400 * (MESSAGE_HEAD.pack(CHUNK, 1 << 11) + b"\n\0"))
    with pytest.raises(InputError, match="damaged"):
        list(read_chunks(path))
    assert numbers[0] < 5 * path.stat().st_size


@pytest.mark.slow
def test_reading_reads_what_rerun_reads(written: Path) -> None:
    entities = {str(batch.schema.metadata[b"rerun:entity_path"], "utf-8") for batch in read_chunks(written)}
    assert entities >= ReadBack(written).entities
