"""Sessions on disk: durable trial by trial, safe under kills, neighbours and damage."""

import errno
import json
import math
import os
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.runner import remove_unfinished
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import (
    FILE_NAME,
    SessionStore,
    StoreError,
    delete_session,
    list_sessions,
    load_session,
    stored_names,
)
from hexctl.errors import HexctlError, InputError
from tests.adapt.walking import SPEC, record, result_of


def test_a_session_comes_back_as_it_was(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    for index in (1, 2, 3):
        store.add(session, record(index), {"after": index})
    store = SessionStore(tmp_path)
    again = load_session(session.name, store.folder)
    assert again == session
    assert again.optimizer_state == {"after": 3}


@pytest.mark.parametrize("value", [np.int64(3), Path("state"), {1, 2}], ids=repr)
def test_a_state_that_cannot_be_stored_as_it_is_is_refused_at_once(value: object, tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    with pytest.raises(TypeError, match="JSON"):
        store.add(session, record(1), {"particles": [value]})
    assert session.trials == load_session(session.name, tmp_path).trials == []
    store.add(session, record(1), {"particles": [1.5]})
    assert load_session(session.name, tmp_path) == session


def test_sessions_are_listed_newest_last_and_names_never_collide(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    names = [store.create(SPEC).name for _ in range(12)]
    assert stored_names(store.folder) == names
    assert len(set(names)) == 12


def test_the_same_trial_is_not_kept_twice(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    twin = load_session(session.name, store.folder)
    store.add(session, record(1), {})
    with pytest.raises(StoreError, match="trial 1 cannot be stored"):
        store.add(twin, record(1), {})
    assert twin.trials == []
    assert len(load_session(session.name, store.folder).trials) == 1


def test_a_session_is_held_by_one_process_at_a_time(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    other = SessionStore(tmp_path)
    name = store.create(SPEC).name
    with store.locked(name), pytest.raises(InputError, match="another process"):
        other.locked(name).__enter__()
    with other.locked(name):
        pass
    with pytest.raises(InputError, match="session"):
        store.locked("unknown").__enter__()
    assert not (tmp_path / "unknown").exists()


def test_a_new_session_is_held_before_another_process_can_find_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if another process tried to delete it whenever something reaches the disk."""
    refused: list[str] = []

    def sync_among_others(_file: int) -> None:
        for name in stored_names(tmp_path):
            with pytest.raises(InputError, match="another process"):
                delete_session(name, tmp_path)
            refused.append(name)

    monkeypatch.setattr(os, "fsync", sync_among_others)
    store = SessionStore(tmp_path)
    with ExitStack() as stack:
        session = store.create(SPEC, stack)
        assert refused == [session.name] * len(refused) != []
        store.add(session, record(1), {})
        store.keep(session)
        with pytest.raises(InputError, match="another process"):
            SessionStore(tmp_path).locked(session.name).__enter__()
    monkeypatch.undo()
    assert load_session(session.name, tmp_path) == session
    delete_session(session.name, tmp_path)


def test_a_session_of_an_optimizer_of_ones_own_has_a_name_that_every_tool_takes(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    name = store.create(SessionSpec(failed_leg=5, optimizer="my.search:Nearest")).name
    assert name.endswith("-leg5-my.search-Nearest")
    assert load_session(name, store.folder).spec.optimizer == "my.search:Nearest"


def test_a_session_that_is_moved_or_replaced_meanwhile_takes_nothing_more(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    store = SessionStore(runs)
    session = store.create(SPEC)
    store.add(session, record(1), {"after": 1})
    shutil.move(runs, tmp_path / "moved")
    with pytest.raises(StoreError):
        store.add(session, record(2), {"after": 2})
    (runs / session.name).mkdir(parents=True)
    (runs / session.name / FILE_NAME).write_text("{}\n")
    with pytest.raises(StoreError):
        store.keep(session)
    (kept,) = list_sessions(tmp_path / "moved")
    assert kept.trials == [record(1)]


def make_sessions(folder: Path, sessions: int = 2, trials: int = 3) -> list[str]:
    """Sessions of some trials; their names, newest last."""
    store = SessionStore(folder)
    for _ in range(sessions):
        session = store.create(SPEC)
        store.keep(session)
        for index in range(1, trials + 1):
            store.add(session, record(index), {"after": index})
    return stored_names(folder)


#: Where the trials of `make_sessions` begin in a file.
FIRST = 2


def lines_of(folder: Path, name: str) -> list[str]:
    return (folder / name / FILE_NAME).read_text().splitlines(keepends=True)


def test_a_session_cut_off_at_any_byte_has_what_was_stored_before_and_goes_on(tmp_path: Path) -> None:
    """As if killed, or without power, at any moment of a write."""
    (name,) = make_sessions(tmp_path, sessions=1)
    path = tmp_path / name / FILE_NAME
    content = path.read_bytes()
    begin = len(content) - len(lines_of(tmp_path, name)[-1])
    end = len(content)
    for size in (*range(begin, begin + 20), *range(begin + 20, end - 20, 13), *range(end - 20, end)):
        path.write_bytes(content[:size])
        told: list[HexctlError] = []
        (session,) = list_sessions(tmp_path, on_damage=told.append)
        assert (len(session.trials), session.optimizer_state) == (2, {"after": 2})
        assert ["cut off" in str(error) for error in told] == [True] * (size > begin)
        SessionStore(tmp_path).add(session, record(3), {"after": 3})
        assert path.read_bytes() == content


def changed(line: str, **parts: Any) -> str:
    """A line with other values, by paths such as `trial.outcome.status`."""
    values = json.loads(line)
    for place, value in parts.items():
        *path, last = place.split("__")
        inner = values
        for key in path:
            inner = inner[key]
        inner[last] = value
    return json.dumps(values) + "\n"


#: Lines that are no trial 2, by what is wrong with them.
BAD_LINES: dict[str, Callable[[str], str]] = {
    "cut off": lambda line: line[:60] + "\n",
    "null": lambda _: '{"trial": null, "state": 1}\n',
    "nested without end": lambda _: '{"trial":' * 20_000 + "\n",
    "another kind": lambda _: '{"wings": 2}\n',
    "an earlier trial": lambda line: changed(line, trial__index=1),
    "no score": lambda line: changed(line, trial__score=None),
    "a score of NaN": lambda line: changed(line, trial__score=math.nan),
    "another gait": lambda line: changed(line, trial__code=3),
    "unknown keys": lambda line: changed(line, trial__wings=2),
    "no outcome": lambda line: changed(line, trial__outcome={}),
    "a distance in words": lambda line: changed(line, trial__outcome__distance_m="far"),
    "a path of one": lambda line: changed(line, trial__path_m=[[1.0]]),
    "a number of 400 digits": lambda line: line.replace('"score": ', '"score": 1e400, "old": '),
    "a number of 5000 digits": lambda line: line.replace('"index": 2', '"index": 1' + "0" * 5000),
    "an expectation of nothing": lambda line: changed(line, trial__expected={}),
}


@pytest.mark.parametrize(("left", "ended"), [([1], "target"), ([0], None)])
def test_a_target_whose_trial_is_damaged_has_not_ended_the_search(
    left: list[int], ended: str | None, tmp_path: Path
) -> None:
    store = SessionStore(tmp_path)
    session = store.create(replace(SPEC, target_m=0.025))
    for index, end_m in enumerate((0.2, 0.01), start=1):
        store.add(session, record(index, end_m), {})
    session.ended = "target"
    store.keep(session)
    path = tmp_path / session.name / FILE_NAME
    head, *trials, end = path.read_text().splitlines(keepends=True)
    path.write_text("".join([head, *(trials[index] if index in left else "{\n" for index in (0, 1)), end]))
    assert load_session(session.name, tmp_path).ended == ended


@pytest.mark.parametrize("spoil", BAD_LINES.values(), ids=list(BAD_LINES))
def test_a_damaged_line_costs_that_line_alone(spoil: Callable[[str], str], tmp_path: Path) -> None:
    bad, good = make_sessions(tmp_path)
    lines = lines_of(tmp_path, bad)
    lines[FIRST + 1] = spoil(lines[FIRST + 1])
    (tmp_path / bad / FILE_NAME).write_text("".join(lines))
    told: list[HexctlError] = []
    sessions = list_sessions(tmp_path, on_damage=told.append)
    assert [session.name for session in sessions] == [bad, good]
    assert [trial.index for trial in sessions[0].trials] == [1, 3]
    assert sessions[0].optimizer_state == {"after": 3}
    (error,) = told
    assert bad in str(error)
    assert str(FIRST + 2) in str(error)
    assert len(str(error)) < 1000
    sessions[0].as_json()
    SessionStore(tmp_path).add(sessions[0], record(4), {"after": 4})
    assert len(load_session(bad, tmp_path).trials) == 3


def test_a_damaged_first_line_costs_nothing_where_the_search_had_begun(tmp_path: Path) -> None:
    (name,) = make_sessions(tmp_path, sessions=1)
    whole = load_session(name, tmp_path)
    lines = lines_of(tmp_path, name)
    lines[0] = "\0" * 50 + "\n"
    (tmp_path / name / FILE_NAME).write_text("".join(lines))
    told: list[HexctlError] = []
    assert load_session(name, tmp_path, on_damage=told.append) == whole
    assert len(told) == 1


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _link(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def _without_seed(path: Path) -> None:
    """An option is missing, whose default may have changed since."""
    path.write_text(path.read_text().replace(f'"seed": {SPEC.seed}, ', ""))


def _with_spec(**values: Any) -> Callable[[Path], object]:
    """Other values in both lines of the spec."""

    def spoil(path: Path) -> None:
        lines = path.read_text().splitlines(keepends=True)
        spec = json.loads(lines[0])["session"]["spec"] | values
        lines[:FIRST] = [changed(lines[0], session__spec=spec)] * FIRST
        path.write_text("".join(lines))

    return spoil


BAD_FILES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("my diary, not a session\n" * 50),
    "zeros": lambda path: path.write_bytes(bytes(100_000)),
    "a folder": _folder,
    "a pipe": _pipe,
    "a link": _link,
    "no seed": _without_seed,
    "a duration of NaN": _with_spec(duration_s=math.nan),
    "leg 7": _with_spec(failure=[{"leg": 7}]),
    "no leg": _with_spec(failure=[]),
    "no budget": _with_spec(budget=0),
    "a list for a robot": _with_spec(robot=[]),
}


@pytest.mark.parametrize("spoil", BAD_FILES.values(), ids=list(BAD_FILES))
def test_a_file_that_is_no_session_costs_no_other(spoil: Callable[[Path], object], tmp_path: Path) -> None:
    bad, good = make_sessions(tmp_path)
    spoil(tmp_path / bad / FILE_NAME)
    told: list[HexctlError] = []
    assert [session.name for session in list_sessions(tmp_path, on_damage=told.append)] == [good]
    (error,) = told
    assert bad in str(error)
    assert "\n" not in str(error)
    with pytest.raises(StoreError, match=bad):
        load_session(bad, tmp_path)
    delete_session(bad, tmp_path)
    assert stored_names(tmp_path) == [good]
    assert not (tmp_path / bad).exists()


@pytest.mark.parametrize("name", ["my walk", "été", "-x", "a*b", "[red]", "x" * 255])
def test_a_session_whose_folder_was_renamed_goes_by_its_new_name(name: str, tmp_path: Path) -> None:
    (made,) = make_sessions(tmp_path, sessions=1)
    (tmp_path / made).rename(tmp_path / name)
    (tmp_path / name / "trial-001.rrd").touch()
    assert stored_names(tmp_path) == [name]
    session = load_session(name, tmp_path)
    store = SessionStore(tmp_path)
    with store.locked(name):
        store.add(session, record(4), {})
    delete_session(name, tmp_path)
    assert stored_names(tmp_path) == []
    assert (tmp_path / name / "trial-001.rrd").exists(), "a folder that hexctl has not made"


@pytest.mark.parametrize("name", [b"caf\xe9", b"a\nb", b"a\\b"])
def test_a_name_that_cannot_be_typed_is_reported(name: bytes, tmp_path: Path) -> None:
    other, good = make_sessions(tmp_path)
    os.rename(os.fsencode(tmp_path / other), os.fsencode(tmp_path) + b"/" + name)
    told: list[HexctlError] = []
    assert [session.name for session in list_sessions(tmp_path, on_damage=told.append)] == [good]
    assert len(told) == 1
    assert "\n" not in str(told[0])
    assert stored_names(tmp_path) == [good]


@pytest.mark.parametrize("name", ["../evil", "/tmp/evil", "..", ".", "", "a\\b", "x" * 300, "a\nb"])  # noqa: S108
def test_a_name_leads_nowhere_else(name: str, tmp_path: Path) -> None:
    runs, evil = tmp_path / "runs", tmp_path / "evil"
    make_sessions(runs)
    evil.mkdir()
    shutil.copy(runs / stored_names(runs)[0] / FILE_NAME, evil)
    for act in (load_session, delete_session):
        with pytest.raises(InputError):
            act(name, runs)
    assert (evil / FILE_NAME).is_file()


def test_deleting_follows_no_link(tmp_path: Path) -> None:
    outside, runs = tmp_path / "outside", tmp_path / "runs"
    linked, inner = make_sessions(runs)
    (runs / linked).rename(outside)
    (outside / "precious").touch()
    (runs / linked).symlink_to(outside)
    (runs / inner / "away").symlink_to(outside)
    for name in (linked, inner):
        delete_session(name, runs)
    assert sorted(path.name for path in outside.iterdir()) == ["precious", FILE_NAME]
    assert list(runs.iterdir()) == []


def test_a_write_that_fails_leaves_the_session_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "no space left")))
        with pytest.raises(StoreError, match="no space left"):
            store.add(session, record(1), {"after": 1})
    assert session.trials == load_session(session.name, tmp_path).trials == []
    store.add(session, record(1), {"after": 1})
    assert load_session(session.name, tmp_path) == session


def test_a_disk_that_takes_a_few_bytes_at_a_time_gets_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, write = SessionStore(tmp_path), os.write
    session = store.create(SPEC)
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:7]))
    store.add(session, record(1), {"after": 1})
    assert load_session(session.name, tmp_path) == session


def test_only_the_recording_of_the_walk_that_is_repeated_is_removed(tmp_path: Path) -> None:
    session = Session(name="s", spec=replace(SPEC, baseline_gaits=["demo"]), created="now")
    names = ("trial-001", "trial-002", "trial-002-2", "trial-003", "baseline-demo", "my-trial-002", "trial-2")
    for name in names:
        (tmp_path / f"{name}.rrd").touch()
    session.trials = [replace(record(1), recording="elsewhere/trial-001.rrd")]
    removed = remove_unfinished(tmp_path, session)
    assert [path.stem for path in removed] == ["trial-002-2", "trial-002"]
    assert {path.stem for path in tmp_path.iterdir()} == {*names} - {"trial-002-2", "trial-002"}
    session.trials = []
    assert [path.stem for path in remove_unfinished(tmp_path, session)] == ["baseline-demo", "trial-001"]
    link = tmp_path / "trial-001.rrd"
    link.symlink_to("my-trial-002.rrd")
    assert remove_unfinished(tmp_path, session) == []
    assert link.is_symlink(), "a user put it there"


@pytest.mark.slow
def test_a_session_that_was_killed_is_resumed_with_one_recording_of_each_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    spec = new_spec(failed_leg=5, prior="none", trim="off", budget=2, baseline=False, duration_s=1.0)
    name = (
        Adaptation(spec).run(stop_requested=lambda: len(list(tmp_path.rglob("trial-*.rrd"))) > 1).session.name
    )
    folder = tmp_path / "runs" / name
    (folder / "trial-002.rrd").write_bytes(b"half a walk")
    notes: list[str] = []
    resumed = Adaptation.resume(name, note=notes.append).run()
    assert len(resumed.trials) == 2
    assert sorted(path.name for path in folder.glob("trial-*")) == ["trial-001.rrd", "trial-002.rrd"]
    assert (folder / "trial-002.rrd").stat().st_size > 10_000
    assert any("trial-002.rrd" in note for note in notes)


def test_reading_makes_nothing(tmp_path: Path) -> None:
    assert list_sessions(tmp_path) == list_sessions(tmp_path / "none") == []
    assert stored_names(tmp_path) == stored_names(tmp_path / "none") == []
    with pytest.raises(InputError):
        load_session("any", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_stored_trial_gives_its_result_again(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    session = store.create(SPEC)
    store.add(session, record(1), {})
    lost = replace(record(2), path_m=[[math.nan, math.nan], [4.0, 0.2]])
    store.add(session, lost, {})
    trial, unknown = load_session(session.name, store.folder).trials
    assert repr(unknown.path_m) == repr(lost.path_m), "a pose that was not known"
    assert trial.result.to_dict() == trial.outcome
    assert (trial.result.status, trial.result.deviation) == ("ok", result_of(0.2).deviation)
    assert trial.result.path_m[-1].tolist() == pytest.approx([4.0, 0.2])


def test_milestones_and_best() -> None:
    session = Session(name="s", spec=SPEC, created="now")
    for index, deviation in enumerate((0.4, -0.09, 0.3, 0.02, -0.01), start=1):
        session.trials.append(record(index, deviation))
    values = json.loads(json.dumps(session.as_json()))
    assert (values["trials_to_0.10_m"], values["trials_to_0.025_m"]) == (2, 4)
    assert values["best"]["index"] == 5
