"""The session of a stop: it outlasts what goes wrong in it."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

import hexctl.client.remote  # noqa: F401  it keeps the session's opener that it finds when it is first imported
from hexctl.client import session_stop
from hexctl.client.clear_keys import StopOrder
from hexctl.client.datagram_stop import Sighting
from hexctl.client.session_stop import SessionStop
from hexctl.waiting import comes_true
from hexctl.wire.links import Link


class BrokenSession:
    """A session whose first question fails in a way of its own, as a library's may."""

    asked = 0

    def get(self, *_args: object, **_options: object) -> list[Any]:
        """No answer, after one error."""
        BrokenSession.asked += 1
        if BrokenSession.asked == 1:
            raise zenoh.ZError("closed")
        return []


def test_an_error_of_the_library_is_told_and_a_session_is_opened_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @contextmanager
    def opened(*_: object) -> Iterator[BrokenSession]:
        yield BrokenSession()

    monkeypatch.setattr("hexctl.client.remote.open_session", opened)
    monkeypatch.setattr(session_stop, "ASK_PERIOD_S", 0.2)
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
    """A robot as a session sees it; it does not answer the first `deaf` requests to stop."""

    name: str
    deaf: int = 0
    stopped: str | None = None
    at_rest: bool | None = True
    silent: bool = False
    asked: int = 0
    requests: list[str] = field(default_factory=list)
    claims: list[str] = field(default_factory=list)

    def answer(self, key: str, content: dict[str, Any]) -> dict[str, Any] | None:
        """Answer to a query at a key."""
        if self.silent:
            return None
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
        stop = {"claims": list(self.claims)} if self.stopped is not None else None
        return {
            "status": {"robot": self.name, "stopped": self.stopped, "at_rest": self.at_rest, "stop": stop}
        }


class SharedSession:
    """A session to several robots."""

    def __init__(self, robots: tuple[OnTheLink, ...]) -> None:
        self._robots = robots

    def get(self, key: str, *, payload: bytes | None = None, **_options: object) -> list[Any]:
        """Answers of the robots that give one."""
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

    @contextmanager
    def opened(*_: object) -> Iterator[SharedSession]:
        yield SharedSession(robots)

    monkeypatch.setattr("hexctl.client.remote.open_session", opened)
    monkeypatch.setattr(session_stop, "ASK_PERIOD_S", 0.01)
    monkeypatch.setattr(session_stop, "WATCH_PERIOD_S", 0.01)
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
        order.wanted.clear()
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
        assert str(way.error) == "asked to stop, and not seen stopped: ben"


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [(None, False, False), (False, True, False), (None, True, False), (True, True, True)],
)
def test_robots_are_at_rest_together_only_if_each_says_so(
    monkeypatch: pytest.MonkeyPatch, first: bool | None, second: bool, together: bool
) -> None:
    robots = OnTheLink("ant", at_rest=first), OnTheLink("ben", at_rest=second)
    with asking(monkeypatch, *robots) as (_, _, seen):
        assert seen[0].at_rest is together
