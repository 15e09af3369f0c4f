"""The thread that owns a port: what was asked for happens, whatever the port does meanwhile."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.port_thread import PortCounters, reason_of
from hexctl.backends.pwm.servos import BoardReport, BoardThread
from hexctl.types import BoolArray, FloatArray
from hexctl.waiting import wait_for
from tests.backends.fake_time import FakeTime


@dataclass
class _Board:
    """A board that writes down what it is told, and fails where it is to.

    Attributes:
        time: of its reports.
        fails: what its calls raise, by their names, for ever.
        fault: of its reports.
    """

    time: FakeTime
    said: list[str] = field(default_factory=list)
    fails: dict[str, Exception] = field(default_factory=dict)
    fault: str | None = None

    def _do(self, name: str) -> None:
        if name in self.fails:
            raise self.fails[name]
        self.said.append(name)

    def commanded_us(self) -> FloatArray:
        return np.full(18, np.nan)

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        self._do("begin")

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        self._do("write")

    def end(self) -> None:
        self._do("end")

    def poll(self) -> BoardReport:
        if "poll" in self.fails:
            raise self.fails["poll"]
        return BoardReport(at_s=self.time.now(), fault=self.fault)

    def close(self) -> None:
        self._do("close")


def _thread(
    board: _Board, opened: Callable[[], _Board], *, speed: float = 1e6, sent_us: float = np.nan
) -> BoardThread:
    """A thread for a board that opens others after it, for joints with a speed and their last pulses."""
    first, told = BoardReport(at_s=board.time.now()), np.full(18, sent_us)
    return BoardThread(opened, board, first, PortCounters(), np.full(18, speed), told, time=board.time)


@contextmanager
def _running(thread: BoardThread, *, on: bool = False) -> Iterator[BoardThread]:
    """Let a thread run meanwhile."""
    thread.on = on
    thread.start()
    try:
        yield thread
    finally:
        thread.stop()


def _wait(time: FakeTime, condition: Callable[[], object]) -> None:
    wait_for(condition, 60.0, "never came", time=time)


@pytest.fixture
def time() -> FakeTime:
    return FakeTime()


POSE = np.full(18, 1500.0)


def test_a_thread_that_begins_after_its_stop_leaves_a_closed_port(time: FakeTime) -> None:
    board = _Board(time)
    thread = _thread(board, lambda: board)
    thread.stop()
    thread.start()
    thread.stop()
    assert board.said.count("close") == 1


ERRORS = [OSError(5, "Input/output error"), ValueError("not a number"), RuntimeError(), KeyError("x")]


@pytest.mark.parametrize(
    ("call", "error"), [*zip(("begin", "poll", "end"), ERRORS, strict=False), ("poll", ERRORS[-1])]
)
def test_whatever_a_port_raises_it_has_gone_and_is_opened_again(
    call: str, error: Exception, time: FakeTime
) -> None:
    board, mended = _Board(time), _Board(time)
    back = threading.Event()

    def opened() -> _Board:
        if not back.is_set():
            raise error
        return mended

    with _running(_thread(board, opened)) as thread:
        board.fails[call] = error
        if call == "begin":
            thread.send(POSE)
        if call == "end":
            thread.release()
        _wait(time, lambda: thread.gone)
        assert thread.gone == reason_of(error)
        time.sleep(0.6)  # two more attempts
        assert thread._thread.is_alive()
        back.set()
        _wait(time, lambda: thread.gone is None)
        assert "begin" not in mended.said, "nothing is powered by itself"
        thread.send(POSE)
        _wait(time, lambda: "begin" in mended.said)
    assert mended.said[-1] == "close"


def test_targets_that_come_late_and_then_at_once_move_no_joint_farther_than_it_may_turn(
    time: FakeTime,
) -> None:
    rng, board = np.random.default_rng(11), _Board(time)
    step = 10.0  # in a control period
    thread = _thread(board, lambda: board, speed=step / PERIOD_S)
    told = [np.where(np.arange(18) < 9, POSE, np.nan)]
    passed_s = [0.0]
    for _ in range(500):
        wait_s = rng.choice([0.001, 0.019, 0.02, 0.021, 0.039])
        time.work(wait_s)
        thread._sent = told[-1]
        told.append(thread._stepped(POSE + rng.choice([-300.0, 300.0], 18)))
        passed_s.append(passed_s[-1] + wait_s)
    assert np.isfinite(told[1]).all(), "a joint that was told nothing takes its first target"
    moved = np.abs(np.diff(np.array(told[1:]), axis=0))
    assert moved.max() == pytest.approx(step), "the most, and often"
    way, times_s = np.vstack([np.zeros(18), np.cumsum(moved, axis=0)]), np.array(passed_s[1:])
    for first_row in range(len(way)):
        at_most = step * (1 + (times_s[first_row:] - times_s[first_row]) / PERIOD_S)
        assert ((way[first_row:] - way[first_row]).max(axis=1) <= at_most + 1e-6).all()
    for _ in range(40):
        time.work(PERIOD_S)
        thread._sent = told[-1]
        told.append(thread._stepped(POSE))
    assert (told[-1] == POSE).all(), "what was held back follows"


def test_a_torque_that_could_not_be_switched_off_is_off_once_the_port_is_back(time: FakeTime) -> None:
    board, mended = _Board(time), _Board(time)
    with _running(_thread(board, lambda: mended)) as thread:
        thread.send(POSE)
        _wait(time, lambda: "begin" in board.said)
        board.fails["end"] = OSError(5, "Input/output error")
        thread.release()
        _wait(time, lambda: mended.said)
        _wait(time, lambda: "end" in mended.said)
        assert not thread.on
        time.sleep(0.1)
        assert mended.said.count("end") == 1, "once is enough"


def test_targets_that_come_before_the_torque_is_off_are_obeyed(time: FakeTime) -> None:
    board, mended = _Board(time), _Board(time)
    back = threading.Event()

    def opened() -> _Board:
        if not back.is_set():
            raise OSError(6, "No such device")
        return mended

    with _running(_thread(board, opened)) as thread:
        board.fails["end"] = OSError(5, "Input/output error")
        thread.release()
        _wait(time, lambda: thread.gone)
        thread.send(POSE)
        back.set()
        _wait(time, lambda: thread.gone is None)
        assert "begin" not in mended.said, "what was left meanwhile is dropped"
        thread.send(POSE)
        _wait(time, lambda: "begin" in mended.said)
        assert "end" not in mended.said


def test_a_board_that_tripped_is_switched_off_although_targets_follow(time: FakeTime) -> None:
    board = _Board(time, fault="overcurrent")
    with _running(_thread(board, lambda: board)) as thread:
        _wait(time, lambda: thread.newest.fault)
        thread.send(POSE)
        time.sleep(0.1)
        assert "begin" not in board.said
        board.fault = None
        thread.release()
        thread.send(POSE)
        _wait(time, lambda: "begin" in board.said)
        assert board.said[:2] == ["end", "begin"]


@pytest.mark.parametrize("released", [True, False])
def test_what_was_asked_for_last_is_done_before_the_end(released: bool, time: FakeTime) -> None:
    board = _Board(time)
    with _running(_thread(board, lambda: board)) as thread:
        thread.send(POSE)
        if released:
            thread.release()
    assert board.said[-2:] == (["end", "close"] if released else ["write", "close"])


def test_an_end_that_fails_is_an_end(time: FakeTime) -> None:
    board = _Board(time)
    with _running(_thread(board, lambda: board)) as thread:
        board.fails = {"begin": RuntimeError("no"), "close": ValueError("no")}
    assert not thread._thread.is_alive()


def test_torque_that_is_to_be_off_stays_off_when_that_is_asked_for_in_the_midst_of_a_write(
    time: FakeTime,
) -> None:
    """What was left of a step that was under way is not sent behind it."""
    writing, released = threading.Event(), threading.Event()

    class Slow(_Board):
        def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
            super().write(pulses_us, on)
            writing.set()
            assert released.wait(10)

    board = Slow(time)
    slow = _thread(board, lambda: board, speed=100.0, sent_us=1000.0)  # far targets take many steps
    with _running(slow, on=True) as thread:
        thread.send(POSE)
        assert writing.wait(10)
        thread.release()
        released.set()
        _wait(time, lambda: "end" in board.said)
        time.sleep(0.3)
        assert board.said[-1] == "end", board.said


def test_targets_that_come_while_a_port_is_opened_are_dropped(time: FakeTime) -> None:
    opening, sent = threading.Event(), threading.Event()

    class Met(_Board):
        def commanded_us(self) -> FloatArray:
            opening.set()
            assert sent.wait(10)
            return super().commanded_us()

    board, mended = _Board(time), Met(time)
    with _running(_thread(board, lambda: mended)) as thread:
        board.fails["poll"] = OSError(5, "Input/output error")
        _wait(time, opening.is_set)
        thread.send(POSE)
        sent.set()
        _wait(time, lambda: thread.gone is None)
        time.sleep(0.2)
        assert "begin" not in mended.said
