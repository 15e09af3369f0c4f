"""Damaged stores: what can be read is, what cannot is named, and nothing is written where nothing may be."""

import json
import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from hexctl.adapt.sessions import stored_rows
from hexctl.adapt.sessions.session_tables import export_session
from hexctl.adapt.sessions.store import (
    SessionStore,
    delete_session,
    list_sessions,
    load_session,
    stored_names,
)
from hexctl.adapt.sessions.stored_rows import StoreError, is_store, reading
from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from tests.adapt.sessions.test_store import record
from tests.adapt.walking import SPEC

#: Somebody without the rights of root, who may read what all may.
NOBODY = 65534


def make_store(folder: Path, sessions: int = 2, trials: int = 3) -> list[str]:
    """A store with sessions of some trials; their names, newest last."""
    with SessionStore(folder) as store:
        for _ in range(sessions):
            session = store.create(SPEC)
            for index in range(1, trials + 1):
                store.add_trial(session, record(index), {"after": index})
        return store.names()


def change(folder: Path, statement: str, *values: object) -> None:
    """Change rows behind the back of the store."""
    with closing(sqlite3.connect(folder / "sessions.sqlite")) as connection:
        connection.execute(statement, values)
        connection.commit()


SET_SPEC = "UPDATE sessions SET spec = ? WHERE rowid = 1"
SET_RECORD = (
    "UPDATE trials SET record = ? WHERE number = 2 AND session = (SELECT name FROM sessions WHERE rowid = 1)"
)
SET_STATE = (
    "UPDATE trials SET optimizer_state = ? WHERE number = 3 "
    "AND session = (SELECT name FROM sessions WHERE rowid = 1)"
)


def spec(**keys: object) -> str:
    return json.dumps({**SPEC.as_json(), **keys})


def trial(**keys: object) -> str:
    from dataclasses import asdict

    return json.dumps({**asdict(record(2)), **keys})


def spec_without(key: str) -> str:
    return json.dumps({name: value for name, value in SPEC.as_json().items() if name != key})


def trial_without(key: str) -> str:
    return json.dumps({name: value for name, value in json.loads(trial()).items() if name != key})


def baseline(**keys: object) -> str:
    values = json.loads(trial(gait="demo", **keys))
    return json.dumps({key: values[key] for key in values if key not in ("index", "confirms", "expected")})


def outcome(**keys: object) -> dict[str, object]:
    return {**record(2).outcome, **keys}


