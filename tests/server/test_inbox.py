"""The inbox: in order, bounded, and it never blocks the robot forever."""

import signal
import threading
import time
from collections.abc import Iterator

import pytest

from hexctl.server.inbox import CAPACITY, MOST_WAITING, QUERIES, Inbox

#: A wait longer than this has no end.
FOREVER_S = 20.0


def items(inbox: Inbox) -> list[object]:
    taken = []
    while (arrival := inbox.take(0)) is not None:
        taken.append(arrival.item)
    return taken


@pytest.mark.parametrize("kind", MOST_WAITING)
def test_what_fits_comes_in_order_then_the_oldest_goes_but_of_queries_the_newest(kind: str) -> None:
    inbox, most = Inbox(), MOST_WAITING[kind]
    for number in range(most + 3):
        inbox.put(kind, number)
    assert items(inbox) == list(range(most) if kind in QUERIES else range(3, most + 3))
    assert kind in QUERIES or inbox.overflowed == 3


def test_the_newest_state_takes_the_place_of_one_that_was_not_taken() -> None:
    inbox = Inbox(capacity=1)
    for number in range(3):
        inbox.put("state", number)
    assert items(inbox) == [2]
    assert inbox.overflowed == 2


@pytest.mark.parametrize("kind", MOST_WAITING)
def test_a_flood_of_one_kind_displaces_no_other(kind: str) -> None:
    assert sum(MOST_WAITING.values()) <= CAPACITY
    inbox = Inbox()
    others = [other for other in MOST_WAITING if other != kind]
    for other in others:
        inbox.put(other, other)
    for _ in range(10 * CAPACITY):
        inbox.put(kind, "flood")
    for other in others:
        inbox.put(other, other)
    taken = items(inbox)
    assert [item for item in taken if item != "flood"] == [*others, *others]
    assert taken.count("flood") == MOST_WAITING[kind]
    assert inbox.overflowed == 10 * CAPACITY - MOST_WAITING[kind]


def test_an_arrival_wakes_the_reader_and_nothing_waits_for_none() -> None:
    inbox = Inbox()
    for timeout_s in (-1.0, 0.0, 0.01):
        assert inbox.take(timeout_s) is None
    threading.Timer(0.05, inbox.put, ("estop", "now")).start()
    arrival = inbox.take(FOREVER_S)
    assert arrival is not None
    assert (arrival.kind, arrival.item) == ("estop", "now")
    inbox.put("command", 1)
    assert inbox.take(0) is not None
    assert inbox.take(0.01) is None, "what rang was taken already"


@pytest.fixture
def _interrupted() -> Iterator[None]:
    """Interrupt the main thread by signals, again and again."""
    before = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0.0007, 0.0007)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.slow
@pytest.mark.usefixtures("_interrupted")
def test_signals_and_arrivals_that_were_taken_already_do_not_block_the_reader() -> None:
    inbox = Inbox(capacity=2)
    rescued, done, stop = threading.Event(), threading.Event(), threading.Event()

    def rescue() -> None:
        if done.wait(FOREVER_S):
            return
        rescued.set()
        while not done.wait(0.001):
            inbox.put("rescue", None)

    def flood() -> None:
        while not stop.is_set():
            for _ in range(3):
                inbox.put("command", None)
            time.sleep(0.0005)

    threading.Thread(target=rescue).start()
    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        for _ in range(500):
            inbox.take(0.001)
        stop.set()
        flooding.join()
        for _ in range(500):
            inbox.take(0.001)
    finally:
        stop.set()
        done.set()
    assert not rescued.is_set(), "it blocked"
