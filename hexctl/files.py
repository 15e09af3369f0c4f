"""Atomic writes: a reader, or a power cut, finds the old file or the new one, never a part."""

import errno
import logging
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hexctl.errors import HexctlError, InputError, is_of_disk
from hexctl.scratch import scratch_folder

_LOG = logging.getLogger(__name__)

#: Called for each damaged part that a reader leaves out.
OnDamage = Callable[[HexctlError], object]

#: Allowed folders of recordings and sessions, and a next step.
ALLOWED_FOLDER = "allowed: a folder; call hexctl from one that you can write to, or set HEXCTL_RUNS=FOLDER"


def log_damage(error: HexctlError) -> None:
    """Log omitted damaged parts: the default `OnDamage`."""
    _LOG.warning("left out: %s", error)


def state_folder() -> Path:
    """Folder of stops and clear keys: from systemd, or the user's state folder (XDG)."""
    given = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "hexctl"


def is_file(path: Path) -> bool:
    """Whether a path is a file; False also for an invalid path."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether a path is a folder; False also for an invalid path."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def file_instead(folder: Path) -> str | None:
    """`runs is a file, not a folder`, if that holds for a folder or one above it; else None."""
    file = next((one for one in (folder, *folder.parents) if is_file(one)), None)
    return None if file is None else f"{file} is a file, not a folder"


def folder_trouble(folder: Path, error: OSError) -> str:
    """Why a folder cannot be made or used: `runs is a file, not a folder`."""
    return file_instead(folder) or f"{folder}/: cannot be used ({error.strerror})"


def check_writable(folder: Path, allowed: str = ALLOWED_FOLDER) -> None:
    """Raise InputError unless a folder exists or can be made, and is writable; `allowed` ends the message."""
    if (trouble := write_trouble(folder)) is not None:
        raise InputError(f"{trouble}; {allowed}")


def make_folder(folder: Path, allowed: str = ALLOWED_FOLDER) -> None:
    """Make a folder unless it exists; raises InputError if it cannot be made or is not writable."""
    check_writable(folder, allowed)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder_trouble(folder, error)}; {allowed}") from error


def write_trouble(folder: Path) -> str | None:
    """Why a folder cannot be made or written to, or None."""
    if (instead := file_instead(folder)) is not None:
        return instead
    there = next((one for one in (folder, *folder.parents) if is_folder(one)), folder)
    return None if os.access(there, os.W_OK | os.X_OK) else f"{folder}/: cannot be written"


def read_file(path: Path, most_bytes: int) -> bytes:
    """Content of an untrusted file.

    Raises OSError for one that cannot be read, is larger than `most_bytes`, or is no regular file: a pipe or
    a device could be endless.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is a pipe, a device or a folder", str(path))
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read(most_bytes + 1)
    finally:
        os.close(descriptor)
    if len(content) > most_bytes:
        raise OSError(errno.EINVAL, f"it is larger than {most_bytes / 1e6:g} MB", str(path))
    return content


#: Largest file with a key, which people may have written with spaces and lines.
MOST_KEY_BYTES = 10_000


def read_secret(path: Path, most_bytes: int) -> bytes:
    """Content of a file with a key, to which only its owner may have access.

    Raises OSError as `read_file` does, and PermissionError with the command to type.
    """
    content = read_file(path, most_bytes)
    others = path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    if others:
        whose = "its group" if not others & stat.S_IRWXO else "every user of this computer"
        raise PermissionError(errno.EPERM, f"{whose} has access to it; chmod 600 {path}", str(path))
    return content


def read_key(path: Path, count: int, command: str) -> bytes:
    """Key of some bytes, raw or as hexadecimal digits, in a file to which only its owner may have access.

    Raises InputError for anything else; `command` makes such a key.
    """
    try:
        content = read_secret(path, MOST_KEY_BYTES)
        key = content if len(content) == count else bytes.fromhex(content.decode("ascii"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; allowed: a key of {command}") from error
    except ValueError as error:
        raise InputError(f"{path}: is no key in hexadecimal digits; allowed: one of {command}") from error
    if len(key) != count:
        raise InputError(f"{path}: has {len(key)} bytes; allowed: {count}, as of {command}")
    return key


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write a file durably, text as UTF-8; raises OSError and leaves the earlier file unchanged."""
    data = content.encode() if isinstance(content, str) else content
    with replacing(path) as draft:
        draft.write_bytes(data)


def write_new(path: Path, content: str | bytes, name: str, *, mode: int = 0o666) -> None:
    """Write a new file durably, complete or not at all: a partial one would block the next.

    Args:
        content: text is written as UTF-8.
        name: of the argument, in messages.
        mode: permissions, of which those of the umask are taken.

    Raises InputError for a file that exists, or that the disk refuses.
    """
    check_new(path, name)
    try:
        with scratch_folder(path.parent, path.stem) as folder:
            draft = folder / "new"
            with open(os.open(draft, os.O_CREAT | os.O_WRONLY, mode), "wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
            sync(draft)
            name_new(draft, path, name)
            sync(path.parent)
    except OSError as error:
        step = "" if is_of_disk(error) else "; allowed: a new file in a folder that you can write to"
        raise InputError(f"{name}: {path} cannot be written ({error.strerror}){step}") from error


def check_new(path: Path, name: str) -> None:
    """Raise InputError for a path that exists; `name` is that of the argument."""
    if os.path.lexists(path):
        raise InputError(f"{name}: {path} exists; allowed: a new file, nothing is replaced")


def name_new(draft: Path, path: Path, name: str) -> None:
    """Give a draft, a file or a folder, its name; raises InputError if another process has taken it."""
    try:
        os.link(draft, path)
    except OSError:  # a folder, or a disk without links, such as FAT: an empty one takes the name first
        try:
            path.mkdir() if draft.is_dir() else path.touch(exist_ok=False)
        except FileExistsError:
            check_new(path, name)
            raise
        draft.rename(path)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Path of a draft that replaces a file, with its permissions, when the block ends.

    The block creates the draft. If it raises, the draft is removed. Raises OSError when the disk refuses.
    """
    with scratch_folder(path.parent, path.stem) as folder:
        draft = folder / f"{path.name}.part"
        yield draft
        if path.is_file():
            shutil.copymode(path, draft)
        sync(draft)
        draft.replace(path)
        sync(path.parent)


def sync(path: Path) -> None:
    """Make sure that a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
