"""Reading the session store, also one that is damaged in part or that may not be written."""

import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from itertools import chain, repeat
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.stored import stored_session
from hexctl.errors import HexctlError, InputError, argument, shown
from hexctl.files import file_instead
from hexctl.scratch import scratch_folder

SCHEMA_VERSION = 1

FILE_NAME = "sessions.sqlite"

#: Rows that are looked for one by one in a table of which a page is lost.
MOST_PROBED = 10_000

#: What the schema of a store may have; SQLite writes it this way. A view can be endless, a trigger runs code.
_PLAIN = ("CREATE TABLE ", "CREATE INDEX ", "CREATE UNIQUE INDEX ")

#: Steps of SQLite's machine that one connection may take; a trial is read in about 30.
MOST_STEPS = 10_000_000

#: Steps between two looks at how many there were.
STEPS_AT_ONCE = 100_000

#: Longest text in a store; the state of an optimizer has less than a million bytes.
MOST_TEXT_BYTES = 50_000_000

#: What reading a store raises: Python cannot read a message of SQLite with a damaged name in it.
_DAMAGE = (sqlite3.Error, UnicodeDecodeError)

#: Codes of SQLite for what a disk, its rights or another process refuses: the store itself may be whole.
_NOT_ITS_FAULT = (
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
)

_READ = ("sessions", "trials", "baselines", "confirmations")


class StoreError(HexctlError, OSError):
    """The store, or a session in it, cannot be read or written."""


