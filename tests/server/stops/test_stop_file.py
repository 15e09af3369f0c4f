"""A stop on the disk: what is found after a restart, whatever has become of the file."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from hexctl.control.guard import Guard
from hexctl.server.stops import stop_file
from hexctl.server.stops.latch import StopLatch
from hexctl.server.stops.stop_file import BLOCK_BYTES, StopFile
from hexctl.waiting import comes_true
from hexctl.wire.stop import LOCKOUT_S, MAX_BY, MOST_CLAIMS, Stop, claim_of
from tests.control.posed import connected

#: The server that was begun last.
_BEGUN: list[StopLatch] = []


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A write that failed is tried again soon."""
    monkeypatch.setattr(stop_file, "AGAIN_S", 0.1)
    monkeypatch.setattr(stop_file, "PAUSE_S", 0.01)


def begun(
    folder: Path, *, asked_only: bool = False, where: str = "/dev/ttyACM0", robot: str = "ant"
) -> tuple[Guard, StopLatch, StopFile]:
    """A server's stop, as after a start; the server before has ended."""
    while _BEGUN:
        _BEGUN.pop().close()
    guard = connected()[0]
    file = StopFile(robot, "feetech", where, folder=folder, asked_only=asked_only)
    _BEGUN.append(StopLatch(guard, file))
    return guard, _BEGUN[0], file


def current(latch: StopLatch) -> Stop:
    """The stop in force."""
    stop = latch.current()
    assert stop is not None
    return stop


def cleared(latch: StopLatch) -> None:
    """Clear the stop in force as soon as that is allowed."""
    stop = current(latch)
    assert latch.clear(stop.stop_id, stop.since_s + 10 * LOCKOUT_S) is None


@pytest.mark.parametrize("reason", ["estop", "fault: low battery 9.5 V"])
def test_a_stop_is_there_after_a_restart_with_its_id_until_it_is_cleared(tmp_path: Path, reason: str) -> None:
    guard, latch, file = begun(tmp_path / "state")
    assert guard.stopped is None
    assert file.warnings == ()
    guard.stop(reason)
    stop = current(latch)
    assert comes_true(lambda: file.keeps(stop), 10.0)
    assert latch.now() == (stop, True)

    guard, latch, file = begun(tmp_path / "state")
    assert guard.stopped == reason
    again = current(latch)
    assert (again.stop_id, again.reason) == (stop.stop_id, reason)
    assert reason in file.warnings[0]
    assert latch.clear(again.stop_id, again.since_s) is not None, "it is held again"
    assert latch.clear(again.stop_id, again.since_s + LOCKOUT_S) is None
    latch.close()

    guard, latch, file = begun(tmp_path / "state")
    assert guard.stopped is None
    assert {path.suffix for path in (tmp_path / "state").iterdir()} == {".json", ".lock"}


def test_who_asked_for_a_stop_and_where_is_kept_with_it_and_silence_is_not(tmp_path: Path) -> None:
    guard, latch, _ = begun(tmp_path)
    guard.stop("expired")
    assert latch.current() is not None
    guard, latch, _ = begun(tmp_path, where="/dev/ttyUSB0")
    assert guard.stopped is None
    latch.stop(by="mia on lab-pc")
    latch.close()
    _, latch, file = begun(tmp_path, where="/dev/ttyUSB1")
    assert current(latch).by == "mia on lab-pc"
    assert "mia on lab-pc, ant at /dev/ttyUSB0" in file.warnings[0]


def test_of_a_simulation_only_what_a_client_asked_for_is_kept(tmp_path: Path) -> None:
    guard, latch, file = begun(tmp_path, asked_only=True)
    guard.stop("fell")
    assert latch.current() is not None
    latch.close()
    guard, latch, file = begun(tmp_path, asked_only=True)
    assert guard.stopped is None
    guard.stop("fell")
    assert latch.current() is not None
    stop = latch.stop()
    assert stop.reason == "fell"
    assert comes_true(lambda: file.keeps(stop), 10.0)
    guard, latch, _ = begun(tmp_path, asked_only=True)
    assert guard.stopped == "estop", "it stands again, and a client has stopped it"
    assert current(latch).stop_id == stop.stop_id


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"\xff\xfe", b'{"version": 2}', b"x" * 100_000, b'{"version": 1, "reason": ""}',
    "a pipe", "a link to nothing", "a link to itself", "a link to /dev/zero"],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_a_stop(tmp_path: Path, content: bytes | str) -> None:
    path = StopFile("ant", "feetech", "/dev/ttyACM0", folder=tmp_path).path
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "a pipe":
        os.mkfifo(path)
    else:
        target = content.removeprefix("a link to ")
        path.symlink_to(path if target == "itself" else target)
    guard, latch, file = begun(tmp_path)
    assert guard.stopped == "estop"
    assert len(file.warnings) == 1
    cleared(latch)
    assert begun(tmp_path)[0].stopped is None
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".lock"}


def test_a_folder_that_is_a_link_to_nothing_is_a_stop(tmp_path: Path) -> None:
    """The disk on which a stop was kept may not be mounted yet."""
    (tmp_path / "state").symlink_to("nothing")
    assert begun(tmp_path / "state")[0].stopped == "estop"


def test_a_folder_in_the_place_of_the_file_is_a_stop_and_its_trouble_is_said(tmp_path: Path) -> None:
    file = StopFile("ant", "feetech", "/dev/ttyACM0", folder=tmp_path)
    file.path.mkdir()
    guard, latch, file = begun(tmp_path)
    assert guard.stopped == "estop"
    latch.stop()
    assert comes_true(lambda: file.trouble is not None, 10.0)
    assert latch.now()[1] is False
    stop = current(latch)
    file.path.rmdir()
    assert comes_true(lambda: file.keeps(stop), 10.0), "it is tried again"
    assert file.trouble is None


