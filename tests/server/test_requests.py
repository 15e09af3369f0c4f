"""What reaches a robot: an inbox that is bounded and never blocks it, and what it answers to requests."""

import json
import signal
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.server.leases import Lease, LeaseManager
from hexctl.server.requests import MOST_CHANGES, RequestHandler
from hexctl.server.stops.latch import StopLatch
from hexctl.server.transport import MOST_WAITING, QUERIES, Inbox, end_lingering
from hexctl.waiting import comes_true
from hexctl.wire.description import encode_json
from hexctl.wire.stop import LOCKOUT_S, MAX_BY, UNNAMED
from tests.control.posed import connected, send
from tests.robots import shipped
from tests.server.processes import repeated

#: A wait longer than this has no end.
FOREVER_S = 20.0


def items(inbox: Inbox) -> list[object]:
    taken = []
    while (arrival := inbox.take(0)) is not None:
        taken.append(arrival.item)
    return taken


@pytest.mark.parametrize("kind", MOST_WAITING)
def test_a_flood_keeps_the_newest_messages_and_displaces_no_other_kind(kind: str) -> None:
    inbox, most = Inbox(), MOST_WAITING[kind]
    others = [other for other in MOST_WAITING if other not in (kind, "state")]
    for other in others:
        inbox.put(other, other)
    for number in range(640):
        inbox.put(kind, number)
    for other in others:
        inbox.put(other, other)
    kept = list(range(most) if kind in QUERIES else range(640 - most, 640))
    assert items(inbox) == [*others, *kept, *others]
    assert inbox.overflowed == 640 - most


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


@pytest.mark.slow
def test_signals_and_arrivals_that_were_taken_already_do_not_block_the_reader() -> None:
    inbox, until_s = Inbox(), time.monotonic() + FOREVER_S

    def interrupt(*_: object) -> None:
        assert time.monotonic() < until_s, "it blocked"

    def put() -> None:
        for _ in range(3):
            inbox.put("command", None)

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.0007, 0.0007)
    try:
        with repeated(put, 0.0005):
            for _ in range(500):
                inbox.take(0.001)
        for _ in range(500):
            inbox.take(0.001)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_no_connection_lingers() -> None:
    """Zenoh lets each one linger, and waits for clients that read nothing."""
    closing = threading.Event()
    thread = threading.Thread(target=end_lingering, args=(closing,))
    with socket.create_server(("127.0.0.1", 0)) as port, socket.create_connection(port.getsockname()) as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 10))
        thread.start()
        try:
            assert comes_true(
                lambda: one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 4) == bytes(4), 10.0
            )
        finally:
            closing.set()
            thread.join()


@pytest.fixture
def guard() -> Guard:
    return connected()[0]


@pytest.fixture
def desk(guard: Guard) -> RequestHandler:
    return RequestHandler(guard, LeaseManager(), StopLatch(guard))


def ask(desk: RequestHandler, now_s: float = 0.0, **content: str) -> dict[str, object]:
    return desk.lease(encode_json(content), now_s)


def test_a_lease_is_given_renewed_rests_and_is_released(guard: Guard, desk: RequestHandler) -> None:
    given = ask(desk, op="acquire", owner="alice")
    lease = str(given["lease"])
    assert ask(desk, 0.3, op="renew", lease=lease) == {"sequence": given["sequence"]}
    assert "alice" in str(ask(desk, 0.6, op="acquire", owner="bob")["error"])
    send(guard, guard.robot.stance_angles_rad)
    assert guard.expects_commands
    assert "sequence" in ask(desk, 0.6, op="rest", lease=lease)
    assert not guard.expects_commands
    assert ask(desk, 0.6, op="release", lease=lease) == {"released": True}
    assert "lease" in ask(desk, 0.7, op="acquire", owner="bob")