#: A row that is damaged, and what is said of it.
BAD_ROWS: dict[str, tuple[str, tuple[object, ...], str]] = {
    "spec is cut off": (SET_SPEC, (spec()[:60],), "spec: "),
    "spec is a list": (SET_SPEC, ("[]",), "spec: it is no mapping"),
    "spec is bytes": (SET_SPEC, (b"\xff\x00",), "spec: "),
    "spec with NaN": (SET_SPEC, (spec(duration_s=float("nan")),), "duration_s"),
    "spec of another version": (SET_SPEC, (spec(wings=2),), "unknown key wings"),
    "spec without a key": (SET_SPEC, (spec_without("seed"),), "spec: seed is missing"),
    "spec of a leg 7": (SET_SPEC, (spec(failed_leg=7),), "leg"),
    "spec with text for a number": (SET_SPEC, (spec(budget="many"),), "budget"),
    "spec with an escape code": (SET_SPEC, (spec(robot="\x1b[2Jant"),), "robot"),
    "spec with a number of 5000 digits": (SET_SPEC, ('{"budget": 1' + "0" * 5000 + "}",), "spec: "),
    "spec nested without end": (SET_SPEC, ('{"robot":' * 20_000,), "spec: "),
    "created is text": ("UPDATE sessions SET created = 'once' WHERE rowid = 1", (), "created: "),
    "created is a number": ("UPDATE sessions SET created = x'01' WHERE rowid = 1", (), "created: "),
    "ended is bytes": ("UPDATE sessions SET ended = x'ff' WHERE rowid = 1", (), "ended: it is no text"),
    "settled on nothing": ("UPDATE sessions SET settled_on = '{}' WHERE rowid = 1", (), "code is missing"),
    "trial is null": (SET_RECORD, ("null",), "trial 2: it is no mapping"),
    "trial of another number": (SET_RECORD, (trial(index=7),), "trial 2: it is that of trial 7"),
    "trial without a score": (SET_RECORD, (trial(score=None),), "trial 2: score"),
    "trial with a score of NaN": (SET_RECORD, (trial(score=float("nan")),), "trial 2: score"),
    "trial with slots that are none": (SET_RECORD, (trial(slots=[1, 1, 1, 1, 1, 1]),), "trial 2: gait"),
    "trial of code 0": (SET_RECORD, (trial(code=0),), "trial 2: "),
    "trial of code -1": (SET_RECORD, (trial(code=-1),), "trial 2: "),
    "trial of code 121": (SET_RECORD, (trial(code=121),), "trial 2: "),
    "trial of code 721": (SET_RECORD, (trial(code=721),), "trial 2: "),
    "trial of another gait": (SET_RECORD, (trial(code=3),), "trial 2: code"),
    "settled on code 0": (
        """UPDATE sessions SET settled_on = '{"code": 0, "chance": 1.0, "target_m": 0.1}' WHERE rowid = 1""",
        (),
        "settled_on: ",
    ),
    "baseline of code -1": (
        "INSERT INTO baselines SELECT name, 'demo', ? FROM sessions WHERE rowid = 1",
        (baseline(code=-1),),
        "walk 1 of the baseline: ",
    ),
    "trial with unknown keys": (SET_RECORD, (trial(wings=2),), "trial 2: "),
    "trial without an outcome": (SET_RECORD, (trial(outcome={}),), "trial 2: outcome"),
    "trial without a margin": (SET_RECORD, (trial_without("margin_m"),), "margin_m is missing"),
    "trial without a cause": (
        SET_RECORD,
        (trial(outcome={name: value for name, value in record(2).outcome.items() if name != "cause"}),),
        "outcome.cause is missing",
    ),
    "trial with a status of its own": (SET_RECORD, (trial(outcome=outcome(status="flew")),), "status"),
    "trial with a distance in words": (SET_RECORD, (trial(outcome=outcome(distance_m="far")),), "distance_m"),
    "trial with a path of one": (SET_RECORD, (trial(path_m=[[1.0]]),), "path_m"),
    "trial with a number of 400 digits": (
        SET_RECORD,
        (trial(score=0)[:-1] + ', "code": 1e400}',),
        "trial 2: ",
    ),
    "trial with an expectation of nothing": (SET_RECORD, (trial(expected={}),), "expected"),
    "state is a word": (SET_STATE, ('"bayes"',), "state after trial 3: it is no mapping"),
    "state is cut off": (SET_STATE, ('{"after": ',), "state after trial 3: "),
    "a trial is lost": (
        "DELETE FROM trials WHERE number = 2 AND session = (SELECT name FROM sessions WHERE rowid = 1)",
        (),
        "trial 2 is missing",
    ),
}


