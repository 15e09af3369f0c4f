"""Sessions on disk: one SQLite file (write-ahead log), every trial durable before the next begins."""

import csv
import fcntl
import json
import re
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Self

from hexctl.adapt.session import BASELINE_GAITS, BaselineRecord, Session, SessionSpec, TrialRecord
from hexctl.control.result import QUALITIES
from hexctl.errors import HexctlError, InputError, MissingExtraError, check_type

SCHEMA_VERSION = 1

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
"""


#: Folder of sessions and their recordings unless told otherwise.
RUNS = Path("runs")


class StoreError(HexctlError, OSError):
    """The store cannot be read or written."""


def stored_names(folder: Path) -> list[str]:
    """Names of all sessions in a folder, newest last, without making or writing anything.

    Raises StoreError for a store that cannot be read now.
    """
    path = folder / "sessions.sqlite"
    if not path.is_file():
        return []
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=0.1)) as reader:
            return _names(reader)
    except sqlite3.Error as error:
        raise StoreError(f"session store: {path} cannot be read: {error}") from error


def _names(connection: sqlite3.Connection) -> list[str]:
    rows = connection.execute("SELECT name FROM sessions ORDER BY created, rowid")
    return [name for (name,) in rows]


class SessionStore:
    """The sessions under one folder; a session's recordings lie in a folder of its name beside the store."""

    def __init__(self, folder: Path) -> None:
        """Open or make the store `sessions.sqlite` in a folder.

        Raises InputError for a folder that cannot be used, StoreError for the file.
        """
        self.folder = folder
        self.path = folder / "sessions.sqlite"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"sessions: {folder} cannot be used ({error.strerror}); allowed: a folder"
            ) from error
        try:
            self._connection = sqlite3.connect(self.path, timeout=BUSY_TIMEOUT_S, isolation_level=None)
            self._prepare()
        except StoreError:
            raise
        except (OSError, sqlite3.Error) as error:
            raise StoreError(f"session store: {self.path} cannot be used: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

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
        except sqlite3.Error as error:
            raise StoreError(
                f"session {session.name}: trial {trial.index} cannot be stored: {error}"
            ) from error
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
        except sqlite3.Error as error:
            raise StoreError(
                f"session {session.name}: the baseline {walk.gait} cannot be stored: {error}"
            ) from error
        session.baseline.append(walk)

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
        except sqlite3.Error as error:
            raise StoreError(f"session {session.name}: it cannot be stored: {error}") from error

    def load(self, name: str) -> Session:
        """Session with all its trials.

        Raises InputError for a name that is not in the store.
        """
        row = self._connection.execute(
            "SELECT created, spec, ended, settled_on FROM sessions WHERE name = ?", (name,)
        ).fetchone()
        if row is None:
            names = self.names()
            known = ", ".join(names[-5:]) or "none yet"
            earlier = f"{len(names) - 5} earlier ones, " if len(names) > 5 else ""
            raise InputError(f"session: got {name!r}; allowed, of {self.folder}/: {earlier}{known}")
        created, spec, ended, settled_on = row
        session = Session(
            name=name,
            created=created,
            spec=SessionSpec(**json.loads(spec)),
            ended=ended,
            settled_on=None if settled_on is None else json.loads(settled_on),
        )
        rows = self._connection.execute(
            "SELECT record, optimizer_state FROM trials WHERE session = ? ORDER BY number", (name,)
        )
        for record, state in rows:
            values = json.loads(record)
            session.trials.append(TrialRecord(**{**values, "slots": tuple(values["slots"])}))
            session.optimizer_state = json.loads(state)
        walks = self._connection.execute(
            "SELECT record FROM baselines WHERE session = ? ORDER BY rowid", (name,)
        )
        for (record,) in walks:
            values = json.loads(record)
            session.baseline.append(BaselineRecord(**{**values, "slots": tuple(values["slots"])}))
        return session

    def names(self) -> list[str]:
        """Names of all sessions, newest last."""
        return _names(self._connection)

    def delete(self, name: str) -> None:
        """Remove a session from the store; its recordings are left to the caller.

        Raises InputError for a name that is not in the store.
        """
        self.load(name)
        with self._transaction():
            self._connection.execute("DELETE FROM sessions WHERE name = ?", (name,))

    def folder_of(self, name: str) -> Path:
        """Folder of a session's recordings."""
        return self.folder / name

    @contextmanager
    def held(self, name: str) -> Iterator[None]:
        """Keep other processes from continuing a session meanwhile; the lock of a killed holder is released.

        Raises InputError when another process holds it.
        """
        folder = self.folder_of(name)
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise InputError(
                    f"session {name}: another process is running it; wait for it or stop it"
                ) from None
            yield

    def _prepare(self) -> None:
        connection = self._connection
        connection.execute("PRAGMA journal_mode = WAL")
        # FULL: when its transaction ends, a trial is on the disk and not only in the cache of the kernel.
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version not in (0, SCHEMA_VERSION):
            raise StoreError(f"session store: {self.path} has version {version}; allowed: {SCHEMA_VERSION}")
        with self._transaction():
            for statement in filter(str.strip, _TABLES.split(";")):
                connection.execute(statement)
            columns = {row[1] for row in connection.execute("PRAGMA table_info(sessions)")}
            for later in sorted({"ended", "settled_on"} - columns):  # of a store made before there was this
                connection.execute(f"ALTER TABLE sessions ADD COLUMN {later} TEXT")
            connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")

    def _exists(self, name: str) -> bool:
        query = "SELECT 1 FROM sessions WHERE name = ?"
        return self._connection.execute(query, (name,)).fetchone() is not None

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise
        self._connection.execute("COMMIT")


def list_sessions(folder: Path | str = RUNS) -> list[Session]:
    """All sessions of a folder with their trials, newest last; empty where there is no store."""
    folder = Path(folder)
    if not _is_store(folder):
        return []
    with SessionStore(folder) as store:
        return [store.load(name) for name in store.names()]


def load_session(name: str, folder: Path | str = RUNS) -> Session:
    """Session of a folder with its trials; raises InputError for a name that is not there."""
    check_type(name, str, "session", "the name of a session")
    with _existing(Path(folder), name) as store:
        return store.load(name)


def export_session(name: str, path: Path | str, folder: Path | str = RUNS) -> None:
    """Write a session's trials to a new .csv or .parquet file; raises what `export` raises."""
    export(load_session(name, folder), Path(path))


def delete_session(name: str, folder: Path | str = RUNS) -> None:
    """Delete a session and its recordings.

    Raises InputError for a name that is not there, or a session that another process is running.
    """
    with _existing(Path(folder), name) as store:
        store.load(name)
        with store.held(name):
            store.delete(name)
            shutil.rmtree(store.folder_of(name), ignore_errors=True)


def _is_store(folder: Path) -> bool:
    return (folder / "sessions.sqlite").is_file()


def _existing(folder: Path, name: str) -> SessionStore:
    """Store of a folder, without making one where there is none."""
    if not _is_store(folder):
        raise InputError(f"session: got {name!r}; allowed: none yet, hexctl adapt makes one under {folder}/")
    return SessionStore(folder)


#: What was predicted for a trial, a column each.
EXPECTED = ("signed_m", "low_m", "high_m", "chance")

FORMATS = (".csv", ".parquet")


#: Columns that were added before those of the baseline, and after them, in the order in which they came.
LATER_COLUMNS = ("cause",)
LAST_COLUMNS = (
    "hold",
    *QUALITIES,
    "trim_deg",
    "wanted_trim_deg",
    "turn_trim_deg_s",
    "wanted_turn_trim_deg_s",
)


def flat_rows(session: Session) -> list[dict[str, Any]]:
    """Rows, one per trial; empty for a session without trials.

    The baseline is in columns of its own, the same in every row: a row of its own would be taken for a trial.
    """
    rows = []
    baseline = _baseline_columns(session)
    for trial in session.trials:
        values = trial.as_json()
        deviation = values.pop("deviation_m")
        expected = values.pop("expected") or {}
        values |= {f"expected_{name}": expected.get(name) for name in EXPECTED}
        values["slots"] = " ".join(str(slot) for slot in trial.slots)
        values |= {f"deviation_{name}_m": value for name, value in deviation.items()}
        spec = session.spec
        head = {"session": session.name, "optimizer": spec.optimizer, "failed_leg": spec.failed_leg}
        # Columns that came later stay behind those of before.
        later, last = ({name: values.pop(name) for name in names} for names in (LATER_COLUMNS, LAST_COLUMNS))
        rows.append({**head, "seed": spec.seed, **values, **later, **baseline, **last})
    return rows


def _baseline_columns(session: Session) -> dict[str, Any]:
    """Four columns for each gait of a baseline, None where it was not walked; the newest gait comes last."""
    walked = {walk.gait: walk.as_json() for walk in session.baseline}
    columns: dict[str, Any] = {}
    for gait in dict.fromkeys((*BASELINE_GAITS[1:], *BASELINE_GAITS, *walked)):
        walk = walked.get(gait, {})
        columns[f"baseline_{gait}_score"] = walk.get("score")
        columns[f"baseline_{gait}_deviation_m"] = walk.get("deviation_m", {}).get("signed")
        columns[f"baseline_{gait}_distance_m"] = walk.get("distance_m")
        columns[f"baseline_{gait}_status"] = walk.get("status")
    return columns


def export(session: Session, path: Path) -> None:
    """Write a session's trials to a new .csv or .parquet file.

    Raises InputError for another ending, a file that exists or cannot be written, or a session without
    trials.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"export: got {path.name}; allowed: a name that ends in {' or '.join(FORMATS)}")
    if not session.trials:
        raise InputError(f"session {session.name}: has no trials to export")
    try:
        with path.open("xb"):
            pass
        (_write_csv if path.suffix == ".csv" else _write_parquet)(flat_rows(session), path)
    except FileExistsError:
        raise InputError(f"export: {path} exists; allowed: a new file, nothing is replaced") from None
    except OSError as error:
        raise InputError(
            f"export: {path} cannot be written ({error.strerror}); allowed: a new file"
        ) from error


def _write_csv(rows: list[dict[str, Any]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _write_parquet(rows: list[dict[str, Any]], path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        path.unlink()
        raise MissingExtraError("Parquet export", "study") from error
    pq.write_table(pa.Table.from_pylist(rows), path)
