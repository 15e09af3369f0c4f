"""Targets that hexctl has kept: sessions, priors, repertoires, caches, results, recordings."""

import gzip
import io
import json
import sqlite3
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.prior.prior import open_prior
from hexctl.adapt.sessions.stored import stored_session
from hexctl.adapt.sessions.stored_rows import FILE_NAME, reading
from hexctl.adapt.space import GaitSpace
from hexctl.control.monitor.repertoire_store import load_repertoire
from hexctl.control.trial_result import TrialResult
from hexctl.errors import HexctlError, InputError
from hexctl.recording.recorded_trial import read_trial
from hexctl.robot.configs import config_root
from hexctl.study.holds.hold_walks import HoldPlace
from hexctl.study.recovery.episodes import RecoveryPlace
from hexctl.study.repertoire.repertoire_walks import RepertoirePlace
from hexctl.study.walk_cache import WalkCache
from tests.fuzz.folder import own_folder, written
from tests.fuzz.target import Target
from tests.study.made_up import spec

DATA = Path(__file__).parents[2] / "data"
NUMBERS = (
    b"NaN",
    b"-Infinity",
    b"1e400",
    b"9" * 400,
    b"-1",
    b"null",
    b"true",
    b"[]",
    b"{}",
    b'""',
    b"[" * 50,
)
SPACE = GaitSpace((5,))


