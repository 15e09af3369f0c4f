"""Targets that hexctl has kept: sessions, priors, repertoires, caches, results, recordings."""

import gzip
import io
import json
from collections.abc import Callable
from functools import cache
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
from tests.fuzz.folder import own_folder, written
from tests.fuzz.target import Target
from tests.recording.made_up import damaged_recordings
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


def _line(which: str, kind: str) -> str:
    """First line of a kind in a stored session, short."""
    text = (DATA / "sessions" / which / FILE_NAME).read_text(encoding="utf-8")
    line = json.loads(next(line for line in text.splitlines() if line.startswith(f'{{"{kind}"')))
    if kind != "session":
        line[kind]["path_m"] = line[kind]["path_m"][:2]
    if "state" in line:
        line["state"] = {"name": "random", "search": {}}
    return json.dumps(line)


def _file() -> bytes:
    """A file of a session with one walk of each kind."""
    lines = [_line("whole-bayes", kind) for kind in ("session", "baseline", "trial", "confirmation")]
    return "".join(f"{line}\n" for line in lines).encode()


def _session(data: bytes) -> None:
    """Read the file of a session, and show what is in it."""
    damage: list[str] = []
    with written("session.jsonl", data) as path:
        place = path.parent
        session = load_session(place.name, place.parent, on_damage=lambda error: damage.append(str(error)))
    assert all("\n" not in text for text in damage)
    json.dumps(session.as_json())
    session_lines(session)
    for trial in session.trials:
        _ = trial.result, trial.valid


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
        of_place = b'["%b", %b]' % (place.fingerprint.encode(), data)
        for content in (data, gzip.compress(data), gzip.compress(of_place)):
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


TARGETS = (
    Target(
        name="session",
        read=_session,
        seeds=(_file(),),
        words=(*NUMBERS, b"\n", b'{"session": ', b'{"trial": '),
        most_bytes=10_000,
        times=50,
    ),
    Target(
        name="result",
        read=_result,
        seeds=(json.dumps(json.loads(_line("whole-bayes", "trial"))["trial"]["outcome"]).encode(),),
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
    Target(
        name="recording",
        read=_of_file("recording.rrd", read_trial),
        seeds=(_recording(), *damaged_recordings()),
        words=(b"RRF2", b"FOOT"),
        most_bytes=60_000,
        times=100,
    ),
)
