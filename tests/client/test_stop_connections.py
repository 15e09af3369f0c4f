"""The two ways of a stop, by datagram and by session, and the watch on what they see."""

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from hexctl.client import stop_connections
from hexctl.client.clear_keys import StopOrder
from hexctl.client.stop_client import NAME_WAIT_S, SILENCE_S, StopWatch
from hexctl.client.stop_connections import DatagramStop, SessionStop, Sighting
from hexctl.waiting import comes_true
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link
from hexctl.wire.stop import OTHERS_LOCKOUT_S
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, SECRET_FILE, Kind, StopDatagram
from tests.many_files import many_open_files
from tests.server.processes import free_port
from tests.server.stops.test_stop_socket import Bench


def ignore(_: Sighting) -> None:
    """Take no note of what is seen."""


@contextmanager
def by_datagram(
    link: Link, order: StopOrder | None = None, see: Callable[[Sighting], None] = ignore
) -> Iterator[DatagramStop]:
    """A stop by datagram that has begun."""
    way = DatagramStop(link, StopOrder() if order is None else order, see)
    way.begin()
    try:
        yield way
    finally:
        way.end()


@contextmanager
def listening() -> Iterator[tuple[Bench, StopOrder]]:
    """A robot that listens for datagrams, and an order to stop it that is not pressed yet."""
    bench = Bench()
    with bench.stop_socket:
        yield bench, StopOrder()


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_name_that_no_host_can_have_is_trouble() -> None:
    with by_datagram(Link(endpoint="tcp/robot..local:7447", insecure=True)) as way:
        assert comes_true(lambda: "robot..local" in (way.trouble or ""), 10.0)