@pytest.mark.parametrize(("statement", "values", "said"), BAD_ROWS.values(), ids=list(BAD_ROWS))
def test_a_bad_row_is_named_and_the_other_sessions_are_listed(
    statement: str,
    values: tuple[object, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    bad, good = make_store(tmp_path / "runs")
    change(tmp_path / "runs", statement, *values)
    told: list[StoreError] = []
    assert [session.name for session in list_sessions("runs", on_damage=told.append)] == [good]
    (error,) = told
    assert str(error).startswith(f"session {bad}: is damaged (")
    assert said in str(error)
    assert set(stored_names(Path("runs"))) == {bad, good}
    assert exit_code(["sessions", "list"]) == 3
    printed = capsys.readouterr()
    assert printed.out.splitlines()[1].startswith(good)
    assert printed.err.splitlines() == [f"hexctl: {error}"]
    for command in (
        ["sessions", "show", bad],
        ["adapt", "--resume", bad],
        ["sessions", "export", bad, "x.csv"],
    ):
        assert exit_code(command) == 3
        assert capsys.readouterr().err == f"hexctl: {error}\n"
    assert exit_code(["sessions", "delete", bad, "--yes"]) == 0
    assert exit_code(["sessions", "list"]) == 0
    assert stored_names(Path("runs")) == [good]


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("../../evil", "../../evil"),
        ("/tmp/evil", "/tmp/evil"),  # noqa: S108  that nobody touches
        ("..", ".."),
        (".", "."),
        ("", ""),
        ("a\\b", "a\\b"),
        ("x" * 300, "x" * 300),
        ("a\nb", "a\nb"),
        (b"caf\xe9", "b'caf\\xe9'"),
        (None, "None"),
    ],
)
def test_a_name_that_is_no_folders_is_damage_and_deleting_it_touches_no_folder(
    name: object, known: str, tmp_path: Path
) -> None:
    runs = tmp_path / "deep" / "runs"
    evil = tmp_path / "evil"
    evil.mkdir()
    (evil / "precious").touch()
    (_, good) = make_store(runs)
    with closing(sqlite3.connect(runs / "sessions.sqlite")) as connection:
        connection.execute("PRAGMA writable_schema = 1")
        connection.execute("UPDATE sessions SET name = ? WHERE rowid = 1", (name,))
        connection.commit()
    assert [session.name for session in list_sessions(runs)] == [good]
    with pytest.raises((StoreError, InputError)):
        load_session(known, runs)
    before = sorted(path for path in tmp_path.rglob("*") if "sessions.sqlite" not in path.name)
    delete_session(known, runs)
    assert sorted(path for path in tmp_path.rglob("*") if "sessions.sqlite" not in path.name) == before
    assert stored_names(runs) == [good]


def test_a_name_that_is_no_utf_8_can_be_typed_as_it_is_listed(tmp_path: Path) -> None:
    (_, good) = make_store(tmp_path)
    change(tmp_path, "UPDATE sessions SET name = CAST(x'636166e9' AS TEXT) WHERE rowid = 1")
    assert stored_names(tmp_path) == ["caf\\xe9", good]
    delete_session("caf\\xe9", tmp_path)
    assert stored_names(tmp_path) == [good]


def test_deleting_follows_no_link_and_deletes_no_folder_that_is_not_a_sessions(tmp_path: Path) -> None:
    outside, runs = tmp_path / "outside", tmp_path / "runs"
    linked, locked, renamed = make_store(runs, sessions=3)
    for folder in (outside, runs / locked, runs / "priors"):
        folder.mkdir()
        (folder / "precious").touch()
    (runs / linked).symlink_to(outside)
    (runs / locked / "lock").symlink_to(outside / "precious")
    (runs / locked / "away").symlink_to(outside)
    change(runs, "PRAGMA foreign_keys = OFF")
    change(runs, "UPDATE sessions SET name = 'priors' WHERE name = ?", renamed)
    for name in (linked, locked, "priors"):
        delete_session(name, runs)
    assert [path.name for path in outside.iterdir()] == ["precious"]
    assert (runs / "priors" / "precious").is_file()
    assert not (runs / linked).is_symlink()
    assert not (runs / locked).exists()


def test_a_lock_that_is_a_link_makes_no_file_elsewhere(tmp_path: Path) -> None:
    (name,) = make_store(tmp_path / "runs", sessions=1)
    (tmp_path / "runs" / name).mkdir()
    (tmp_path / "runs" / name / "lock").symlink_to(tmp_path / "elsewhere")
    with SessionStore(tmp_path / "runs") as store, pytest.raises(StoreError, match="lock cannot be used"):
        store.held(name).__enter__()
    assert not (tmp_path / "elsewhere").exists()


def _cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _page(number: int) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        with path.open("r+b") as file:
            file.seek(4096 * number)
            file.write(b"\xa5" * 4096)

    return spoil


def _replace(content: bytes) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        path.write_bytes(content)

    return spoil


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _statement(*statements: str) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        for statement in statements:
            change(path.parent, statement)

    return spoil


