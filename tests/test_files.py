"""Atomic writes, and files that somebody else has named."""

import errno
import io
import os
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hexctl import files
from hexctl.archive import MOST_ARCHIVE_BYTES, MOST_ARRAYS, open_archive
from hexctl.cli.main import exit_code
from hexctl.errors import InputError, is_of_disk
from hexctl.files import (
    atomic_write,
    folder_trouble,
    is_file,
    is_folder,
    read_file,
    read_secret,
    replacing,
    state_folder,
    write_new,
)


def test_a_file_in_the_place_of_a_folder_is_told_as_that(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    for folder in (tmp_path / "runs", tmp_path / "runs" / "a"):
        with pytest.raises(OSError, match=r"File exists|Not a directory") as raised:
            folder.mkdir()
        assert folder_trouble(folder, raised.value) == f"{tmp_path}/runs is a file, not a folder"
    refused = PermissionError(13, "Permission denied")
    assert folder_trouble(Path("runs"), refused) == "runs/: cannot be used (Permission denied)"


def test_a_path_that_no_system_can_look_up_is_neither_file_nor_folder(tmp_path: Path) -> None:
    assert is_folder(tmp_path)
    for path in (tmp_path / ("a" * 5000), Path("a\0b")):
        assert not is_folder(path)
        assert not is_file(path)


def test_an_open_reader_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    atomic_write(path, "old")
    with path.open() as reader:
        atomic_write(path, "new")
        assert reader.read() == "old"


def test_permissions_of_the_old_file_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.touch(mode=0o600)
    atomic_write(path, "new")
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_write_that_fails_leaves_the_old_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    atomic_write(path, "old")

    def fail() -> None:
        with replacing(path) as draft:
            draft.write_text("half")
            raise ValueError("half way")

    with pytest.raises(ValueError, match="half way"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_place_that_cannot_be_written_is_an_oserror(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="missing"):
        atomic_write(tmp_path / "missing" / "a.txt", "text")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        atomic_write(tmp_path / "folder", "text")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_new_file_is_complete_or_not_there_and_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"{'n' * 240}.yaml"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))  # a full disk
    try:
        with pytest.raises(InputError) as raised:
            write_new(path, "x" * 20, "FILE")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert is_of_disk(raised.value.__cause__)
    assert not list(tmp_path.iterdir())
    write_new(path, "first", "FILE", mode=0o600)
    assert path.stat().st_mode & 0o777 == 0o600
    monkeypatch.setattr("hexctl.files.check_new", lambda *_: None)  # taken by another process meanwhile
    with pytest.raises(InputError):
        write_new(path, "second", "FILE")
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]


def test_a_disk_without_links_takes_new_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(errno.EPERM, "no links")

    monkeypatch.setattr(os, "link", refused)
    write_new(tmp_path / "a", "text", "FILE")
    for module, name, seen in ((files, "check_new", None), (os.path, "lexists", False)):  # taken meanwhile
        monkeypatch.setattr(module, name, lambda *_, seen=seen: seen)
    with pytest.raises(InputError):
        write_new(tmp_path / "a", "second", "FILE")
    assert (tmp_path / "a").read_text() == "text"


def test_the_content_is_on_the_disk_before_the_name_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, seen = tmp_path / "a.txt", []
    atomic_write(path, "old")
    sync = os.fsync

    def note(descriptor: int) -> None:
        seen.append((Path(f"/proc/self/fd/{descriptor}").resolve().is_dir(), path.read_text()))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    atomic_write(path, "new")
    assert seen == [(False, "old"), (True, "new")]


def test_only_plain_files_of_a_size_are_read(tmp_path: Path) -> None:
    path = tmp_path / "small"
    path.write_bytes(b"12345")
    assert read_file(path, 5) == b"12345"
    with pytest.raises(OSError, match="larger than 4e-06 MB"):
        read_file(path, 4)
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    for strange in (tmp_path / "pipe", tmp_path / "zeros", tmp_path):
        with pytest.raises(OSError, match="a pipe, a device or a folder"):
            read_file(strange, 5)
        with pytest.raises(OSError, match="a pipe, a device or a folder"):
            open_archive(strange)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none", 5)


@pytest.mark.parametrize(
    ("mode", "whose"),
    [(0o640, "its group"), (0o620, "its group"), (0o604, "every user")],
)
def test_a_secret_is_its_owners_alone(mode: int, whose: str, tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(b"secret")
    path.chmod(0o600)
    assert read_secret(path, 100) == b"secret"
    path.chmod(mode)
    with pytest.raises(PermissionError, match=f"{whose}.* has access to it; chmod 600 .*key"):
        read_secret(path, 100)


def array_head(shape: tuple[int, ...], kind: str) -> bytes:
    """Head of an array's file without the array."""
    buffer = io.BytesIO()
    header = {"shape": shape, "fortran_order": False, "descr": kind}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue()


#: Contents of archives that would fill a memory, and how they are packed.
TOO_LARGE: dict[str, tuple[list[bytes], int]] = {
    "zeros": ([bytes(MOST_ARCHIVE_BYTES + 1)], zipfile.ZIP_DEFLATED),
    "small parts": ([bytes(MOST_ARCHIVE_BYTES // 4)] * 5, zipfile.ZIP_DEFLATED),
    "a shape without content": ([array_head((10**12,), "<f8")], zipfile.ZIP_STORED),
    "texts without letters": ([array_head((10**12,), "<U0")], zipfile.ZIP_STORED),
    "flags that become numbers": (
        [array_head((MOST_ARCHIVE_BYTES // 4,), "|b1") + bytes(MOST_ARCHIVE_BYTES // 4)],
        zipfile.ZIP_DEFLATED,
    ),
    "too many": ([b""] * (MOST_ARRAYS + 1), zipfile.ZIP_STORED),
    "another packing": ([b""], zipfile.ZIP_LZMA),
}


@pytest.mark.parametrize(("parts", "packing"), TOO_LARGE.values(), ids=list(TOO_LARGE))
def test_an_archive_that_would_fill_the_memory_is_refused_before_it_is_unpacked(
    parts: list[bytes], packing: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "large.npz"
    with zipfile.ZipFile(path, "w", packing) as archive:
        for number, content in enumerate(parts):
            archive.writestr(f"{number}.npy", content)
    with pytest.raises(ValueError, match="it "):
        open_archive(path)
    assert exit_code(["prior", "show", str(path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_folder_is_systemds_or_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "hexctl"
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}/one:{tmp_path}/two")
    assert state_folder() == tmp_path / "one"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "hexctl"