def test_silence_is_lifted_by_a_new_lease_and_every_other_stop_is_not(
    guard: Guard, desk: RequestHandler
) -> None:
    guard.stop("expired")
    assert "lease" in ask(desk, op="acquire", owner="alice")
    assert guard.stopped is None
    for reason in ("estop", "fell", "fault: low battery", "state", "pose lost"):
        guard.clear()
        guard.stop(reason)
        assert reason in str(ask(desk, 10.0, op="acquire", owner="bob")["error"])
        assert guard.stopped == reason


def test_a_stop_in_the_instant_of_a_lease_leaves_none(
    guard: Guard, desk: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    grant = desk.leases.acquire

    def interrupted(*asked: Any) -> Lease:
        lease = grant(*asked)
        desk.urgent(b"")
        return lease

    monkeypatch.setattr(desk.leases, "acquire", interrupted)
    assert "estop" in str(ask(desk, op="acquire", owner="alice")["error"])
    assert desk.leases.current(0.0) is None
    assert guard.stopped == "estop"


def clear(desk: RequestHandler, *, after_s: float = LOCKOUT_S) -> dict[str, object]:
    """Clear the stop in force by its id, a time after it was asked for."""
    stop = desk.latch.current()
    assert stop is not None
    return desk.estop(encode_json({"op": "clear", "id": stop.stop_id}), stop.since_s + after_s)


@pytest.mark.parametrize(
    ("owner", "by"),
    [
        ("alice on lab-pc", "alice on lab-pc"),
        ("x" * 500, "x" * MAX_BY),
        *((bad, UNNAMED) for bad in (None, 5, "", " ", "a\nb", "\ud800")),
    ],
)
def test_who_asks_for_a_stop_or_a_clear_is_known_by_the_name_that_it_says(
    desk: RequestHandler, owner: object, by: str
) -> None:
    payload = json.dumps({"op": "stop", "owner": owner}).encode()
    desk.urgent(payload)
    assert desk.estop(payload, 0.0)["stopped"] == "estop"
    stop = desk.latch.current()
    assert stop is not None
    assert stop.by == by
    asked = json.dumps({"op": "clear", "id": stop.stop_id, "owner": owner}).encode()
    assert desk.estop(asked, stop.since_s + LOCKOUT_S) == {"stopped": None}
    assert desk.latch.cleared is not None
    assert (desk.latch.cleared.by, desk.latch.cleared.stop) == (by, stop)


def test_a_stop_after_a_clear_was_sent_is_not_cleared_by_it(desk: RequestHandler) -> None:
    desk.urgent(b"")
    first = desk.latch.current()
    assert first is not None
    desk.urgent(b"")  # somebody else has seen something, too
    answer = desk.estop(encode_json({"op": "clear", "id": first.stop_id}), first.since_s + 2 * LOCKOUT_S)
    assert answer["stopped"] == "estop"
    assert "error" in answer


def test_a_clear_of_what_is_not_stopped_leaves_the_lease(guard: Guard, desk: RequestHandler) -> None:
    now_s = time.monotonic()
    lease = str(ask(desk, now_s, op="acquire", owner="alice")["lease"])
    assert desk.estop(encode_json({"op": "clear"}), now_s) == {"stopped": None}
    assert "sequence" in ask(desk, now_s + 0.1, op="renew", lease=lease)
    guard.stop("fell")
    assert "error" in desk.estop(encode_json({"op": "clear"}), now_s + 0.1)
    assert "sequence" in ask(desk, now_s + 0.2, op="renew", lease=lease), "nothing has changed"
    assert clear(desk) == {"stopped": None}
    assert "error" in ask(desk, now_s + 0.3, op="renew", lease=lease)


UNREADABLE = [b"x", b"[]", b"{}", b'{"op": "go"}', b'{"op": 1}', b'{"op": "clear", "id": 5}']


@pytest.mark.parametrize("payload", UNREADABLE)
def test_what_is_no_request_gives_no_lease_but_stops_and_is_counted(
    guard: Guard, desk: RequestHandler, payload: bytes
) -> None:
    assert "error" in desk.lease(payload, 0.0)
    assert guard.stopped is None
    assert desk.malformed == 1
    lease = str(ask(desk, op="acquire", owner="alice")["lease"])
    desk.urgent(payload)
    assert guard.stopped == "estop"
    answer = desk.estop(payload, 0.0)
    assert answer["stopped"] == "estop"
    assert "error" in answer
    assert desk.malformed == 2
    assert "error" in ask(desk, 0.1, op="renew", lease=lease)


@pytest.mark.parametrize(
    ("content", "error"),
    [
        ({"op": "renew", "lease": 5}, "lease: got no hexadecimal digits; allowed: the granted lease"),
        ({"op": "acquire", "owner": "a\nb"}, r"owner: got 'a\nb'; allowed: printable text"),
        ({"op": "rest", "after": True}, "after: got True; allowed: a whole number"),
        ({"op": "go"}, "op: got 'go'; allowed: 'acquire', 'renew', 'rest' or 'release'"),
    ],
)
def test_a_lease_request_with_bad_values_is_refused(
    desk: RequestHandler, content: dict[str, object], error: str
) -> None:
    assert desk.lease(encode_json(content), 0.0) == {"error": error}


@pytest.fixture(scope="module")
def servos() -> Iterator[SimServos]:
    """A simulation whose legs are whole between two tests."""
    with SimServos(shipped()) as servos:
        yield servos


@pytest.fixture
def breaking(servos: SimServos) -> RequestHandler:
    guard = Guard(servos)
    return RequestHandler(guard, LeaseManager(), StopLatch(guard))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({}, "op"),
        ({"op": "heal"}, "leg: got"),
        ({"op": "heal", "leg": True}, "leg: got True; allowed: 1..6"),
        ({"op": "heal", "leg": 9}, "leg: got '9'; allowed: 1..6"),
        ({"op": "fail", "failure": 5}, "failure: got 5; allowed: text"),
        ({"op": "fail", "failure": "x" * 61}, "allowed: text of at most 60 characters"),
        ({"op": "fail", "failure": "5:limp@3"}, "LEG:KIND: got"),
    ],
)
def test_a_request_for_a_failure_that_cannot_be_is_answered_with_an_error(
    breaking: RequestHandler, servos: SimServos, content: dict[str, object], words: str
) -> None:
    answer = breaking.failure(encode_json(content), 0.0)
    assert [*answer] == ["error"]
    assert words in answer["error"]
    assert servos.failures == ()