def test_a_robot_that_has_another_address_now_is_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    before, asked, seen = free_port(), list[str](), list[Sighting]()

    def look_up(host: str, port: int, **_given: Any) -> list[Any]:
        asked.append(host)
        place = ("127.0.0.1", before if len(asked) < 3 else port)
        return [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", place)]

    with listening() as (bench, order):
        monkeypatch.setattr(stop_connections, "LOOK_UP_AGAIN_S", 0.05)
        monkeypatch.setattr("socket.getaddrinfo", look_up)
        with by_datagram(bench.link, order, seen.append) as way:
            assert comes_true(lambda: bool(seen), 10.0)
            assert len(asked) >= 3
            order.press()
            way.wake()
            assert comes_true(lambda: way.obeyed == order.request, 10.0)
    assert bench.guard.stopped == "estop"


def test_each_address_of_a_robot_is_asked_with_its_own_nonce(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
        robots = (one, other)
        for robot in robots:
            robot.settimeout(10.0)
            robot.bind(("127.0.0.1", 0))
        found = [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", robot.getsockname()) for robot in robots]
        monkeypatch.setattr("socket.getaddrinfo", lambda *_given, **_more: found)
        with by_datagram(Link()):
            asked = [robot.recv(DATAGRAM_BYTES) for robot in robots]
    assert len({StopDatagram.unpacked(data, b"").nonce for data in asked}) == 2


def test_an_error_of_any_kind_is_trouble_and_the_robot_is_asked_again() -> None:
    seen: list[Sighting] = []

    def see(sighting: Sighting) -> None:
        seen.append(sighting)
        if len(seen) == 1:
            raise RuntimeError("can't start new thread")

    with listening() as (bench, order), by_datagram(bench.link, order, see) as way:
        assert comes_true(lambda: bool(seen), 10.0)
        order.press()
        assert comes_true(lambda: way.obeyed == order.request, 10.0)
        assert "can't start new thread" in (way.trouble or "")
    assert bench.guard.stopped == "estop"


def test_a_program_with_many_open_files_stops_a_robot() -> None:
    with many_open_files(), listening() as (bench, order):
        order.press()
        with by_datagram(bench.link, order) as way:
            assert comes_true(lambda: way.obeyed == order.request, 10.0)


def test_a_stop_that_is_made_again_after_a_clear_is_claimed_again() -> None:
    with listening() as (bench, order):
        order.press()
        with by_datagram(bench.link, order) as way:
            assert comes_true(lambda: way.obeyed is not None, 10.0)
            first = bench.latch.current()
            assert first is not None
            assert bench.latch.clear(first.stop_id, first.since_s + OTHERS_LOCKOUT_S) is None
            assert comes_true(lambda: way.obeyed not in (None, bytes.fromhex(first.claims[0])), 10.0)
            again = bench.latch.current()
    assert again is not None
    assert again.claims == (order.request.hex(),)
    assert again.repeats == 1, "it holds longer"


def test_an_answer_of_before_a_press_stops_no_press_from_being_sent() -> None:
    bench, order, seen = Bench(), StopOrder(), list[Sighting]()
    way = DatagramStop(bench.link, order, seen.append)

    def exchanged() -> StopDatagram:
        asked = way._next_datagram()
        way._take(bench.stop_socket.answer(asked) or b"")
        return StopDatagram.unpacked(asked, b"")

    exchanged()
    order.press()
    assert exchanged().kind is Kind.STOP
    order.ordered.clear()
    late = bench.stop_socket.answer(way._next_datagram()) or b""
    first = bench.latch.current()
    assert first is not None
    assert bench.latch.clear(first.stop_id, first.since_s + OTHERS_LOCKOUT_S) is None
    order.press()
    way._take(late)
    assert seen[-1].stopped == "estop"
    assert seen[-1].at_s < order.pressed_s, "it was asked for before the press"
    for _ in range(2):  # the first is of an epoch that has ended
        assert exchanged().kind is Kind.STOP
    again = bench.latch.current()
    assert again is not None
    assert again.claims == (order.request.hex(),) != first.claims
    way.end()


def test_a_folder_without_the_secret_and_quic_are_trouble(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    for path in tmp_path.rglob(SECRET_FILE):
        path.unlink()
    without = Link(endpoint="tls/localhost:7447", credentials=tmp_path / "keys")
    for link in (without, Link(endpoint="quic/localhost:7447")):
        with by_datagram(link) as way:
            assert way.trouble


class BrokenSession:
    """A session whose first question fails in a way of its own, as a library's may."""

    asked = 0

    def get(self, *_args: object, **_options: object) -> list[Any]:
        BrokenSession.asked += 1
        if BrokenSession.asked == 1:
            raise zenoh.ZError("closed")
        return []


def test_an_error_of_the_library_is_told_and_a_session_is_opened_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hexctl.client.remote.open_session", lambda *_: nullcontext(BrokenSession()))
    monkeypatch.setattr(stop_connections, "SESSION_ASK_S", 0.2)
    seen: list[Sighting] = []
    way = SessionStop(Link(), StopOrder(), seen.append, again=True)
    way.begin()
    try:
        assert comes_true(lambda: "closed" in str(way.error), 10.0)
        assert not way.ended
        assert comes_true(lambda: BrokenSession.asked > 1, 10.0)
        assert comes_true(lambda: "no robot answers" in str(way.error), 10.0)
    finally:
        way.end()
    assert seen == []


@dataclass
class OnTheLink:
    """A robot as a session sees it; it does not answer the first `deaf` requests to stop.

    Attributes:
        about: more of its status.
        refusal: what it answers to a clear and to a failure.
    """

    name: str
    deaf: int = 0
    stopped: str | None = None
    at_rest: bool | None = True
    silent: bool = False
    asked: int = 0
    requests: list[str] = field(default_factory=list)
    claims: list[str] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    refusal: dict[str, Any] = field(default_factory=dict)

    def answer(self, key: str, content: dict[str, Any]) -> dict[str, Any] | None:
        if self.silent or key.split("/")[1] not in ("*", self.name):
            return None
        if key.endswith("/failure"):
            return self.refusal or {"failures": [content.get("failure", "none")]}
        if content.get("op") == "clear":
            self.stopped = self.stopped if self.refusal else None
            return self.refusal or {"robot": self.name, "stopped": None, "asked": content}
        if key.endswith("/estop"):
            self.asked += 1
            if self.asked <= self.deaf:
                return None
            if self.stopped is None:
                self.claims.clear()
            if content["request"] not in self.requests:  # one that is repeated claims nothing
                self.claims.append(content["request"])
            self.requests.append(content["request"])
            self.stopped = "estop"
            return {"robot": self.name, "stopped": self.stopped}
        stop = None
        if self.stopped is not None:
            stop = {"id": STOP_ID, "claims": list(self.claims), "clear_in_s": 0.0, "others_in_s": 0.01}
        status = {"robot": self.name, "stopped": self.stopped, "at_rest": self.at_rest, "stop": stop}
        return {"status": {**status, **self.about}}


class SharedSession:
    """A session to several robots."""

    def __init__(self, robots: tuple[OnTheLink, ...]) -> None:
        self._robots = robots

    def get(self, key: str, *, payload: bytes | None = None, **_options: object) -> list[Any]:
        content = json.loads(payload or b"{}")
        given = (robot.answer(key, content) for robot in self._robots)
        answers = [answer for answer in given if answer is not None]
        return [
            SimpleNamespace(ok=SimpleNamespace(payload=json.dumps(answer).encode())) for answer in answers
        ]


@contextmanager
def asking(
    monkeypatch: pytest.MonkeyPatch, *robots: OnTheLink
) -> Iterator[tuple[SessionStop, StopOrder, list[Sighting]]]:
    """A session way to robots, what tells it to stop them, and what it has seen."""
    monkeypatch.setattr("hexctl.client.remote.open_session", lambda *_: nullcontext(SharedSession(robots)))
    monkeypatch.setattr(stop_connections, "SESSION_ASK_S", 0.01)
    monkeypatch.setattr(stop_connections, "SESSION_WATCH_S", 0.01)
    seen: list[Sighting] = []
    order = StopOrder()
    way = SessionStop(Link(), order, seen.append, again=False)
    way.begin()
    try:
        assert comes_true(lambda: bool(seen), 10.0)
        yield way, order, seen
    finally:
        way.end()
        assert comes_true(lambda: way.ended, 10.0)


def sees(seen: list[Sighting], reason: str | None, *, looks: int = 3) -> bool:
    """Whether so many more looks come, the last of which has a reason for the stop."""
    before = len(seen)
    return comes_true(lambda: len(seen) >= before + looks and seen[-1].stopped == reason, 10.0)


def test_a_robot_that_missed_the_first_request_is_asked_until_it_has_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ant, ben = OnTheLink("ant"), OnTheLink("ben", deaf=3)
    with asking(monkeypatch, ant, ben) as (way, order, seen):
        assert sees(seen, None)
        assert ant.asked == 0, "nothing is pressed yet"
        order.press()
        assert sees(seen, "estop")
        assert (ant.stopped, ben.stopped, ben.asked) == ("estop", "estop", 4)
        assert sorted(answer["robot"] for answer in way.answers) == ["ant", "ben"]
        assert way.error is None
        assert sees(seen, "estop")
        assert ben.asked == 4, "both have answered and stay stopped"


def test_a_robot_that_was_cleared_meanwhile_is_stopped_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ant = OnTheLink("ant")
    with asking(monkeypatch, ant) as (_, order, seen):
        order.press()
        assert sees(seen, "estop")
        ant.stopped = None
        assert comes_true(lambda: ant.asked >= 2, 10.0)
        assert sees(seen, "estop")
    assert len(set(ant.requests)) == 2, "under a claim of its own: nobody clears it after a second"


def test_a_stop_that_was_cleared_between_two_looks_is_claimed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ant = OnTheLink("ant")
    with asking(monkeypatch, ant) as (way, order, seen):
        order.press()
        assert sees(seen, "estop")
        order.ordered.clear()
        assert sees(seen, "estop")
        ant.claims[:], ant.stopped = ["0" * 16], "estop"  # cleared, and stopped by another client
        order.press()
        assert comes_true(lambda: len(set(ant.requests)) == 2, 10.0)
        assert sees(seen, "estop")
    assert way.obeyed == order.request


def test_robots_that_answer_late_or_that_others_stop_too_cost_no_claims(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ant, ben = OnTheLink("ant"), OnTheLink("ben", deaf=5)
    with asking(monkeypatch, ant, ben) as (_, order, seen):
        order.press()
        assert sees(seen, "estop")
        ant.claims.append("0" * 16)
        assert sees(seen, "estop", looks=10)
    assert set(ant.requests) == set(ben.requests) == {order.request.hex()}


def test_a_robot_that_falls_silent_is_not_taken_for_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    ant, ben = OnTheLink("ant"), OnTheLink("ben", deaf=1000)
    with asking(monkeypatch, ant, ben) as (way, order, seen):
        order.press()
        assert comes_true(lambda: ant.stopped is not None, 10.0)
        ben.silent = True
        assert sees(seen, None)
        assert "ben" in str(way.error)


def test_robots_are_at_rest_together_only_if_each_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for first, second in ((None, False), (False, True), (None, True), (True, True)):
        robots = OnTheLink("ant", at_rest=first), OnTheLink("ben", at_rest=second)
        with asking(monkeypatch, *robots) as (_, _, seen):
            assert seen[0].at_rest is (first is True and second)


STOP_ID = "00" * 8


def seen(at_s: float, **values: Any) -> Sighting:
    """What a robot says at a time: it is stopped, and at rest."""
    known: dict[str, Any] = {"stopped": "estop", "stop_id": STOP_ID, "at_rest": True}
    return Sighting(at_s=at_s, on_disk=True, robot="ant", **{**known, **values})


def free(at_s: float, **values: Any) -> Sighting:
    """What a robot says that is not stopped."""
    return seen(at_s, stopped=None, stop_id=None, **values)


def test_a_clear_is_reported_once_with_the_name_that_comes_later() -> None:
    watch = StopWatch(STOP_ID)
    assert watch.change([seen(0.0)], 0.1) is None
    assert watch.change([free(0.2)], 0.3) is None, "the session has not said who it was"
    named = free(0.5, cleared=(STOP_ID, "mia\x1b[2J"))
    line = watch.change([free(0.6), named], 0.6)
    assert line is not None
    assert "mia" in line
    assert "\x1b" not in line
    assert watch.change([free(0.8), named], 0.9) is None
    moving = watch.change([free(1.0, at_rest=False), named], 1.1)
    assert moving is not None
    assert "mia" in moving
    assert watch.change([seen(1.2)], 1.3) is not None, "stopped again"


def test_a_clear_is_reported_without_a_name_if_none_comes() -> None:
    watch = StopWatch(STOP_ID)
    watch.change([seen(0.0)], 0.0)
    other = (f"{1:016x}", "of another stop")
    assert watch.change([free(0.1, cleared=other)], 0.1) is None
    line = watch.change([free(NAME_WAIT_S, cleared=other)], NAME_WAIT_S)
    assert line is not None
    assert other[1] not in line


def test_a_robot_that_moves_though_it_is_stopped_and_one_that_is_silent_are_reported() -> None:
    watch = StopWatch(STOP_ID)
    assert watch.change([seen(0.0, at_rest=False)], 0.1) is not None
    assert watch.change([seen(0.0, at_rest=False)], 0.1 + SILENCE_S) is not None
    assert watch.change([seen(2.0)], 2.0) is not None
