"""Sessions on disk: a folder each, with a file to which every event adds a line.

A line is on the disk before the next trial begins. A killed process loses at most the line that it was
writing, which the next one replaces. A damaged line is left out.
"""

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import (
    DAMAGE,
    Walk,
    damage_text,
    read_session,
    standing_line,
    take_in,
    walk_line,
)
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.errors import HexctlError, InputError, argument, check_type, printable
from hexctl.files import (
    ALLOWED_FOLDER,
    OnDamage,
    folder_trouble,
    log_damage,
    make_folder,
    read_file,
    replacing,
    sync,
)

#: File of a session in its folder.
FILE_NAME = "session.jsonl"

#: Folder of sessions and their recordings unless told otherwise.
RUNS = Path("runs")

#: Largest file of a session that is read.
MOST_BYTES = 1_000_000_000

#: Ends the message for a session that another process holds.
_LOCKED = "another process is running it; wait for it or stop it"

#: Names that `SessionStore.create` gives. Only of those a deletion removes everything in the folder.
_MADE = re.compile(r"\d{8}-\d{6}-leg[1-6]-[\w.-]+")


class StoreError(HexctlError, OSError):
    """A session cannot be read or written."""


class SessionStore:
    """Writes the sessions of a folder, which also holds their recordings."""

    def __init__(self, folder: Path) -> None:
        """Open or make a folder; raises InputError for one that cannot be used."""
        self.folder = folder
        self._locks: dict[str, int] = {}
        make_folder(folder)

    def create(self, spec: SessionSpec, lock_stack: ExitStack | None = None) -> Session:
        """Add a session with a new name, on the disk when this returns.

        Args:
            lock_stack: keeps the session locked until it is closed, as `locked` does; None locks nothing.

        Raises StoreError when the disk refuses.
        """
        spec = replace(spec, seal=spec.own_seal())
        now = datetime.now().astimezone()
        # The name of a custom optimizer has a colon, which tools that copy folders take for a host.
        optimizer = re.sub(r"[^\w.-]+", "-", spec.optimizer)
        stem = f"{now:%Y%m%d-%H%M%S}-leg{spec.broken.leg}-{optimizer}"
        session = Session(name=stem, spec=spec, created=now.isoformat(timespec="seconds"))
        line = standing_line(session)
        with ExitStack() as creation:
            stack = creation if lock_stack is None else lock_stack
            try:
                session.name = self._made_folder(stem)
                lock = stack.enter_context(_made(self.folder / session.name / FILE_NAME, line))
                sync(self.folder)
            except OSError as error:
                raise StoreError(f"session {stem}: cannot be stored: {error.strerror}") from error
            self._locks[session.name] = lock
            stack.callback(self._locks.pop, session.name)
        session.stored_bytes = len(line)
        return session

    @contextmanager
    def locked(self, name: str) -> Iterator[None]:
        """Keep other processes from continuing a session meanwhile; the lock of a killed holder is released.

        Raises InputError for an unknown name, or when another process holds it.
        """
        with _locked(name, self.folder) as lock:
            self._locks[name] = lock
            try:
                yield
            finally:
                del self._locks[name]

    def add(self, session: Session, walk: Walk, optimizer_state: dict[str, Any] | None = None) -> None:
        """Add a walk, with the state of the optimizer after a trial, on the disk when this returns.

        Raises StoreError when the disk refuses, another process holds the session or has added to it, and
        TypeError for a state that JSON cannot hold.
        """
        self._append(session, walk.name, walk_line(walk, optimizer_state))
        take_in(session, walk, optimizer_state)

    def keep(self, session: Session) -> None:
        """Store a session's spec and end, on the disk when this returns; raises StoreError as `add` does."""
        self._append(session, "its end", standing_line(session))

    def folder_of(self, name: str) -> Path:
        """Folder of a session and its recordings."""
        return self.folder / name

    def _made_folder(self, stem: str) -> str:
        name, numbers = stem, count(2)
        while True:
            try:
                (self.folder / name).mkdir()
            except FileExistsError:
                name = f"{stem}-{next(numbers)}"
            else:
                return name

    def _append(self, session: Session, what: str, line: bytes) -> None:
        """Add a line to a session's file, replacing an incomplete one."""
        name = session.name
        with _opened(self.folder / name / FILE_NAME, name) as file:
            self._lock_file(name, file)
            self._check_last(session, what, file)
            try:
                os.ftruncate(file, session.stored_bytes)
                _write(file, line)
            except OSError as error:
                with suppress(OSError):
                    os.ftruncate(file, session.stored_bytes)
                raise StoreError(f"session {name}: {what} cannot be stored: {error.strerror}") from error
        session.stored_bytes += len(line)

    def _lock_file(self, name: str, file: int) -> None:
        """Take the lock of a session's file until it is closed, unless this store holds it already."""
        if name not in self._locks:
            if not _lock(file):
                raise StoreError(f"session {name}: {_LOCKED}")
        elif not os.path.samestat(os.fstat(self._locks[name]), os.fstat(file)):
            raise _moved(name)

    def _check_last(self, session: Session, what: str, file: int) -> None:
        """Raise StoreError if a file has less than its session has stored, or another complete line."""
        name, size = session.name, os.fstat(file).st_size
        if size < session.stored_bytes:
            raise _moved(name)
        rest = os.pread(file, size - session.stored_bytes, session.stored_bytes)
        if b"\n" in rest:
            raise StoreError(
                f"session {name}: {what} cannot be stored: another process has added to it, or the disk "
                "failed before; check the disk, then resume the session"
            )