def test_a_real_robot_breaks_no_leg_and_an_error_of_a_simulation_is_answered(
    desk: RequestHandler, breaking: RequestHandler, monkeypatch: pytest.MonkeyPatch
) -> None:
    fail = b'{"op": "fail", "failure": "5:limp"}'
    assert list(desk.failure(fail, 0.0)) == ["error"]

    def buggy(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(SimServos, "change_leg", buggy)
    assert "change_leg" in breaking.failure(fail, 0.0)["error"]


def test_legs_fail_and_heal_but_not_too_often_in_a_second(breaking: RequestHandler) -> None:
    heal = b'{"op": "heal", "leg": 5}'
    assert "note" in breaking.failure(heal, 0.0), "it was whole already"
    weak = breaking.failure(b'{"op": "fail", "failure": "5:weak:femur:0.2"}', 0.0)
    assert weak == {"failures": ["leg 5 femur weak (0.2 of its torque)"]}
    assert breaking.failure(heal, 0.0) == {"failures": []}
    requests = [b'{"op": "fail", "failure": "5:limp"}', heal]
    answers = [breaking.failure(requests[number % 2], 2.0 + 0.01 * number) for number in range(50)]
    assert ["error" in answer for answer in answers] == [False] * MOST_CHANGES + [True] * 40
    assert breaking.failure(requests[0], 3.005) == {"failures": ["leg 5 limp"]}
    assert "error" in breaking.failure(requests[1], 3.006)
    assert breaking.failure(heal, 5.0) == {"failures": []}