def _spread(path: Path) -> None:
    """Make the pages of a small store say that they hold billions of sessions."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'sessions'").fetchone()
    content = bytearray(path.read_bytes())
    page = slice(4096 * (root - 1), 4096 * root)
    below = content[page]
    for _ in range(5):
        content += below
        child = struct.pack(">IB", len(content) // 4096, 1)
        head = struct.pack(">BHHHBI", 5, 0, 600, 4091, 0, len(content) // 4096)
        below[:] = (head + struct.pack(">H", 4091) * 600).ljust(4091, b"\0") + child
    content[page] = below
    content[28:32] = struct.pack(">I", len(content) // 4096)
    path.write_bytes(content)


BAD_FILES: dict[str, Callable[[Path], object]] = {
    "cut off": _cut,
    "first page": _page(0),
    "text": _replace(b"not a database at all, but long enough to look at" * 200),
    "zeros": _replace(bytes(100_000)),
    "a folder": _folder,
    "a pipe": _pipe,
    "another version": _statement("PRAGMA user_version = 99"),
    "no table of sessions": _statement("DROP TABLE sessions"),
    "other columns": _statement("DROP TABLE sessions", "CREATE TABLE sessions (x)"),
    "a view without end": _statement(
        "ALTER TABLE sessions RENAME TO kept",
        "CREATE VIEW sessions AS WITH RECURSIVE more(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM more) "
        "SELECT x AS name, x AS created FROM more",
    ),
    "a trigger": _statement(
        "CREATE TRIGGER gone AFTER DELETE ON sessions BEGIN DELETE FROM trials; END",
    ),
    "a column that is computed": _statement("ALTER TABLE sessions ADD COLUMN long AS (zeroblob(1000000000))"),
    "a view": _statement("DROP TABLE sessions", "CREATE VIEW sessions AS SELECT 1 AS name"),
}


@pytest.mark.parametrize("foreign", ["a view without end", "a trigger", "a column that is computed"])
def test_a_store_with_more_than_plain_tables_is_refused(foreign: str, tmp_path: Path) -> None:
    name = make_store(tmp_path)[0]
    BAD_FILES[foreign](tmp_path / "sessions.sqlite")
    with pytest.raises(StoreError, match="plain tables"):
        list_sessions(tmp_path)
    with pytest.raises(StoreError, match="plain tables"):
        delete_session(name, tmp_path)


def test_a_store_that_would_be_read_for_hours_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_store(tmp_path)
    monkeypatch.setattr(stored_rows, "MOST_STEPS", 1_000_000)
    _spread(tmp_path / "sessions.sqlite")
    with pytest.raises(StoreError, match="more rows than"):
        list_sessions(tmp_path)


def test_a_store_that_is_used_for_long_takes_every_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit holds for each read and write, not for all of them together."""
    monkeypatch.setattr(stored_rows, "MOST_STEPS", 2000)
    monkeypatch.setattr(stored_rows, "STEPS_AT_ONCE", 1000)
    make_store(tmp_path, sessions=1, trials=200)
    monkeypatch.undo()
    (session,) = list_sessions(tmp_path)
    assert len(session.trials) == 200


