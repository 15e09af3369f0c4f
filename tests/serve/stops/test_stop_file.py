"""A stop on the disk: what is found after a restart, whatever has become of the file."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from hexctl.control.guard import Guard
from hexctl.serve.stops import stop_file
from hexctl.serve.stops.latch import StopLatch
from hexctl.serve.stops.state_folder import state_folder
from hexctl.serve.stops.stop import HOLD_S
from hexctl.serve.stops.stop_file import StopFile
from hexctl.serve.stops.stop_place import StopPlace
from hexctl.waiting import comes_true
from tests.control.posed import connected

PLACE = StopPlace(backend="feetech", where="/dev/ttyACM0")


def begun(
    folder: Path, *, asked_only: bool = False, place: StopPlace = PLACE, robot: str = "ant"
) -> tuple[Guard, StopLatch, StopFile]:
    """A server's stop, as after a start."""
    guard = connected()[0]
    file = StopFile(robot, place, folder=folder, asked_only=asked_only)
    return guard, StopLatch(guard, file), file


def stopped_at(folder: Path, place: StopPlace) -> str:
    """Keep a stop of a robot at a place; its id."""
    _, latch, _ = begun(folder, place=place)
    stop = latch.stop()
    latch.close()
    return stop.stop_id


def cleared_at(folder: Path, place: StopPlace) -> None:
    """Clear the stop of a robot at a place, in a server of its own."""
    _, latch, _ = begun(folder, place=place)
    stop = latch.current()
    assert stop is not None
    assert latch.clear(stop.stop_id, stop.since_s + HOLD_S) is None
    latch.close()


def at(where: str) -> StopPlace:
    """A place whose adapter is not known."""
    return StopPlace(backend="feetech", where=where)


def on_usb(number: int, serial_number: str | None = None, location: str | None = None) -> StopPlace:
    """A place at an adapter."""
    return StopPlace(
        backend="feetech",
        where=f"/dev/ttyUSB{number}",
        serial_number=serial_number,
        location=location,
    )


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

    guard, latch, file = begun(tmp_path / "state")  # as after a kill: the first was not closed
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


def test_who_asked_for_a_stop_is_kept_with_it(tmp_path: Path) -> None:
    _, latch, _ = begun(tmp_path)
    latch.stop(by="mia on lab-pc")
    latch.close()
    _, latch, file = begun(tmp_path)
    stop = latch.current()
    assert stop is not None
    assert stop.by == "mia on lab-pc"
    assert "UTC, asked for by mia on lab-pc), as before the restart" in file.warnings[0]


def test_silence_is_not_kept(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path)
    guard.stop("expired")
    assert latch.current() is not None
    latch.close()
    assert list(tmp_path.iterdir()) == []


def test_of_a_simulation_only_what_a_client_asked_for_is_kept(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path, asked_only=True)
    guard.stop("fell")
    assert latch.current() is not None
    latch.close()
    assert begun(tmp_path, asked_only=True)[0].stopped is None
    _, latch, _ = begun(tmp_path, asked_only=True)
    latch.stop()
    latch.close()
    assert begun(tmp_path, asked_only=True)[0].stopped == "estop"


def test_a_stop_that_a_client_asks_for_once_a_simulation_has_fallen_is_kept(tmp_path: Path) -> None:
    guard, latch, file = begun(tmp_path, asked_only=True)
    guard.stop("fell")
    assert latch.current() is not None
    stop = latch.stop()
    assert stop.reason == "fell"
    assert comes_true(lambda: file.keeps(stop), 10.0)
    guard, latch, _ = begun(tmp_path, asked_only=True)
    assert guard.stopped == "estop", "it stands again, and a client has stopped it"
    again = latch.current()
    assert again is not None
    assert again.stop_id == stop.stop_id


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


def dangle(path: Path) -> None:
    """Put a link to nothing in place of a file."""
    path.symlink_to("nothing")


def loop(path: Path) -> None:
    """Put a link to itself in place of a file."""
    path.symlink_to(path)


