"""The session of a stop: it outlasts what goes wrong in it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zenoh

from hexctl.serve.stops import session_way
from hexctl.serve.stops.datagram_way import Sighting
from hexctl.serve.stops.session_way import SessionWay
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

    monkeypatch.setattr("hexctl.wire.session.open_session", opened)
    monkeypatch.setattr(session_way, "ASK_PERIOD_S", 0.2)
    seen: list[Sighting] = []
    way = SessionWay(Link(), b"mine    ", threading.Event(), seen.append, again=True)
    way.begin()
    try:
        assert comes_true(lambda: "closed" in str(way.error), 10.0)
        assert not way.ended
        assert comes_true(lambda: BrokenSession.asked > 1, 10.0)
        assert comes_true(lambda: "no robot answers" in str(way.error), 10.0)
    finally:
        way.end()
    assert seen == []