def _write(file: int, data: bytes) -> None:
    """Append bytes, on the disk when this returns."""
    while data:
        data = data[os.write(file, data) :]
    os.fsync(file)


@contextmanager
def _opened(path: Path, name: str) -> Iterator[int]:
    """Descriptor of a session's file, which is no link and no pipe; raises StoreError without one."""
    try:
        file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        raise _moved(name) from None
    except OSError as error:
        raise StoreError(f"session {name}: {path} cannot be used ({error.strerror})") from error
    try:
        if not stat.S_ISREG(os.fstat(file).st_mode):
            raise StoreError(f"session {name}: {path} is not a file; `hexctl sessions delete` removes it")
        yield file
    finally:
        os.close(file)


def _moved(name: str) -> StoreError:
    return StoreError(
        f"session {name}: its file {FILE_NAME} was deleted, moved or replaced; move it back and resume the "
        "session, or begin a new one"
    )


@contextmanager
def _made(path: Path, content: bytes) -> Iterator[int]:
    """Descriptor of a new file, on the disk and locked before its name is visible."""
    with ExitStack() as stack:
        with replacing(path) as draft:
            draft.write_bytes(content)
            lock = os.open(draft, os.O_RDWR)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield lock


def is_folder_name(name: str) -> bool:
    """Whether a name is that of a single folder, without a path."""
    return name not in ("", ".", "..") and not set("/\\") & set(name) and printable(name) == name


def stored_names(folder: Path) -> list[str]:
    """Names of all sessions in a folder, newest last, without writing; StoreError if it cannot be read."""
    return [name for name in _found(folder) if is_folder_name(name)]


def _found(folder: Path) -> list[str]:
    """Names of folders with a session's file, newest last, also names that cannot be typed."""
    try:
        names = os.listdir(folder)
    except FileNotFoundError:
        return []
    except NotADirectoryError as error:
        raise InputError(f"sessions: {folder_trouble(folder, error)}; {ALLOWED_FOLDER}") from error
    except OSError as error:
        raise StoreError(f"sessions: {folder}/ cannot be read ({error.strerror})") from error
    found = [name for name in names if os.path.lexists(folder / name / FILE_NAME)]
    return sorted(found, key=_order)