@pytest.mark.parametrize("spoil", BAD_FILES.values(), ids=list(BAD_FILES))
@pytest.mark.parametrize(
    "command",
    [["list"], ["show", "NAME"], ["delete", "NAME", "--yes"], ["export", "NAME", "x.csv"], ["adapt"]],
    ids=lambda command: command[0],
)
def test_a_file_that_is_no_store_is_refused_by_name_or_holds_nothing(
    spoil: Callable[[Path], object],
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    name = make_store(tmp_path / "runs", trials=30)[0]
    spoil(tmp_path / "runs" / "sessions.sqlite")
    words = [word.replace("NAME", name) for word in command]
    code = exit_code(["adapt", "--resume", name] if words == ["adapt"] else ["sessions", *words])
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    assert code in (0, 2, 3), "what can be read of it may be there, or be gone"
    assert code == 0 or (lines and all(line.startswith("hexctl: session") for line in lines))
    assert code == 0 or name in printed.err or "sessions.sqlite" in printed.err


#: The page from which all pages with trials are found.
TRIALS_PAGE = 3


@pytest.mark.parametrize("page", range(12))
def test_a_lost_page_costs_the_sessions_on_it_alone(page: int, tmp_path: Path) -> None:
    names = make_store(tmp_path, sessions=40, trials=1)
    with closing(sqlite3.connect(tmp_path / "sessions.sqlite")) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    _page(page)(tmp_path / "sessions.sqlite")
    told: list[StoreError] = []
    try:
        found = [session.name for session in list_sessions(tmp_path, on_damage=told.append)]
    except StoreError as error:
        assert "sessions.sqlite" in str(error)  # noqa: PT017  the page held what the table is
        return
    assert set(found) <= set(names)
    assert found == names or told
    assert all("is damaged" in str(error) for error in told)
    if page != TRIALS_PAGE:
        assert len(found) >= len(names) - 6


def test_trials_that_were_written_ahead_and_never_folded_in_are_there(tmp_path: Path) -> None:
    """A process that was killed leaves its log beside the store."""
    with SessionStore(tmp_path / "alive") as store:
        session = store.create(SPEC)
        store.add_trial(session, record(1), {"after": 1})
        shutil.copytree(tmp_path / "alive", tmp_path / "dead")
    assert (tmp_path / "dead" / "sessions.sqlite-wal").stat().st_size
    assert len(load_session(session.name, tmp_path / "dead").trials) == 1


@pytest.mark.parametrize("suffix", ["-wal", "-shm", "-journal"])
def test_junk_beside_the_store_costs_nothing(suffix: str, tmp_path: Path) -> None:
    names = make_store(tmp_path)
    (tmp_path / f"sessions.sqlite{suffix}").write_bytes(b"\xa5" * 40_000)
    assert [session.name for session in list_sessions(tmp_path)] == names


def test_recordings_that_are_missing_cost_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name, _ = make_store(tmp_path / "runs")
    change(tmp_path / "runs", SET_RECORD, trial(recording="runs/gone/trial-002.rrd"))
    assert exit_code(["sessions", "show", name]) == 0
    export_session(name, "trials.csv", "runs")
    delete_session(name, "runs")


@contextmanager
def read_only_store(*, left_over: bool) -> Iterator[tuple[Path, str]]:
    """A store in a folder in which this process may write nothing, and the name of its session."""
    with tempfile.TemporaryDirectory() as place:
        runs = Path(place, "runs")
        with SessionStore(runs) as store:
            session = store.create(SPEC)
            store.add_trial(session, record(1), {"after": 1})
            if left_over:
                shutil.copytree(runs, Path(place, "copy"))
        runs = Path(place, "copy") if left_over else runs
        (runs / "sessions.sqlite-shm").unlink(missing_ok=True)
        for path in runs.iterdir():
            path.chmod(0o444)
        runs.chmod(0o555)
        Path(place).chmod(0o755)
        root = os.geteuid() == 0
        if root:
            os.seteuid(NOBODY)
        try:
            yield runs, session.name
        finally:
            if root:
                os.seteuid(0)
            runs.chmod(0o755)


@pytest.mark.parametrize("left_over", [False, True], ids=["folded in", "written ahead"])
def test_a_store_that_may_not_be_written_is_listed(left_over: bool) -> None:
    with read_only_store(left_over=left_over) as (runs, name):
        before = sorted(runs.iterdir())
        with pytest.raises(PermissionError):
            (runs / "new").touch()
        (session,) = list_sessions(runs)
        assert session.name == name
        assert len(load_session(name, runs).trials) == 1
        assert stored_names(runs) == [name]
        with pytest.raises(StoreError, match=r"sessions\.sqlite cannot be"):
            delete_session(name, runs)
        assert sorted(runs.iterdir()) == before


def test_reading_makes_no_store(tmp_path: Path) -> None:
    assert not is_store(tmp_path)
    assert list_sessions(tmp_path) == []
    assert stored_names(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_an_empty_file_is_an_empty_store(tmp_path: Path) -> None:
    (tmp_path / "sessions.sqlite").touch()
    assert list_sessions(tmp_path) == []
    with reading(tmp_path) as rows, pytest.raises(InputError, match="none yet"):
        rows.load("any")
    make_store(tmp_path)
    assert len(list_sessions(tmp_path)) == 2