def endless(path: Path) -> None:
    """Put a device without an end in place of a file."""
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("place_strangely", [os.mkfifo, dangle, loop, endless])
def test_what_is_no_plain_file_is_a_stop_until_it_is_cleared(
    tmp_path: Path, place_strangely: Callable[[Path], None]
) -> None:
    place_strangely(begun(tmp_path)[2].path)
    guard, latch, file = begun(tmp_path)
    assert guard.stopped == "estop"
    assert len(file.warnings) == 1
    stop = latch.current()
    assert stop is not None
    assert latch.clear(stop.stop_id, stop.since_s + HOLD_S) is None
    latch.close()
    assert list(tmp_path.iterdir()) == []
    assert begun(tmp_path)[0].stopped is None


@pytest.mark.parametrize("place_strangely", [os.mkfifo, dangle])
def test_what_is_no_plain_file_at_another_place_is_a_stop(
    tmp_path: Path, place_strangely: Callable[[Path], None]
) -> None:
    place_strangely(begun(tmp_path, place=on_usb(0))[2].path)
    assert begun(tmp_path, place=on_usb(1))[0].stopped == "estop"
    cleared_at(tmp_path, on_usb(1))
    assert begun(tmp_path, place=on_usb(1))[0].stopped is None


def test_a_folder_that_is_a_link_to_nothing_is_a_stop(tmp_path: Path) -> None:
    """The disk on which a stop was kept may not be mounted yet."""
    dangle(tmp_path / "state")
    assert begun(tmp_path / "state")[0].stopped == "estop"


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
    paths = {
        StopFile(robot, StopPlace(backend="mock", where=where), folder=tmp_path).path
        for robot, where in places
    }
    assert len(paths) == 3
    assert {path.parent for path in paths} == {tmp_path}


def test_an_adapter_with_another_name_is_the_same_by_its_number(tmp_path: Path) -> None:
    stop_id = stopped_at(tmp_path, on_usb(0, "0403:6014 serial A1"))
    guard, latch, file = begun(tmp_path, place=on_usb(1, "0403:6014 serial A1"))
    assert guard.stopped == "estop"
    stop = latch.current()
    assert stop is not None
    assert stop.stop_id == stop_id
    assert "which may be" not in file.warnings[0]
    latch.close()
    cleared_at(tmp_path, on_usb(2, "0403:6014 serial A1"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (on_usb(0), on_usb(1)),
        (on_usb(0, None, "1a86:7523 at 1-2"), on_usb(0, None, "1a86:7523 at 1-3")),
        (on_usb(0), on_usb(0, "0403:6014 serial A1")),
        (on_usb(0, "0403:6014 serial A1"), on_usb(1)),
        (at("/dev/ttyCH341USB0"), at("/dev/ttyCH341USB1")),
        (at("/dev/cu.usbserial-1410"), at("/dev/cu.usbserial-1420")),
        (at("/dev/a-link-that-is-gone"), on_usb(0, "0403:6014 serial A1")),
        (at("/dev/ttyAMA0"), on_usb(0)),
    ],
)
def test_where_adapters_cannot_be_told_apart_the_robot_is_stopped_and_it_is_said_why(
    tmp_path: Path, before: StopPlace, after: StopPlace
) -> None:
    stopped_at(tmp_path, before)
    guard, latch, file = begun(tmp_path, place=after)
    assert guard.stopped == "estop"
    assert f"kept for ant, {before}, which may be this one" in file.warnings[0]
    latch.close()
    cleared_at(tmp_path, before)
    assert begun(tmp_path, place=after)[0].stopped == "estop", "cleared at one place alone"
    stopped_at(tmp_path, before)
    cleared_at(tmp_path, after)
    assert begun(tmp_path, place=after)[0].stopped is None
    assert begun(tmp_path, place=before)[0].stopped == "estop", "it is not lost where it was kept"
    cleared_at(tmp_path, before)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("place", "stopped"),
    [
        (on_usb(1, "0403:6014 serial A1"), True),
        (at("/dev/ttyAMA0"), True),
        (at("tcp/127.0.0.1:7447"), False),
    ],
    ids=str,
)
def test_a_stop_without_its_place_is_in_force_at_each_device(
    tmp_path: Path, place: StopPlace, stopped: bool
) -> None:
    _, latch, file = begun(tmp_path, place=on_usb(0))
    latch.stop()
    latch.close()
    kept = json.loads(file.path.read_text())
    for name in ("backend", "where", "serial_number", "location", "cleared"):
        del kept[name]
    file.path.write_text(json.dumps(kept))
    guard, _, file = begun(tmp_path, place=place)
    assert guard.stopped == ("estop" if stopped else None)
    assert ["cannot be read" in line for line in file.warnings] == [True] * stopped