class SessionRows:
    """What a connection to a store reads. A session that is damaged costs no other one.

    Text that is no UTF-8 is escaped, so that every session has a name that can be typed.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        """Read a store.

        Raises StoreError for one of another version, or that is none.
        """
        self.path = path
        self._connection, self._lost = connection, False
        connection.text_factory = lambda data: data.decode("utf-8", "backslashreplace")
        self._limit_steps()
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_TEXT_BYTES)
        with self._reading():
            connection.execute("PRAGMA trusted_schema = OFF")
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            self._tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
            self._check_plain()
        if version not in (0, SCHEMA_VERSION):
            raise StoreError(f"session store: {path} has version {version}; allowed: {SCHEMA_VERSION}")

    def names(self) -> list[str]:
        """Names of all sessions that can be found, newest last."""
        return [name for _, name in self._found()]

    def row_of(self, name: str) -> int | None:
        """Number of the row of a session, or None."""
        return next((row for row, known in self._found() if known == name), None)

    def load(self, name: str) -> Session:
        """Session with all its trials.

        Raises InputError for a name that is not in the store, StoreError for a session that is damaged.
        """
        row = self.row_of(name)
        if row is None:
            raise self._unknown(name)
        return self._session(row, name)

    def sessions(self, on_damage: Callable[[StoreError], object]) -> list[Session]:
        """All sessions, newest last; `on_damage` is told of each that is damaged, which is left out."""
        found, rows = [], self._found()
        if self._lost:
            on_damage(self._unreadable("a page of it is lost; there may be more sessions than are listed"))
        for row, name in rows:
            try:
                found.append(self._session(row, name))
            except StoreError as error:
                on_damage(error)
        return found

    def _limit_steps(self) -> None:
        """End what takes too many steps from now on.

        The counter is no Python function: SQLite would swallow the KeyboardInterrupt of one.
        """
        looks = chain(repeat(0, MOST_STEPS // STEPS_AT_ONCE), repeat(1))
        self._connection.set_progress_handler(looks.__next__, STEPS_AT_ONCE)

    def _check_plain(self) -> None:
        """Raise StoreError for a store with more than plain tables and indexes, or with computed columns."""
        statements = self._connection.execute("SELECT sql FROM sqlite_master WHERE sql NOT NULL").fetchall()
        foreign = [sql for (sql,) in statements if not str(sql).startswith(_PLAIN)]
        for table in _READ:
            columns = self._connection.execute(f"PRAGMA table_xinfo({table})")
            foreign += [name for _, name, *_, hidden in columns if hidden]
        if foreign:
            raise StoreError(
                f"session store: {self.path} has {shown(foreign[0])}; allowed: plain tables as hexctl adapt "
                "makes them; move it away to begin a new one"
            )

    def _session(self, row: int, name: str) -> Session:
        try:
            return stored_session(
                name,
                self._head(row),
                self._trials(row),
                self._records(row, "baselines"),
                self._records(row, "confirmations"),
            )
        except (ValueError, sqlite3.Error) as error:
            raise StoreError(
                f"session {name}: is damaged ({_words(error)}); its recordings can be opened one by one, and "
                f"hexctl sessions delete removes it"
            ) from error

    def _unknown(self, name: str) -> InputError:
        """Error for a name that is not in the store."""
        names = self.names()
        known = ", ".join(names[-5:]) or "none yet"
        earlier = f"{len(names) - 5} earlier ones, " if len(names) > 5 else ""
        where = f"allowed, of {self.path.parent}/"
        return InputError(f"{argument('session')}: got {name!r}; {where}: {earlier}{known}")

    def _found(self) -> list[tuple[int, str]]:
        """Rows and names of all sessions, newest last; those of lost pages are left out."""
        if not self._tables:
            return []
        try:
            return self._listed("ORDER BY created, rowid")
        except sqlite3.OperationalError as error:
            raise self._unreadable(error) from error
        except _DAMAGE as error:
            rows, self._lost = self._salvaged(), True
            if not rows:
                raise self._unreadable(error) from error
            return rows

    def _listed(self, end: str) -> list[tuple[int, str]]:
        rows = self._connection.execute(f"SELECT rowid, name FROM sessions {end}")  # noqa: S608  ours
        return [(row, _name(name)) for row, name in rows]

    def _salvaged(self) -> list[tuple[int, str]]:
        """What can be read of a table of which a page is lost: from both ends, and row by row between."""
        found: dict[int, str] = {}
        for order in ("ASC", "DESC"):
            try:
                for row, name in self._connection.execute(
                    f"SELECT rowid, name FROM sessions ORDER BY rowid {order}"  # noqa: S608  ours
                ):
                    found[row] = _name(name)
            except _DAMAGE:
                continue
        for row in range(1, min(max(found, default=0), MOST_PROBED)):
            if row not in found:
                try:
                    found |= dict(self._listed(f"WHERE rowid = {row}"))
                except _DAMAGE:
                    continue
        return sorted(found.items())

    def _head(self, row: int) -> Any:
        """The columns of a session."""
        query = "SELECT typeof(name), created, spec, ended, settled_on FROM sessions WHERE rowid = ?"
        kind, *head = self._connection.execute(query, (row,)).fetchone()
        if kind != "text":
            raise ValueError("its name is no text")
        return head

    def _trials(self, row: int) -> Iterable[Any]:
        return self._of(row, "trials", "number, record, optimizer_state", "number")

    def _records(self, row: int, table: str) -> Iterable[Any]:
        return [record for (record,) in self._of(row, table, "record", "rowid")]

    def _of(self, row: int, table: str, columns: str, order: str) -> list[Any]:
        """Rows of another table that belong to a session."""
        query = (
            f"SELECT {columns} FROM {table} {{}} "  # noqa: S608  ours
            f"WHERE session = (SELECT name FROM sessions WHERE rowid = ?) ORDER BY {order}"
        )
        try:
            return self._connection.execute(query.format(""), (row,)).fetchall()
        except (
            sqlite3.DatabaseError,
            UnicodeDecodeError,
        ):  # perhaps a page of its index is lost, which can be done without
            return self._connection.execute(query.format("NOT INDEXED"), (row,)).fetchall()

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as error:
            raise self._unreadable(error) from error

    def _unreadable(self, error: Exception | str) -> StoreError:
        if getattr(error, "sqlite_errorcode", 0) & 0xFF in _NOT_ITS_FAULT:
            return StoreError(f"session store: {self.path} cannot be used: {error}")
        return StoreError(
            f"session store: {self.path} is damaged: {_words(error)}; move it away to begin a new one, the "
            "recordings of its sessions stay"
        )


def _words(error: Exception | str) -> str:
    """Why a store cannot be read."""
    if getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_INTERRUPT:
        return "it has more rows than any store of hexctl"
    return str(error)


def _name(value: Any) -> str:
    """Name of a session; of a row without one as Python writes what is there."""
    return value if isinstance(value, str) else repr(value)


def is_store(folder: Path) -> bool:
    """Whether a folder has a store.

    Raises InputError for a file in place of the folder, StoreError where something else has the store's name.
    """
    if (instead := file_instead(folder)) is not None:
        raise InputError(f"{instead}; allowed: a folder of sessions")
    path = folder / FILE_NAME
    if path.is_file():
        return True
    if path.exists() or path.is_symlink():
        raise StoreError(f"session store: {path} is no file; move it away to begin a new one")
    return False


@contextmanager
def reading(folder: Path) -> Iterator[SessionRows]:
    """Read the store of a folder without writing anything, also where nothing may be written.

    Raises StoreError for one that cannot be read.
    """
    path = folder / FILE_NAME
    with _without_log(path), _opened(path) as connection:
        yield SessionRows(connection, path)


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Connection to a store, or to a copy of it."""
    try:
        connection = _connected(path)
    except _DAMAGE:
        # A store that is written ahead cannot be opened where no files can be made beside it.
        with scratch_folder() as place, closing(_copied(path, place)) as copy:
            yield copy
        return
    with closing(connection):
        yield connection


@contextmanager
def _without_log(path: Path) -> Iterator[None]:
    """Remove the log that reading a store made beside it: a connection that only reads leaves it."""
    log = path.with_name(f"{path.name}-wal")
    before = log.exists()
    try:
        yield
    finally:
        if not before and log.exists():
            # SQLite removes it when the last connection that may write is closed, and not before that.
            with suppress(sqlite3.Error), closing(sqlite3.connect(path, timeout=0.0)) as connection:
                connection.execute("SELECT count(*) FROM sqlite_master").fetchone()


def _connected(path: Path) -> sqlite3.Connection:
    """Connection that only reads, tried out."""
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=1.0)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def _copied(path: Path, place: Path) -> sqlite3.Connection:
    """Connection to a copy of a store, with what was written ahead."""
    try:
        for suffix in ("", "-wal"):
            if (source := path.with_name(path.name + suffix)).is_file():
                shutil.copyfile(source, place / source.name)
        return sqlite3.connect(place / path.name)
    except (OSError, *_DAMAGE) as error:
        raise StoreError(f"session store: {path} cannot be read: {error}") from error
