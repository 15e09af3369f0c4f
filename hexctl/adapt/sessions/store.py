"""Sessions on disk: one SQLite file (write-ahead log), every trial durable before the next begins."""

import fcntl
import json
import logging
import os
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from hexctl.adapt.sessions.search_session import (
    BaselineRecord,
    ConfirmationRecord,
    Session,
    SessionSpec,
    TrialRecord,
)
from hexctl.adapt.sessions.stored import is_folder_name, is_made_by_hexctl
from hexctl.adapt.sessions.stored_rows import (
    FILE_NAME,
    SCHEMA_VERSION,
    SessionRows,
    StoreError,
    is_store,
    reading,
)
from hexctl.errors import InputError, argument, check_type
from hexctl.files import ALLOWED_FOLDER, check_writable, folder_trouble

_LOG = logging.getLogger(__name__)

#: Time that a process waits for another one that writes to the same store.
BUSY_TIMEOUT_S = 30.0

_TABLES = """
CREATE TABLE IF NOT EXISTS sessions (
    name TEXT PRIMARY KEY,
    created TEXT NOT NULL,
    spec TEXT NOT NULL,
    ended TEXT,
    settled_on TEXT
);
CREATE TABLE IF NOT EXISTS trials (
    session TEXT NOT NULL REFERENCES sessions(name) ON DELETE CASCADE,
    number INTEGER NOT NULL,
    record TEXT NOT NULL,
    optimizer_state TEXT NOT NULL,
    PRIMARY KEY (session, number)
);
CREATE TABLE IF NOT EXISTS baselines (
    session TEXT NOT NULL REFERENCES sessions(name) ON DELETE CASCADE,
    gait TEXT NOT NULL,
    record TEXT NOT NULL,
    PRIMARY KEY (session, gait)
);
CREATE TABLE IF NOT EXISTS confirmations (
    session TEXT NOT NULL REFERENCES sessions(name) ON DELETE CASCADE,
    slots TEXT NOT NULL,
    record TEXT NOT NULL,
    PRIMARY KEY (session, slots)
);
"""


#: Folder of sessions and their recordings unless told otherwise.
RUNS = Path("runs")


def stored_names(folder: Path) -> list[str]:
    """Names of all sessions in a folder, newest last, without making or writing anything.

    Raises StoreError for a store that cannot be read now.
    """
    if not is_store(folder):
        return []
    with reading(folder) as rows:
        return rows.names()