def test_a_stop_that_came_later_at_another_place_is_not_cleared_with_the_one_before_it(
    tmp_path: Path,
) -> None:
    first = stopped_at(tmp_path, on_usb(0))
    _, latch, _ = begun(tmp_path, place=on_usb(1))
    cleared_at(tmp_path, on_usb(0))
    later = stopped_at(tmp_path, on_usb(0))
    stop = latch.current()
    assert stop is not None
    assert stop.stop_id == first
    assert latch.clear(first, stop.since_s + HOLD_S) is None
    latch.close()
    _, latch, _ = begun(tmp_path, place=on_usb(1))
    stop = latch.current()
    assert stop is not None
    assert stop.stop_id == later


def test_a_file_of_another_place_that_cannot_be_read_is_a_stop_until_it_is_cleared(tmp_path: Path) -> None:
    file = begun(tmp_path, place=on_usb(0))[2]
    file.path.write_bytes(b"{")
    guard, _, again = begun(tmp_path, place=on_usb(1))
    assert guard.stopped == "estop"
    assert f"{file.path} cannot be read" in again.warnings[0]
    cleared_at(tmp_path, on_usb(1))
    assert begun(tmp_path, place=on_usb(1))[0].stopped is None
    assert begun(tmp_path, place=on_usb(0))[0].stopped == "estop"


@pytest.mark.parametrize(
    ("place", "robot", "told"),
    [
        (on_usb(0, "0403:6014 serial B2"), "ant", True),
        (on_usb(1), "phantomx", False),
        (StopPlace(backend="lx16a", where="/dev/ttyUSB1"), "ant", False),
        (at("tcp/127.0.0.1:7447"), "ant", False),
    ],
)
def test_a_stop_of_another_robot_is_not_in_force_and_is_told_where_it_may_be_meant(
    tmp_path: Path, place: StopPlace, robot: str, told: bool
) -> None:
    stopped_at(tmp_path, on_usb(0, "0403:6014 serial A1"))
    guard, latch, file = begun(tmp_path, place=place, robot=robot)
    assert guard.stopped is None
    assert bool(file.warnings) is told
    for line in file.warnings:
        assert line.startswith("a stop of another ant is kept, and not in force here: estop, 20")
        assert "feetech at /dev/ttyUSB0 (0403:6014 serial A1)" in line
    latch.stop()
    latch.close()
    assert begun(tmp_path, place=on_usb(0, "0403:6014 serial A1"))[0].stopped == "estop"


def test_the_folder_is_systemds_or_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "hexctl"
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}/one:{tmp_path}/two")
    assert state_folder() == tmp_path / "one"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_folder() == tmp_path / ".local" / "state" / "hexctl"


class NoThread(threading.Thread):
    """A thread on a computer that has none left."""

    def start(self) -> None:
        raise RuntimeError("can't start new thread")


def test_a_computer_without_a_thread_left_stops_the_robot_and_the_next_stop_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard, latch, file = begun(tmp_path / "state")
    with monkeypatch.context() as without:
        without.setattr(stop_file, "threading", SimpleNamespace(Thread=NoThread))
        stop = latch.stop()
    assert guard.stopped == "estop"
    assert not file.keeps(stop)
    assert "can't start new thread" in (file.trouble or "")
    again = latch.stop()
    assert comes_true(lambda: file.keeps(again), 10.0)
    assert file.trouble is None
    latch.close()


#: Keeps a stop in a process that has no free descriptor, and is killed then.
NO_DESCRIPTOR = """
import os, resource, signal, sys, time
from pathlib import Path
from tests.serve.stops.test_stop_file import begun

_, latch, file = begun(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
try:
    while True:
        os.open("/dev/null", os.O_RDONLY)
except OSError:
    pass
stop = latch.stop()
until_s = time.monotonic() + 20
while not file.keeps(stop) and time.monotonic() < until_s:
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_stop_is_kept_although_all_descriptors_are_taken(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", NO_DESCRIPTOR, str(tmp_path)], check=False, timeout=120)
    assert [path.suffix for path in tmp_path.iterdir()] == [".json"]
    _, latch, _ = begun(tmp_path)
    assert latch.current() is not None
    latch.close()
