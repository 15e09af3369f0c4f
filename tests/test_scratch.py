"""Scratch folders, also those of processes that are killed."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hexctl import scratch
from hexctl.files import atomic_write
from hexctl.scratch import remove_abandoned, scratch_folder

DRAFTING = """
import sys
from pathlib import Path
from hexctl.files import replacing
with replacing(Path(sys.argv[1])) as draft:
    draft.write_text("half")
    print("drafting", flush=True)
    sys.stdin.read()
"""

KEYS = """
import sys
from pathlib import Path
from hexctl.wire import certificates
def wait(folder):
    print("drafting", flush=True)
    sys.stdin.read()
certificates.write_stop_secret = wait
certificates.make_certificates(Path(sys.argv[1]), hosts=["127.0.0.1"], days=1)
"""

BOARD = """
import sys, tempfile
tempfile.tempdir = sys.argv[1].rpartition("/")[0]
from hexctl.simulators.simulated_board import SocketLine
line = SocketLine("i2c")
print("drafting", flush=True)
sys.stdin.read()
"""


@contextmanager
def drafting(path: Path, program: str = DRAFTING) -> Iterator[subprocess.Popen[str]]:
    """A process in the middle of a file, until it is killed."""
    command = [sys.executable, "-c", program, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "drafting\n"
            yield process
        finally:
            process.kill()


@pytest.fixture(autouse=True)
def next_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a process that has just begun."""
    monkeypatch.setattr(scratch, "_tidied", set())


def test_a_folder_goes_with_its_block_unless_it_was_moved_away(tmp_path: Path) -> None:
    with scratch_folder(tmp_path, "keys") as folder:
        (folder / "key").touch()
        assert folder.stat().st_mode & 0o777 == 0o700
    assert not list(tmp_path.iterdir())
    with scratch_folder(tmp_path, "keys") as folder:
        (folder / "key").touch()
        folder.rename(tmp_path / "keys")
    assert (tmp_path / "keys" / "key").exists()


@pytest.mark.parametrize("program", [DRAFTING, KEYS, BOARD], ids=["file", "keys", "board"])
def test_what_a_killed_process_leaves_goes_at_the_next_start(tmp_path: Path, program: str) -> None:
    with drafting(tmp_path / "a", program):
        assert len(list(tmp_path.iterdir())) == 1
        atomic_write(tmp_path / "b.txt", "other")
        assert len(list(tmp_path.iterdir())) == 2, "it is being worked on"
    assert len(list(tmp_path.iterdir())) == 2
    scratch._tidied.clear()
    atomic_write(tmp_path / "b.txt", "again")
    assert [path.name for path in tmp_path.iterdir()] == ["b.txt"]


def test_nothing_else_is_removed(tmp_path: Path) -> None:
    strangers = [".a-12345678", ".a-personal.part", "a.part", ".a-1234567g.part"]
    for name in strangers:
        (tmp_path / name).mkdir()
    (tmp_path / ".b-12345678.part").write_text("a file")
    (target := tmp_path / "target").mkdir()
    (tmp_path / ".c-12345678.part").symlink_to(target)
    before = sorted(os.listdir(tmp_path))
    remove_abandoned(tmp_path)
    assert sorted(os.listdir(tmp_path)) == before
    remove_abandoned(tmp_path / "missing")


def test_an_abandoned_folder_is_looked_for_once_in_a_process(tmp_path: Path) -> None:
    remove_abandoned(tmp_path)
    (late := tmp_path / ".a-12345678.part").mkdir()
    remove_abandoned(tmp_path)
    assert late.exists()
    scratch._tidied.clear()
    remove_abandoned(tmp_path)
    assert not late.exists()
