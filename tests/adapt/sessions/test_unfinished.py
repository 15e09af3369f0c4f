"""What a killed trial leaves is removed when its session is resumed, and no file of a user ever is."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.unfinished import NOTE, note_created, remove_unfinished, unfinished
from tests.adapt.sessions.test_store import record
from tests.adapt.walking import SPEC


@pytest.fixture
def session(tmp_path: Path) -> Session:
    store = SessionStore(tmp_path / "runs")
    return store.create(SPEC)


def killed_while_recording(path: Path, *, created: bool = True) -> None:
    """Let a process end without any farewell while it writes a recording."""
    child = os.fork()
    if child == 0:
        with unfinished(path):
            path.write_bytes(b"half a walk")
            if created:
                note_created(path)
            os._exit(9)
    os.waitpid(child, 0)


@pytest.mark.parametrize("created", [True, False])
@pytest.mark.parametrize("name", ["trial-002.rrd", "trial-002-2.rrd", "baseline-demo.rrd"])
def test_the_recording_of_a_killed_trial_is_removed(
    name: str, created: bool, session: Session, tmp_path: Path
) -> None:
    killed_while_recording(tmp_path / name, created=created)
    assert remove_unfinished(tmp_path, session) == tmp_path / name
    assert not (tmp_path / name).exists()
    assert not (tmp_path / NOTE).exists()
    assert remove_unfinished(tmp_path, session) is None


def replaced(path: Path) -> None:
    path.with_name("mine").write_bytes(b"mine")
    path.with_name("mine").rename(path)


def linked(path: Path) -> None:
    path.with_name("mine").write_bytes(b"mine")
    path.unlink()
    path.symlink_to("mine")


@pytest.mark.parametrize("change", [replaced, linked])
def test_a_file_that_a_user_put_there_is_kept(
    change: Callable[[Path], None], session: Session, tmp_path: Path
) -> None:
    path = tmp_path / "trial-002.rrd"
    killed_while_recording(path)
    change(path)
    assert remove_unfinished(tmp_path, session) is None
    assert path.read_bytes() == b"mine"


def test_the_recording_of_a_trial_that_was_stored_is_kept(session: Session, tmp_path: Path) -> None:
    path = tmp_path / "trial-001.rrd"
    killed_while_recording(path)
    session.trials.append(replace(record(1), recording=str(path)))
    assert remove_unfinished(tmp_path, session) is None
    assert path.exists()


@pytest.mark.parametrize(
    "note",
    ["", "walk.rrd", "../trial-002.rrd", "trial-002.rrd x", "/trial-002.rrd 1", "lock", "x" * 1000],
)
def test_a_note_of_another_person_removes_nothing(note: str, session: Session, tmp_path: Path) -> None:
    folder = tmp_path / "runs" / session.name
    for path in (folder / "walk.rrd", folder / "trial-002.rrd", folder.parent / "trial-002.rrd"):
        path.touch()
    before = sorted(tmp_path.rglob("*.rrd"))
    (folder / NOTE).write_text(note)
    assert remove_unfinished(folder, session) is None
    assert sorted(tmp_path.rglob("*.rrd")) == before


def test_a_note_that_is_a_link_changes_no_file_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / NOTE).symlink_to("mine")
    with unfinished(tmp_path / "trial-001.rrd"):
        pass
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_session_that_was_killed_is_resumed_with_one_recording_of_each_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    spec = new_spec(failed_leg=5, prior="none", budget=2, baseline=False, duration_s=1.0)
    name = (
        Adaptation(spec).run(stop_requested=lambda: len(list(tmp_path.rglob("trial-*.rrd"))) > 1).session.name
    )
    folder = tmp_path / "runs" / name
    (folder / "trial-002.rrd").unlink(missing_ok=True)
    killed_while_recording(folder / "trial-002.rrd")
    notes: list[str] = []
    resumed = Adaptation.resume(name, note=notes.append).run()
    assert len(resumed.trials) == 2
    assert sorted(path.name for path in folder.glob("trial-*")) == ["trial-001.rrd", "trial-002.rrd"]
    assert (folder / "trial-002.rrd").stat().st_size > 10_000
    assert any("trial-002.rrd" in note for note in notes)
    assert not (folder / NOTE).exists()
