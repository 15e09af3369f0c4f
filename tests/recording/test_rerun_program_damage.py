"""Recordings at which Rerun ends the process that reads them are refused; all others are read as before."""

import errno
import os
import subprocess
from pathlib import Path
from typing import Any, NoReturn

import pytest

from hexctl.errors import InputError
from hexctl.recording import rerun_program
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.rerun_program import check_sound, look_at
from tests.recording.conftest import STREAM_HEAD_BYTES, Trial, damage, write

MODULE = rerun_program.__name__

TOLD = "is damaged, and Rerun cannot read it"


@pytest.fixture(scope="module")
def sound(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("sound") / "walk.rrd", trial)


@pytest.fixture(scope="module")
def damaged(sound: Path) -> Path:
    return damage(sound)


def test_what_would_end_the_program_is_refused_and_its_neighbours_are_read(
    sound: Path, damaged: Path, trial: Trial
) -> None:
    assert len(read_trial(sound)) == len(trial.log)
    with pytest.raises(InputError, match=TOLD) as refused:
        read_trial(damaged)
    assert str(damaged) in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(read_trial(sound)) == len(trial.log)


def test_the_reader_decides_where_the_program_that_looks_first_cannot(
    sound: Path, damaged: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    refuses = tmp_path / "rerun"
    refuses.write_text("#!/bin/sh\nexit 1\n")
    refuses.chmod(0o755)
    for binary in (refuses, tmp_path / "missing"):
        monkeypatch.setattr("hexctl.recording.rerun_program.viewer_binary", lambda binary=binary: binary)
        rerun_program._ends_reader.clear()
        check_sound(sound)
        with pytest.raises(InputError, match=TOLD):
            check_sound(damaged)


def test_what_does_not_end_in_time_is_damaged(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.recording.rerun_program.time_limit_s", lambda _: 0.0)
    rerun_program._ends_reader.clear()
    with pytest.raises(InputError, match=TOLD):
        check_sound(sound)
    rerun_program._ends_reader.clear()


def test_a_file_is_looked_at_again_only_when_it_has_changed(
    sound: Path, damaged: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    path = tmp_path / "walk.rrd"
    path.write_bytes(sound.read_bytes())
    check_sound(path)
    with monkeypatch.context() as without:
        without.setattr(subprocess, "Popen", None)
        check_sound(path)
    path.write_bytes(damaged.read_bytes())
    with pytest.raises(InputError, match=TOLD):
        check_sound(path)


def a_new_process() -> None:
    """Forget what this process knows."""
    rerun_program._ends_reader.clear()


def test_a_content_that_was_found_sound_is_not_looked_at_again_by_other_processes(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a_new_process()
    check_sound(sound)
    a_new_process()
    other = tmp_path / "copy.rrd"
    other.write_bytes(sound.read_bytes())
    with monkeypatch.context() as without:
        without.setattr(subprocess, "Popen", None)
        check_sound(sound)
        check_sound(other)
        a_new_process()
        without.setattr(rerun_program, "CHECK", "another check")
        with pytest.raises(TypeError):
            check_sound(sound)


def test_what_could_not_be_looked_at_is_looked_at_by_the_next_process(
    sound: Path, damaged: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(*_: object, **__: object) -> NoReturn:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    for patched in (
        {"subprocess.Popen": fails},
        {f"{MODULE}.viewer_binary": lambda: tmp_path, f"{MODULE}.READ": "raise SystemExit(1)"},
    ):
        a_new_process()
        with monkeypatch.context() as without:
            for name, value in patched.items():
                without.setattr(name, value)
            look_at([sound, damaged])
            check_sound(damaged)
        a_new_process()
        check_sound(sound)
        with pytest.raises(InputError, match=TOLD):
            check_sound(damaged)


def test_a_file_that_is_spoiled_without_a_trace_is_found_out(
    sound: Path, damaged: Path, tmp_path: Path
) -> None:
    path = tmp_path / "walk.rrd"
    path.write_bytes(sound.read_bytes())
    a_new_process()
    check_sound(path)
    before = path.stat()
    with path.open("r+b") as file:
        file.write(damaged.read_bytes())
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    after = path.stat()
    same = ("st_size", "st_mtime_ns", "st_ino")
    assert [getattr(after, name) for name in same] == [getattr(before, name) for name in same]
    for _ in range(2):
        a_new_process()
        with pytest.raises(InputError, match=TOLD):
            check_sound(path)


def test_what_is_known_is_bounded_and_its_file_may_be_anything(
    sound: Path, damaged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun_program, "MOST_KNOWN", 4)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    known = tmp_path / "hexctl" / "sound-recordings"
    known.parent.mkdir()
    lines = [f"{number}" * 64 for number in range(4)]
    known.write_text("\n".join(lines))
    a_new_process()
    check_sound(sound)
    assert known.read_text().split()[:2] == lines[2:]
    assert len(known.read_text().split()) == 3
    known.write_bytes(bytes(range(256)) * 9)
    a_new_process()
    check_sound(sound)
    known.unlink()
    known.mkdir()
    a_new_process()
    check_sound(sound)
    with pytest.raises(InputError, match=TOLD):
        check_sound(damaged)


def test_many_are_looked_at_together_and_each_only_once(
    sound: Path, damaged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / f"{number}.rrd" for number in range(8)]
    for path in paths:
        path.write_bytes((damaged if path.stem == "5" else sound).read_bytes())
    commands: list[list[str]] = []
    start = subprocess.Popen

    def noted(command: list[str], **options: Any) -> Any:
        commands.append(command)
        return start(command, **options)

    monkeypatch.setattr(subprocess, "Popen", noted)
    look_at([*paths, tmp_path / "missing.rrd"])
    # All; the halves; the quarters of the second one; the damaged one, its neighbour, and the reader.
    assert [sum(word.endswith(".rrd") for word in one) for one in commands] == [8, 4, 4, 2, 1, 1, 1, 2]
    for path in paths:
        if path.stem == "5":
            with pytest.raises(InputError, match=TOLD):
                check_sound(path)
        else:
            check_sound(path)
    look_at(paths)
    assert len(commands) == 8


def test_what_rerun_refuses_itself_passes(sound: Path, tmp_path: Path) -> None:
    check_sound(tmp_path / "missing.rrd")
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(sound.read_bytes()[: STREAM_HEAD_BYTES + 20])
    check_sound(cut)
    with pytest.raises(InputError, match="is damaged"):
        read_trial(cut)
