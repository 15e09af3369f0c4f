"""A stop on the disk: what is found after a restart, whatever has become of the file."""

from pathlib import Path

import pytest

from hexctl.control.guard import Guard
from hexctl.serve.stops.latch import StopLatch
from hexctl.serve.stops.stop import HOLD_S
from hexctl.serve.stops.stop_file import StopFile, state_folder
from hexctl.waiting import comes_true
from tests.control.posed import connected


def begun(folder: Path, *, asked_only: bool = False) -> tuple[Guard, StopLatch, StopFile]:
    """A server's stop, as after a start."""
    guard = connected()[0]
    file = StopFile("ant", "/dev/ttyACM0", folder=folder, asked_only=asked_only)
    return guard, StopLatch(guard, file), file


@pytest.mark.parametrize("reason", ["estop", "fell", "fault: low battery 9.5 V", "state", "pose lost"])
def test_a_stop_is_there_after_a_restart_with_its_id_until_it_is_cleared(tmp_path: Path, reason: str) -> None:
    guard, latch, file = begun(tmp_path / "state")
    assert guard.stopped is None
    assert file.warnings == ()
    guard.stop(reason)
    stop = latch.current()
    assert stop is not None
    assert comes_true(lambda: file.keeps(stop), 10.0)
    status = latch.status()
    assert status is not None
    assert status["kept"] is True

    guard, latch, file = begun(tmp_path / "state")  # as after a kill: nobody closed the first
    assert guard.stopped == reason
    again = latch.current()
    assert again is not None
    assert (again.stop_id, again.reason) == (stop.stop_id, reason)
    assert f"still stopped ({reason}, 20" in file.warnings[0]
    assert "after the stop" in str(latch.clear(again.stop_id, again.since_s)), "it is held again"
    assert latch.clear(again.stop_id, again.since_s + HOLD_S) is None
    latch.close()

    guard, latch, file = begun(tmp_path / "state")
    assert guard.stopped is None
    assert list((tmp_path / "state").iterdir()) == []


def test_silence_is_not_kept(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path)
    guard.stop("expired")
    assert latch.current() is not None
    latch.close()
    assert list(tmp_path.iterdir()) == []


def test_of_a_simulation_only_what_somebody_asked_for_is_kept(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path, asked_only=True)
    guard.stop("fell")
    assert latch.current() is not None
    latch.close()
    assert begun(tmp_path, asked_only=True)[0].stopped is None
    _, latch, _ = begun(tmp_path, asked_only=True)
    latch.stop()
    latch.close()
    assert begun(tmp_path, asked_only=True)[0].stopped == "estop"


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"\xff\xfe", b'{"version": 2}', b"x" * 100_000, b'{"version": 1, "reason": ""}']
)
def test_a_file_that_cannot_be_read_is_a_stop(tmp_path: Path, content: bytes) -> None:
    _, latch, file = begun(tmp_path)
    latch.stop()
    latch.close()
    file.path.write_bytes(content)
    guard, latch, file = begun(tmp_path)
    assert guard.stopped == "estop"
    assert "cannot be read" in file.warnings[0]
    stop = latch.current()
    assert stop is not None
    assert latch.clear(stop.stop_id, stop.since_s + HOLD_S) is None
    latch.close()
    assert begun(tmp_path)[0].stopped is None


def test_a_folder_in_the_place_of_the_file_is_a_stop_and_its_trouble_is_said(tmp_path: Path) -> None:
    _, latch, file = begun(tmp_path)
    file.path.mkdir()
    guard, latch, file = begun(tmp_path)
    assert guard.stopped == "estop"
    latch.stop()
    assert comes_true(lambda: file.trouble is not None, 10.0)
    status = latch.status()
    assert status is not None
    assert status["kept"] is False
    stop = latch.current()
    assert stop is not None
    file.path.rmdir()
    assert comes_true(lambda: file.keeps(stop), 10.0), "it is tried again"
    assert file.trouble is None


def test_a_reason_that_no_file_can_have_is_kept_nearly_as_it_was(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path)
    guard.stop("fault: \ud800")
    assert latch.current() is not None
    latch.close()
    assert begun(tmp_path)[0].stopped == "fault: ?"


def test_where_nothing_can_be_written_it_is_said_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    guard, latch, file = begun(tmp_path / "file")
    assert guard.stopped is None
    assert "will not survive a restart" in file.warnings[0]
    latch.stop()
    latch.close()
    assert guard.stopped == "estop"


def test_robots_and_ports_have_files_of_their_own(tmp_path: Path) -> None:
    places = [("ant", "a"), ("ant", "b"), ("../../etc/x", "a")]
    paths = {StopFile(robot, place, folder=tmp_path).path for robot, place in places}
    assert len(paths) == 3
    assert {path.parent for path in paths} == {tmp_path}


def test_the_folder_is_systemds_or_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "hexctl"
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}/one:{tmp_path}/two")
    assert state_folder() == tmp_path / "one"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "hexctl"