class SessionStore(SessionRows):
    """The sessions under one folder; a session's recordings lie in a folder of its name beside the store."""

    def __init__(self, folder: Path) -> None:
        """Open or make the store `sessions.sqlite` in a folder.

        Raises InputError for a folder that cannot be used, StoreError for the file.
        """
        self.folder = folder
        path = folder / FILE_NAME
        check_writable(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"sessions: {folder_trouble(folder, error)}; {ALLOWED_FOLDER}") from error
        is_store(folder)
        try:
            connection = sqlite3.connect(path, timeout=BUSY_TIMEOUT_S, isolation_level=None)
        except sqlite3.Error as error:
            raise StoreError(f"session store: {path} cannot be used: {error}") from error
        try:
            super().__init__(connection, path)
            self._prepare()
        except BaseException:
            connection.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def check_there(self) -> None:
        """Raise StoreError if the file was deleted or moved: SQLite would go on writing to it."""
        try:
            same = os.path.samestat(self.path.stat(), self._file)
        except OSError:
            same = False
        if not same:
            raise StoreError(
                f"session store: {self.path} was deleted or moved during the session; move it back and "
                "resume the session, or begin a new one"
            )

    def create(self, spec: SessionSpec) -> Session:
        """Add a session with a new name."""
        now = datetime.now().astimezone()
        # The name of an optimizer of one's own has a colon, which tools that copy folders take for a host.
        optimizer = re.sub(r"[^\w.-]+", "-", spec.optimizer)
        stem = f"{now:%Y%m%d-%H%M%S}-leg{spec.failed_leg}-{optimizer}"
        with self._transaction():
            name, number = stem, 2
            while self._exists(name):
                name, number = f"{stem}-{number}", number + 1
            created = now.isoformat(timespec="seconds")
            values = (name, created, json.dumps(spec.as_json()))
            self._connection.execute("INSERT INTO sessions (name, created, spec) VALUES (?, ?, ?)", values)
        return Session(name=name, spec=spec, created=created)

    def add_trial(self, session: Session, trial: TrialRecord, optimizer_state: dict[str, Any]) -> None:
        """Add a trial and the optimizer's state after it, on the disk when this returns.

        Raises StoreError when the disk refuses or another process has added this trial already.
        """
        values = (session.name, trial.index, json.dumps(asdict(trial)), json.dumps(optimizer_state))
        try:
            with self._transaction():
                self._connection.execute("INSERT INTO trials VALUES (?, ?, ?, ?)", values)
        except StoreError as error:
            raise _not_stored(session, f"trial {trial.index}", error) from error
        session.trials.append(trial)
        session.optimizer_state = optimizer_state

    def add_baseline(self, session: Session, walk: BaselineRecord) -> None:
        """Add a walk with a gait that the robot would use anyway, on the disk when this returns.

        Raises StoreError when the disk refuses or another process has added it already.
        """
        values = (session.name, walk.gait, json.dumps(asdict(walk)))
        try:
            with self._transaction():
                self._connection.execute("INSERT INTO baselines VALUES (?, ?, ?)", values)
        except StoreError as error:
            raise _not_stored(session, f"the baseline {walk.gait}", error) from error
        session.baseline.append(walk)

    def add_confirmation(self, session: Session, walk: ConfirmationRecord) -> None:
        """Add a walk at a finer time step, on the disk when this returns.

        Raises StoreError when the disk refuses or another process has added it already.
        """
        values = (session.name, json.dumps(walk.slots), json.dumps(asdict(walk)))
        try:
            with self._transaction():
                self._connection.execute("INSERT INTO confirmations VALUES (?, ?, ?)", values)
        except StoreError as error:
            raise _not_stored(session, f"the confirmation of gait {walk.code}", error) from error
        session.confirmations.append(walk)

    def keep(self, session: Session) -> None:
        """Store the spec of a session and how it ended, on the disk when this returns.

        Raises StoreError when the disk refuses.
        """
        settled_on = None if session.settled_on is None else json.dumps(session.settled_on)
        values = (json.dumps(session.spec.as_json()), session.ended, settled_on, session.name)
        try:
            with self._transaction():
                self._connection.execute(
                    "UPDATE sessions SET spec = ?, ended = ?, settled_on = ? WHERE name = ?", values
                )
        except StoreError as error:
            raise _not_stored(session, "its end", error) from error

    def delete(self, name: str) -> None:
        """Remove a session from the store; its recordings are left to the caller.

        Raises InputError for a name that is not in the store, StoreError when the disk refuses.
        """
        row = self._row(name)
        with self._transaction():
            for table in (
                "trials",
                "baselines",
                "confirmations",
            ):  # also where the store was made without its links
                self._connection.execute(
                    f"DELETE FROM {table} WHERE session = (SELECT name FROM sessions WHERE rowid = ?)",  # noqa: S608
                    (row,),
                )
            self._connection.execute("DELETE FROM sessions WHERE rowid = ?", (row,))

    def folder_of(self, name: str) -> Path:
        """Folder of a session's recordings.

        Raises InputError for a name that leads anywhere else.
        """
        if not is_folder_name(name):
            raise InputError(
                f"{argument('session')}: got {name!r}; allowed: the name of a folder in {self.folder}/"
            )
        return self.folder / name

    @contextmanager
    def held(self, name: str) -> Iterator[None]:
        """Keep other processes from continuing a session meanwhile; the lock of a killed holder is released.

        Raises InputError for a name that is not in the store, or when another process holds it.
        """
        self._row(name)
        folder = self.folder_of(name)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # A lock that is a link would make a file anywhere.
            lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        except OSError as error:
            raise StoreError(f"session {name}: {folder}/lock cannot be used ({error.strerror})") from error
        try:
            _take(lock, name)
            yield
            with suppress(OSError):
                if os.listdir(folder) == ["lock"]:  # of a session that records nothing
                    (folder / "lock").unlink()
                    folder.rmdir()
        finally:
            os.close(lock)

    def _prepare(self) -> None:
        connection = self._connection
        with self._reading():
            connection.execute("PRAGMA journal_mode = WAL")
            # FULL: when its transaction ends, a trial is on the disk and not only in the cache of the kernel.
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
        self._file = self.path.stat()
        with self._transaction():
            for statement in filter(str.strip, _TABLES.split(";")):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            self._tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}

    def check_idle(self, name: str) -> None:
        """Raise InputError where another process is running a session; nothing is made or followed."""
        if not is_folder_name(name):
            return
        try:
            lock = os.open(self.folder / name / "lock", os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
        except OSError:
            return
        try:
            _take(lock, name)
        finally:
            os.close(lock)

    def _row(self, name: str) -> int:
        """Row of a session; raises InputError for a name that is not in the store."""
        row = self.row_of(name)
        if row is None:
            raise self._unknown(name)
        return row

    def _exists(self, name: str) -> bool:
        query = "SELECT 1 FROM sessions WHERE name = ?"
        return self._connection.execute(query, (name,)).fetchone() is not None

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing of what a block writes; raises StoreError when the disk refuses."""
        self._limit_steps()
        try:
            self._connection.execute("BEGIN IMMEDIATE")
            yield
            self._connection.execute("COMMIT")
        except BaseException as error:
            with suppress(sqlite3.Error):
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
            if isinstance(error, sqlite3.Error):
                raise StoreError(f"session store: {self.path} cannot be written: {error}") from error
            raise
        self.check_there()


def _not_stored(session: Session, what: str, error: StoreError) -> StoreError:
    """Error for a part of a session that did not get to the disk."""
    return StoreError(f"session {session.name}: {what} cannot be stored: {error.__cause__ or error}")


def _take(lock: int, name: str) -> None:
    """Take the lock of a session; raises InputError when another process holds it."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.fstat(lock).st_nlink:
            raise OSError("its holder has just removed it")
    except OSError:
        raise InputError(f"session {name}: another process is running it; wait for it or stop it") from None


def _log_damage(error: StoreError) -> None:
    _LOG.warning("%s", error)


def list_sessions(
    folder: Path | str = RUNS, *, on_damage: Callable[[StoreError], object] = _log_damage
) -> list[Session]:
    """All sessions of a folder with their trials, newest last; empty where there is no store.

    Args:
        folder: where the sessions lie; nothing is written to it.
        on_damage: is told of each session that is damaged, which is left out. By default it is logged.

    Raises StoreError for a store that cannot be read at all.
    """
    folder = Path(folder)
    if not is_store(folder):
        return []
    with reading(folder) as rows:
        return rows.sessions(on_damage)


def load_session(name: str, folder: Path | str = RUNS) -> Session:
    """Session of a folder with its trials.

    Raises InputError for a name that is not there, StoreError for a session that is damaged.
    """
    check_type(name, str, "session", "the name of a session")
    _check_there(Path(folder), name)
    with reading(Path(folder)) as rows:
        return rows.load(name)


def delete_session(name: str, folder: Path | str = RUNS) -> None:
    """Delete a session, damaged or not, and its recordings.

    Nothing outside of the session's own folder is deleted: of a session whose name hexctl has not made, or
    whose folder is a link to another one, the recordings stay.

    Raises InputError for a name that is not there, or a session that another process is running.
    """
    _check_there(Path(folder), name)
    with SessionStore(Path(folder)) as store:
        store.check_idle(name)
        store.delete(name)
        if is_made_by_hexctl(name):
            place = store.folder_of(name)
            place.unlink() if place.is_symlink() else shutil.rmtree(place, ignore_errors=True)


def _check_there(folder: Path, name: str) -> None:
    """Raise InputError where there is no store, which is not made for that."""
    if not is_store(folder):
        raise InputError(
            f"{argument('session')}: got {name!r}; allowed: none yet, hexctl adapt makes one under {folder}/"
        )
