"""Targets that hexctl has kept: sessions, priors, repertoires, caches, results, recordings."""

import gzip
import io
import json
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.prior.prior import open_prior
from hexctl.adapt.sessions.store import FILE_NAME, load_session
from hexctl.adapt.space import GaitSpace
from hexctl.cli.render.session_summary import session_lines
from hexctl.control.monitor.repertoire import load_repertoire
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError
from hexctl.recording.recorded_trial import read_trial
from hexctl.robot.configs import config_root
from hexctl.study.hold_walks import HoldPlace
from hexctl.study.recovery.episodes import RecoveryPlace
from hexctl.study.repertoire_walks import RepertoirePlace
from hexctl.study.walk_cache import WalkCache
from tests.fuzz.target import JSON_WORDS, own_folder, target, written
from tests.recording.made_up import damaged_recordings
from tests.study.made_up import spec

DATA = Path(__file__).parents[2] / "data"
SPACE = GaitSpace((5,))


def _archive(**arrays: Any) -> bytes:
    """An archive of numpy, not compressed."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _line(kind: str) -> str:
    """First line of a kind in a stored session, short."""
    text = (DATA / "sessions" / "whole-bayes" / FILE_NAME).read_text(encoding="utf-8")
    line = json.loads(next(line for line in text.splitlines() if line.startswith(f'{{"{kind}"')))
    if kind != "session":
        line[kind]["path_m"] = line[kind]["path_m"][:2]
    if "state" in line:
        line["state"] = {"name": "random", "search": {}}
    return json.dumps(line)


def _file() -> bytes:
    """A file of a session with one walk of each kind."""
    lines = [_line(kind) for kind in ("session", "baseline", "trial", "confirmation")]
    return "".join(f"{line}\n" for line in lines).encode()


@target(
    _file(),
    given=partial(written, "session.jsonl"),
    words=(*JSON_WORDS, b"\n", b'{"session": ', b'{"trial": '),
    times=50,
)
def read_session(path: Path) -> None:
    """Read the file of a session, and show what is in it."""
    damage: list[str] = []
    session = load_session(
        path.parent.name, path.parent.parent, on_damage=lambda error: damage.append(str(error))
    )
    assert all("\n" not in text for text in damage)
    json.dumps(session.as_json())
    session_lines(session)
    for trial in session.trials:
        _ = trial.result, trial.valid


def _searches() -> tuple[bytes, ...]:
    """States of all searches after one ask."""
    states = []
    for number, name in enumerate(OPTIMIZERS):
        search = make_optimizer(name, SPACE, 1)
        search.ask(1)
        states.append(bytes([number]) + json.dumps(search.state()).encode())
    return tuple(states)


@target(*_searches(), words=JSON_WORDS, times=50)
def read_search_state(data: bytes) -> None:
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


@target(json.dumps(json.loads(_line("trial"))["trial"]["outcome"]).encode(), words=JSON_WORDS)
def read_result(data: bytes) -> None:
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return
    result = TrialResult.from_dict(values)
    repr(result)
    _ = [str(each) for each in result.noticed]


@cache
def _asked() -> Any:
    return spec(codes=(1, 2))


def _walk_file() -> bytes:
    hold = {
        "case": {"leg": 2, "failure": "limp", "hold": "line"},
        "slots": [1],
        "status": "ok",
        "signed_m": 0.1,
    }
    gait = {"case": 5, "status": "ok", "signed_m": 0.1, "distance_m": 4.0, "path_m": [[0.1, 0.2]]}
    return json.dumps([gait, {**gait, "case": "tripod"}, hold]).encode()


@target(_walk_file(), b"[]", words=(*JSON_WORDS, b"\x1f\x8b\x08"), times=50)
def read_study_walks(data: bytes) -> None:
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
        of_place = b'["%b", %b]' % (place.fingerprint.encode(), data)
        for content in (data, gzip.compress(data), gzip.compress(of_place)):
            written(cache.path_of(place).name, content)
            cache.load(place)
    assert all("\n" not in note for note in cache.notes)


def _headed(name: str, arrays: dict[str, Any], data: bytes) -> Path:
    """Archive with good arrays and an input as head, whose first byte leaves some out."""
    out = sum(data[:1])
    kept = {key: value for at, (key, value) in enumerate(arrays.items()) if not out >> at & 1}
    return written(name, _archive(head=np.array(data[1:].decode("utf-8", "replace")), **kept))


def _head(path: str) -> dict[str, Any]:
    """Head of a shipped archive, without what is only for people."""
    with np.load(config_root() / path) as file:
        head: dict[str, Any] = json.loads(str(file["head"]))
    return {**head, "origin": {}}


def _prior_head(path: str) -> bytes:
    return b"\0" + json.dumps({**_head(path), "legs": [1]}).encode()


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


@target(
    _prior_head("priors/ant-locked-rear-30s.npz"),
    _prior_head("priors/ant-locked-none-30s-line.npz"),
    given=partial(_headed, "prior.npz", PRIOR_ARRAYS),
    words=JSON_WORDS,
    times=20,
)
def read_prior(path: Path) -> None:
    open_prior(path)


@target(
    _archive(
        head=np.array(_prior_head("priors/ant-locked-none-30s-line.npz")[1:].decode()),
        log_scores=np.zeros((1, 1, 120, 4), "f2"),
    ),
    _archive(head=np.array("{}")),
    given=partial(written, "prior.npz"),
    words=(b"PK\1\2", b"PK\3\4", b"PK\5\6", b"\x93NUMPY", b"'descr': '|O'", b"(9999999999,)"),
    times=50,
)
def read_prior_archive(path: Path) -> None:
    open_prior(path)


REPERTOIRE_ARRAYS = {"speeds": np.zeros(400, "f4"), "costs": np.zeros(400, "f4")}


@target(
    _repertoire_head(),
    given=partial(_headed, "repertoire.npz", REPERTOIRE_ARRAYS),
    words=JSON_WORDS,
    times=20,
)
def read_repertoire(path: Path) -> None:
    load_repertoire(path)


def _recording() -> bytes:
    """A recording of two ticks of all joints."""
    import rerun as rr

    from hexctl.recording import paths
    from hexctl.recording.series import VECTORS

    path = own_folder() / "seed.rrd"
    path.unlink(missing_ok=True)
    stream = rr.RecordingStream("hexctl", recording_id="seed")
    stream.save(path)
    for tick in range(2):
        stream.set_time("time", duration=0.02 * tick)
        for series in VECTORS:
            stream.log(series.path, rr.Scalars([0.1] * len(series.names)))
        stream.log(paths.EVENTS, rr.TextLog("began", level="INFO"))
    stream.flush()
    stream.disconnect()
    return path.read_bytes()


@target(
    _recording(),
    *damaged_recordings(),
    given=partial(written, "recording.rrd"),
    words=(b"RRF2", b"FOOT"),
)
def read_recording(path: Path) -> None:
    read_trial(path)