def _order(name: str) -> list[str | int]:
    """Order of sessions: by name, which begins with their time, with numbers as such."""
    return [int(part) if number % 2 else part for number, part in enumerate(re.split("([0-9]+)", name))]


@contextmanager
def _locked(name: str, folder: Path) -> Iterator[int]:
    _check_there(name, folder)
    with _opened(folder / name / FILE_NAME, name) as file:
        if not _lock(file):
            raise InputError(f"session {name}: {_LOCKED}")
        yield file


def _lock(file: int) -> bool:
    """Take the lock of a file, which closing it releases; False if another process has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def list_sessions(folder: Path | str = RUNS, *, on_damage: OnDamage = log_damage) -> list[Session]:
    """All sessions of a folder with their trials, newest last; nothing is written.

    Args:
        on_damage: called for each session that cannot be read, which is left out, and for damaged lines; by
            default they are logged.

    Raises StoreError for a folder that cannot be read.
    """
    folder, sessions = Path(folder), []
    for name in _found(folder):
        try:
            sessions.append(_loaded(name, folder, on_damage))
        except StoreError as error:
            on_damage(error)
    return sessions


def load_session(name: str, folder: Path | str = RUNS, *, on_damage: OnDamage = log_damage) -> Session:
    """Session of a folder with its trials; `on_damage` is called for damaged lines, which are left out.

    Raises InputError for an unknown name, StoreError for a session that cannot be read.
    """
    check_type(name, str, "session", "the name of a session")
    _check_there(name, Path(folder))
    return _loaded(name, Path(folder), on_damage)


def _check_there(name: str, folder: Path) -> None:
    names = stored_names(folder)
    if name in names:
        return
    if not names:
        raise InputError(
            f"{argument('session')}: got {name!r}; allowed: none yet, hexctl adapt makes one under {folder}/"
        )
    earlier = f"{len(names) - 5} earlier ones, " if len(names) > 5 else ""
    raise InputError(
        f"{argument('session')}: got {name!r}; allowed, of {folder}/: {earlier}{', '.join(names[-5:])}"
    )


def _loaded(name: str, folder: Path, on_damage: OnDamage) -> Session:
    try:
        if not is_folder_name(name):
            raise ValueError("its name cannot be typed; rename its folder")
        session, damaged = read_session(name, read_file(folder / name / FILE_NAME, MOST_BYTES))
    except (OSError, *DAMAGE) as error:
        raise StoreError(
            f"session {name}: is damaged ({damage_text(error)}); its recordings can be opened one by one, "
            "and hexctl sessions delete removes it"
        ) from error
    if damaged:
        lines = f"{'lines' if len(damaged) > 1 else 'line'} {', '.join(map(str, damaged))}"
        first = next(iter(damaged.values()))
        on_damage(StoreError(f"session {name}: damaged at {lines} of {FILE_NAME} ({first})"))
    return session


def delete_session(name: str, folder: Path | str = RUNS) -> None:
    """Delete a session, damaged or not, and its recordings.

    Nothing outside of its folder is deleted: if hexctl did not make its name, or the folder is a link,
    recordings stay. Raises InputError for an unknown name, or a session that another process is running,
    StoreError when the disk refuses.
    """
    folder = Path(folder)
    _check_there(name, folder)
    with ExitStack() as stack:
        with suppress(StoreError):  # its file cannot be locked
            stack.enter_context(_locked(name, folder))
        _remove(folder / name)


def _remove(folder: Path) -> None:
    """Remove a session's folder, as `delete_session` says; raises StoreError when the disk refuses."""
    try:
        if folder.is_symlink():
            folder.unlink()
        elif _MADE.fullmatch(folder.name):
            shutil.rmtree(folder)
        else:
            (folder / FILE_NAME).unlink()
            with suppress(OSError):  # it holds something else
                folder.rmdir()
    except OSError as error:
        raise StoreError(f"session {folder.name}: cannot be deleted ({error.strerror})") from error
