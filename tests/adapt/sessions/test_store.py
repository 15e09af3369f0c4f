"""Sessions on disk: durable trial by trial, safe under kills and neighbours."""

import json
import multiprocessing
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.sessions.search_session import Session, SessionSpec, TrialRecord
from hexctl.adapt.sessions.store import SessionStore, list_sessions
from hexctl.adapt.sessions.stored_rows import StoreError
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError
from tests.adapt.walking import SPEC, result_of

PATIENCE_S = 60.0

SPACE = GaitSpace((SPEC.failed_leg,))


def record(index: int, deviation_m: float = 0.2) -> TrialRecord:
    result, code = result_of(deviation_m), (index - 1) % SPACE.size + 1
    return TrialRecord(
        index=index,
        code=code,
        slots=SPACE.slots_of(code),
        score=OBJECTIVES["final"](result),
        outcome=result.to_dict(),
        path_m=result.path_m[::10].tolist(),
        recording=None,
    )


def test_a_session_comes_back_as_it_was(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        session = store.create(SPEC)
        for index in (1, 2, 3):
            store.add_trial(session, record(index), {"after": index})
    with SessionStore(tmp_path) as store:
        again = store.load(session.name)
    assert again == session
    assert again.optimizer_state == {"after": 3}


def test_sessions_are_listed_newest_last_and_names_never_collide(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        names = [store.create(SPEC).name for _ in range(4)]
        assert store.names() == names
        assert len(set(names)) == 4


def test_an_unknown_name_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        name = store.create(SPEC).name
        with pytest.raises(InputError, match=name):
            store.load("nobody")


def test_the_same_trial_is_not_kept_twice(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        session = store.create(SPEC)
        twin = store.load(session.name)
        store.add_trial(session, record(1), {})
        with pytest.raises(StoreError, match="trial 1 cannot be stored"):
            store.add_trial(twin, record(1), {})
        assert twin.trials == []
        assert len(store.load(session.name).trials) == 1


def test_deleting_takes_the_trials_along(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        session = store.create(SPEC)
        store.add_trial(session, record(1), {})
        store.delete(session.name)
        assert store.names() == []
    with sqlite3.connect(tmp_path / "sessions.sqlite") as connection:
        assert connection.execute("SELECT count(*) FROM trials").fetchone() == (0,)


def test_a_session_is_held_by_one_process_at_a_time(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store, SessionStore(tmp_path) as other:
        name = store.create(SPEC).name
        with store.held(name), pytest.raises(InputError, match="another process"), other.held(name):
            pass
        with other.held(name):
            pass
        with pytest.raises(InputError, match="session: got 'unknown'"):
            store.held("unknown").__enter__()
    assert not (tmp_path / "unknown").exists()


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to look at" * 20])
def test_a_file_that_is_no_store_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "sessions.sqlite").write_bytes(content)
    with pytest.raises(StoreError, match=r"sessions\.sqlite is damaged"):
        SessionStore(tmp_path)


def test_a_store_of_another_version_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "sessions.sqlite") as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(StoreError, match="version 99"):
        SessionStore(tmp_path)


def _write_sessions(folder: str, count: int) -> None:
    with SessionStore(Path(folder)) as store:
        session = store.create(SPEC)
        for index in range(1, count + 1):
            store.add_trial(session, record(index), {"after": index})


def test_two_processes_on_one_store(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_write_sessions, args=(str(tmp_path), 30)) for _ in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(PATIENCE_S)
        assert writer.exitcode == 0
    with SessionStore(tmp_path) as store:
        assert [len(store.load(name).trials) for name in store.names()] == [30, 30]
    with sqlite3.connect(tmp_path / "sessions.sqlite") as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


KILLED = """
import sys
from pathlib import Path
from hexctl.adapt.sessions.store import SessionStore
from tests.adapt.sessions.test_store import SPEC, record
with SessionStore(Path(sys.argv[1])) as store:
    session = store.create(SPEC)
    for index in range(1, 100_000):
        store.add_trial(session, record(index), {"after": index})
        print(index, flush=True)
"""


def test_kill_9_loses_nothing_that_was_kept(tmp_path: Path) -> None:
    """Every trial that the writer reported before it was killed is there, and the state belongs to it."""
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
    )
    try:
        assert process.stdout is not None
        reported = 0
        deadline_s = time.monotonic() + PATIENCE_S
        while reported < 20:
            assert time.monotonic() < deadline_s
            reported = int(process.stdout.readline())
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read().split()
        reported = int(rest[-1]) if rest else reported
    finally:
        process.kill()
        process.wait()
    with SessionStore(tmp_path) as store:
        (name,) = store.names()
        session = store.load(name)
        assert len(session.trials) in (reported, reported + 1)
        assert session.optimizer_state == {"after": len(session.trials)}
        with store.held(name):
            store.add_trial(session, record(len(session.trials) + 1), {"after": 0})


def test_milestones_and_best() -> None:
    session = Session(name="s", spec=SPEC, created="now")
    for index, deviation in enumerate((0.4, -0.09, 0.3, 0.02, -0.01), start=1):
        session.trials.append(record(index, deviation))
    values = json.loads(json.dumps(session.as_json()))
    assert (values["trials_to_0.10_m"], values["trials_to_0.025_m"]) == (2, 4)
    assert values["best"]["index"] == 5


def test_a_stored_trial_gives_its_result_again(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        session = store.create(SPEC)
        store.add_trial(session, record(1), {})
        (trial,) = store.load(session.name).trials
    assert trial.result.to_dict() == trial.outcome
    assert (trial.result.status, trial.result.deviation) == ("ok", result_of(0.2).deviation)
    assert trial.result.path_m[-1].tolist() == pytest.approx([4.0, 0.2])


def test_a_session_of_an_optimizer_of_ones_own_has_a_name_that_every_tool_takes(tmp_path: Path) -> None:
    with SessionStore(tmp_path) as store:
        name = store.create(SessionSpec(optimizer="my.search:Nearest")).name
        assert name.endswith("-leg5-my.search-Nearest")
        assert store.load(name).spec.optimizer == "my.search:Nearest"


def test_a_store_that_is_deleted_or_replaced_meanwhile_takes_nothing_more(tmp_path: Path) -> None:
    """SQLite goes on writing to a file without a name, and everything is lost when it is closed."""
    runs = tmp_path / "runs"
    with SessionStore(runs) as store:
        session = store.create(SPEC)
        store.add_trial(session, record(1), {})
        shutil.move(runs, tmp_path / "moved")
        with pytest.raises(StoreError, match="deleted or moved"):
            store.add_trial(session, record(2), {})
        SessionStore(runs).close()
        with pytest.raises(StoreError, match="deleted or moved"):
            store.keep(session)
    assert list_sessions(runs) == []
    (kept,) = list_sessions(tmp_path / "moved")
    assert kept.trials[0] == record(1)