def test_where_nothing_can_be_written_it_is_said_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    guard, latch, file = begun(tmp_path / "file")
    assert guard.stopped is None
    assert "will not survive a restart" in file.warnings[0]
    latch.stop()
    latch.close()
    assert guard.stopped == "estop"


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
from tests.server.stops.test_stop_file import begun

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
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".lock"}
    _, latch, _ = begun(tmp_path)
    assert latch.current() is not None
    latch.close()


def test_robots_have_files_of_their_own_by_name_backend_and_place(tmp_path: Path) -> None:
    robots = [("ant", "mock", "a"), ("ant", "mock", "b"), ("ant", "dead", "a"), ("../../etc/x", "mock", "a")]
    devices = ["/dev/ttyUSB0", "serial:/dev/ttyACM0:1000000"]
    paths = {StopFile(*robot, folder=tmp_path).path for robot in robots}
    assert len(paths) == len(robots)
    assert len({StopFile("ant", "mock", device, folder=tmp_path).path for device in devices} - paths) == 1
    assert {path.parent for path in paths} == {tmp_path}


def served_beside(folder: Path, where: str = "/dev/ttyUSB1") -> tuple[Guard, StopLatch, StopFile]:
    """A second server of the same robot name, while the first one runs."""
    guard = connected()[0]
    file = StopFile("ant", "feetech", where, folder=folder)
    return guard, StopLatch(guard, file), file


def test_a_second_server_of_one_name_is_stopped_too_and_takes_nothing_from_the_first(tmp_path: Path) -> None:
    _, latch, file = begun(tmp_path, where="/dev/ttyUSB0")
    stop = latch.stop()
    assert comes_true(lambda: file.keeps(stop), 10.0)
    guard, other, second = served_beside(tmp_path)
    assert guard.stopped == "estop", "it may be the same robot, whose server is ending"
    assert "ant at /dev/ttyUSB0" in second.warnings[0]
    assert "will not survive a restart" in second.warnings[1]
    cleared(other)
    assert other.stop() is not None
    assert not comes_true(lambda: second.keeps(current(other)), 0.5)
    cleared(other)
    guard, latch, _ = begun(tmp_path, where="/dev/ttyUSB0")
    assert guard.stopped == "estop"
    assert current(latch).stop_id == stop.stop_id
    other.close()


@pytest.mark.parametrize("harm", ["damaged", "removed"])
def test_a_second_server_of_one_name_overwrites_no_stop_of_a_file_that_was_harmed(
    tmp_path: Path, harm: str
) -> None:
    _, _, file = begun(tmp_path)
    if harm == "damaged":
        file.path.write_bytes(b"no stop")
        _, latch, file = begun(tmp_path)
        cleared(latch)
    else:
        file.path.unlink()
        latch = begun(tmp_path)[1]
        file.path.unlink()
    _, other, _ = served_beside(tmp_path)
    kept = _BEGUN[0].stop()
    assert comes_true(lambda: _BEGUN[0].now()[1], 10.0)
    if other.current() is not None:
        cleared(other)
    assert not comes_true(lambda: not _BEGUN[0].now()[1], 0.5)
    assert current(begun(tmp_path)[1]).stop_id == kept.stop_id
    other.close()


def test_a_server_that_starts_while_the_one_before_ends_is_stopped_and_keeps_the_stop(tmp_path: Path) -> None:
    _, latch, file = begun(tmp_path)
    stop = latch.stop()
    assert comes_true(lambda: file.keeps(stop), 10.0)
    guard, after, second = served_beside(tmp_path, "/dev/ttyACM0")
    assert guard.stopped == "estop"
    latch.close()
    assert comes_true(lambda: second.trouble is None, 10.0)
    cleared(after)
    after.close()
    assert begun(tmp_path)[0].stopped is None


def test_a_file_that_is_removed_meanwhile_is_made_anew(tmp_path: Path) -> None:
    _, latch, file = begun(tmp_path)
    file.path.unlink()
    latch.stop()
    assert begun(tmp_path)[0].stopped == "estop"


def test_a_write_that_is_cut_off_anywhere_loses_no_stop(tmp_path: Path) -> None:
    _, latch, file = begun(tmp_path)
    cleared = file.path.read_bytes()
    latch.stop(by="mia")
    latch.close()
    stopped = file.path.read_bytes()
    assert len(stopped) == len(cleared) == BLOCK_BYTES
    for before, after in ((cleared, stopped), (stopped, cleared)):
        for cut in range(1, len(after.rstrip())):
            file.path.write_bytes(after[:cut] + before[cut:])
            assert StopFile("ant", "feetech", "/dev/ttyACM0", folder=tmp_path).load() is not None


@pytest.mark.parametrize("character", ["\0", "\U0001f916", "\ud800"])
def test_the_longest_texts_fit_into_the_file(tmp_path: Path, character: str) -> None:
    guard, latch, file = begun(tmp_path, robot=1000 * character, where=1000 * character)
    guard.stop(1000 * character)
    for number in range(2 * MOST_CLAIMS):
        latch.stop(claim_of(str(number)), by=MAX_BY * "\U0001f916")
    latch.close()
    assert len(file.path.read_bytes()) == BLOCK_BYTES
    again = begun(tmp_path, robot=1000 * character, where=1000 * character)[1].current()
    assert again is not None
    assert set(again.reason) == {"?" if character == "\ud800" else character}