def _archive(**arrays: Any) -> bytes:
    """An archive of numpy, not compressed."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _headed(name: str, load: Callable[[Path], object], arrays: dict[str, Any]) -> Callable[[bytes], object]:
    """A reader of archives with good arrays and an input as head, whose first byte leaves some out."""

    def read(data: bytes) -> None:
        out = sum(data[:1])
        kept = {key: value for at, (key, value) in enumerate(arrays.items()) if not out >> at & 1}
        archive = _archive(head=np.array(data[1:].decode("utf-8", "replace")), **kept)
        with written(name, archive) as path:
            load(path)

    return read


def _of_file(name: str, load: Callable[[Path], object]) -> Callable[[bytes], object]:
    def read(data: bytes) -> None:
        with written(name, data) as path:
            load(path)

    return read


@cache
def _stored() -> sqlite3.Connection:
    return sqlite3.connect(
        f"{(DATA / FILE_NAME).as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
    )


def _rows(which: str = "whole-bayes") -> tuple[str, ...]:
    """A stored session with one trial, as `_session` reads it."""
    head = _stored().execute("SELECT created, spec, ended FROM sessions WHERE name = ?", (which,)).fetchone()
    record, state = (
        _stored()
        .execute("SELECT record, optimizer_state FROM trials WHERE session = ? AND number = 1", (which,))
        .fetchone()
    )
    trial = json.loads(record)
    trial["path_m"] = trial["path_m"][:2]
    short = json.dumps({"name": "random", "search": {}}) if len(state) > 1000 else state
    settled = json.dumps({"code": 5, "chance": 0.5, "target_m": 0.1})
    return which, head[0], head[1], head[2] or "", settled, json.dumps(trial), short, json.dumps(trial)


def _session(data: bytes) -> None:
    """Make a session of lines: name, created, spec, why ended, settled, record, state and baseline."""
    lines: list[Any] = [line or None for line in data.decode("utf-8", "backslashreplace").split("\n")]
    name, created, about, ended, settled, record, state, baseline = (*lines, *([None] * 8))[:8]
    trials = [] if record is None else [(1, record, state)]
    session = stored_session(
        name or "", (created, about, ended, settled), trials, [] if baseline is None else [baseline]
    )
    json.dumps(session.as_json())
    for trial in session.trials:
        _ = trial.result, trial.valid


def _database(data: bytes) -> None:
    damage: list[str] = []
    with written(FILE_NAME, data) as path, reading(path.parent) as rows:
        for name in rows.names():
            with suppress(HexctlError):
                rows.load(name)
        rows.sessions(lambda error: damage.append(str(error)))


def _state(data: bytes) -> None:
    """Restore a search of the first byte; one that refuses is as it was."""
    name = list(OPTIMIZERS)[sum(data[:1]) % len(OPTIMIZERS)]
    try:
        state = json.loads(data[1:])
    except (ValueError, RecursionError):
        return
    if not isinstance(state, dict):  # as sessions refuse it
        return
    search = make_optimizer(name, SPACE, 1)
    before = search.state()
    try:
        search.restore(state)
    except InputError:
        assert search.state() == before
        raise
    json.dumps(search.state())


def _result(data: bytes) -> None:
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return
    result = TrialResult.from_dict(values)
    repr(result)
    _ = [str(each) for each in result.noticed]


def _study_walks(data: bytes) -> None:
    """Load what studies have walked: a file that is not usable is reported, and computed again."""
    world = {"robot": _asked().robot, "world": _asked().world, "family": "real", "number": 1, "kind": "plain"}
    places: list[Any] = [
        _asked(),
        HoldPlace(**world),
        RecoveryPlace(**world, protocol="line", duration_s=30.0),
        RepertoirePlace(**world),
    ]
    cache = WalkCache(own_folder())
    for place in places:
        for content in (data, gzip.compress(data)):
            with written(cache.path_of(place).name, content):
                cache.load(place)
    assert all("\n" not in note for note in cache.notes)


@cache
def _asked() -> Any:
    return spec(codes=(1, 2))


def _head(path: str) -> dict[str, Any]:
    """Head of a shipped archive, without what is only for people."""
    with np.load(config_root() / path) as file:
        head: dict[str, Any] = json.loads(str(file["head"]))
    return {**head, "origin": {}}


def _prior_head(path: str, legs: int = 1) -> bytes:
    return b"\0" + json.dumps({**_head(path), "legs": list(range(1, legs + 1))}).encode()


def _repertoire_head() -> bytes:
    head = _head("repertoires/ant.npz")
    head["symmetries"], head["situations"] = head["symmetries"][:1], head["situations"][:1]
    return b"\0" + json.dumps(head).encode()


PRIOR_ARRAYS = {
    "signed_m": np.zeros((1, 1, 120, 10), "f2"),
    "progress_m": np.zeros((1, 1, 120, 10), "f2"),
    "yaw_rad": np.zeros((1, 1, 120), "f2"),
    "sag_rad": np.zeros((1, 1, 18), "f2"),
    "log_scores": np.zeros((1, 1, 120, 4), "f4"),
    "valid": np.ones((1, 1, 120), "u1"),
}
REPERTOIRE_ARRAYS = {"speeds": np.zeros(400, "f4"), "costs": np.zeros(400, "f4")}


def _small_store() -> bytes:
    """A store with small pages and one session."""
    name, created, about, ended, settled, record, state, baseline = _rows()
    path = own_folder() / "seed.sqlite"
    path.unlink(missing_ok=True)
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA page_size = 512")
    connection.executescript(
        "CREATE TABLE sessions (name TEXT PRIMARY KEY, created TEXT, spec TEXT, ended TEXT, settled_on TEXT);"
        "CREATE TABLE trials (session TEXT, number INTEGER, record TEXT, optimizer_state TEXT,"
        " PRIMARY KEY (session, number));"
        "CREATE TABLE baselines (session TEXT, gait TEXT, record TEXT, PRIMARY KEY (session, gait));"
        "CREATE TABLE confirmations (session TEXT, slots TEXT, record TEXT, PRIMARY KEY (session, slots));"
        "PRAGMA user_version = 1"
    )
    connection.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", (name, created, about, ended, settled))
    connection.execute("INSERT INTO trials VALUES (?, 1, ?, ?)", (name, record, state))
    connection.execute("INSERT INTO baselines VALUES (?, 'demo', ?)", (name, baseline))
    connection.close()
    return path.read_bytes()


def _recording() -> bytes:
    """A recording of two ticks of all joints."""
    import rerun as rr

    from hexctl.recording import paths
    from hexctl.types import JOINT_KINDS

    path = own_folder() / "seed.rrd"
    path.unlink(missing_ok=True)
    stream = rr.RecordingStream("hexctl", recording_id="seed")
    stream.save(path)
    for tick in range(2):
        stream.set_time("time", duration=0.02 * tick)
        for leg in paths.LEGS:
            for kind in JOINT_KINDS:
                stream.log(paths.link_path(leg, kind), rr.Scalars([0.0, 0.1]))
        stream.log(paths.EVENTS, rr.TextLog("began", level="INFO"))
    stream.flush()
    stream.disconnect()
    return path.read_bytes()


def _searches() -> tuple[bytes, ...]:
    """States of all searches after one ask."""
    states = []
    for number, name in enumerate(OPTIMIZERS):
        search = make_optimizer(name, SPACE, 1)
        search.ask(1)
        states.append(bytes([number]) + json.dumps(search.state()).encode())
    return tuple(states)


def _walk_file() -> bytes:
    hold = {
        "case": {"leg": 2, "failure": "limp", "hold": "line"},
        "slots": [1],
        "status": "ok",
        "signed_m": 0.1,
    }
    gait = {"case": 5, "status": "ok", "signed_m": 0.1, "distance_m": 4.0, "path_m": [[0.1, 0.2]]}
    return json.dumps([gait, {**gait, "case": "tripod"}, hold]).encode()


ROWS = "\n".join(_rows()).encode()

TARGETS = (
    Target(
        name="session",
        read=_session,
        seeds=(ROWS,),
        refusals=(ValueError,),
        words=NUMBERS,
        most_bytes=5000,
        times=50,
    ),
    Target(
        name="session-store",
        read=_database,
        seeds=(_small_store(),),
        words=(b"SQLite format 3\0", b"\xff" * 4),
        most_bytes=30_000,
        times=10,
    ),
    Target(
        name="result",
        read=_result,
        seeds=(_rows()[5].encode(), json.dumps(json.loads(_rows()[5])["outcome"]).encode()),
        words=NUMBERS,
        most_bytes=2000,
    ),
    Target(name="search-state", read=_state, seeds=_searches(), words=NUMBERS, most_bytes=6000, times=50),
    Target(
        name="prior",
        read=_headed("prior.npz", open_prior, PRIOR_ARRAYS),
        seeds=(
            _prior_head("priors/ant-locked-rear-30s.npz"),
            _prior_head("priors/ant-locked-none-30s-line.npz"),
        ),
        words=NUMBERS,
        most_bytes=1500,
        times=20,
    ),
    Target(
        name="prior-archive",
        read=_of_file("prior.npz", open_prior),
        seeds=(
            _archive(
                head=np.array(_prior_head("priors/ant-locked-none-30s-line.npz")[1:].decode()),
                log_scores=np.zeros((1, 1, 120, 4), "f2"),
            ),
            _archive(head=np.array("{}")),
        ),
        words=(b"PK\1\2", b"PK\3\4", b"PK\5\6", b"\x93NUMPY", b"'descr': '|O'", b"(9999999999,)"),
        most_bytes=8000,
        times=50,
    ),
    Target(
        name="repertoire",
        read=_headed("repertoire.npz", load_repertoire, REPERTOIRE_ARRAYS),
        seeds=(_repertoire_head(),),
        words=NUMBERS,
        most_bytes=3000,
        times=20,
    ),
    Target(
        name="study-walks",
        read=_study_walks,
        seeds=(_walk_file(), b"[]"),
        words=(*NUMBERS, b"\x1f\x8b\x08"),
        most_bytes=1000,
        times=50,
    ),
    # No spoiled ones in tests: Rerun's reader ends the process on some, as README.md says.
    Target(
        name="recording",
        read=_of_file("recording.rrd", read_trial),
        seeds=(_recording(),),
        words=(b"RRF2", b"FOOT"),
        most_bytes=60_000,
        times=10,
    ),
)
