"""Stops, clears and failures of robots that a test makes up, in one process and without Zenoh."""

import socket
import time
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import pytest

from hexctl.client import stop_client, stop_connections
from hexctl.client.remote import remote_robots
from hexctl.client.stop_client import ReadyStop, clear_stop, estop
from hexctl.errors import HexctlError, InputError, RobotFaultError
from hexctl.waiting import comes_true
from hexctl.wire.description import RobotIdentity
from hexctl.wire.links import Link, Role
from hexctl.wire.stop import OTHERS_LOCKOUT_S, claim_of
from tests.client.test_stop_connections import STOP_ID, OnTheLink, SharedSession, free, listening, seen
from tests.server.processes import free_port


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a fraction of the usual times, and find no robot unless the test makes one up."""
    for name in ("RESTS_S", "REST_TIMEOUT_S", "REACH_S", "DATAGRAM_S", "CONFIRM_S", "END_S", "WATCH_S"):
        monkeypatch.setattr(stop_client, name, 0.1 * getattr(stop_client, name))
    for name in ("SESSION_ASK_S", "SESSION_WATCH_S"):
        monkeypatch.setattr(stop_connections, name, 0.01)
    make_up(monkeypatch)


def make_up(monkeypatch: pytest.MonkeyPatch, *robots: OnTheLink) -> None:
    """Let every session have these robots on its link; without any, none opens."""

    def opened(*_: object) -> Any:
        if not robots:
            raise RobotFaultError("nothing listens there")
        return nullcontext(SharedSession(robots))

    monkeypatch.setattr("hexctl.client.remote.open_session", opened)


def ours(name: str, **values: Any) -> OnTheLink:
    """A robot that this user started on this computer."""
    identity = RobotIdentity.of_this_process(name, "mock")
    about = {"host": identity.host, "user": identity.user, "backend": "mock", **values.pop("about", {})}
    return OnTheLink(name, about=about, **values)


@pytest.fixture
def unheard() -> Iterator[ReadyStop]:
    """A stop without a robot: what it sees comes from the test."""
    ready = ReadyStop(connect=f"tcp/127.0.0.1:{free_port()}", stays=False)
    ready._datagrams.obeyed = b"\0" * 8  # a stop of before, which has been cleared since
    yield ready
    ready._datagrams.end()


def test_what_one_way_sees_is_no_rest_while_the_other_sees_a_robot_that_is_not_stopped(
    unheard: ReadyStop,
) -> None:
    now_s = time.monotonic()
    unheard.press()
    unheard._datagrams.obeyed = b"\0" * 8
    for later_s in (0.0, 0.3, 0.6):
        unheard._see("datagram", seen(now_s + later_s))
    unheard._see("session", free(now_s + 0.4))
    assert unheard._rested_since_s() is None, "of several robots one has not stopped"
    unheard._see("session", seen(now_s + 0.5))
    assert unheard._rested_since_s() == now_s
    unheard._see("session", free(now_s - 0.1))
    assert unheard._rested_since_s() == now_s, "asked for before the robot was at rest"


def test_what_was_asked_before_a_press_does_not_confirm_it(unheard: ReadyStop) -> None:
    asked_s = time.monotonic()
    unheard.press()
    unheard._see("datagram", seen(asked_s))
    assert unheard._order.ordered.is_set(), "the stop goes on being sent"
    unheard._see("datagram", seen(time.monotonic()))
    assert not unheard._order.ordered.is_set()


def test_a_robot_is_stopped_both_ways_and_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    ant = ours("ant")
    make_up(monkeypatch, ant)
    with listening() as (bench, _):
        ready = ReadyStop(link=bench.link)
        ready.press_by_datagram(5.0)
        assert bench.guard.stopped == "estop"
        with ready:
            result = ready.wait_for_rest(identity_s=5.0)
            assert ant.stopped == "estop"
            assert (result.stopped, result.at_rest, result.robot) == ("estop", True, "ant")
            assert [answer["robot"] for answer in result.answers] == ["ant"]
            assert comes_true(lambda: ready.reach.ways == ("datagram", "session"), 5.0)
            assert str(ready.reach) == "ant is reached by datagram and session"
            assert ready.trouble is None
            assert ready.clear_command.startswith("hexctl estop --clear")
            watched = ready.watch(result)
            stop = bench.latch.current()
            assert stop is not None
            bench.latch.clear(stop.stop_id, stop.since_s + OTHERS_LOCKOUT_S)
            ant.about["cleared"], ant.stopped = {"id": result.stop_id, "by": "mia"}, None
            assert "by mia" in next(watched)


def test_a_robot_that_only_one_way_reaches_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    with listening() as (bench, _):
        assert estop(connect=bench.link.endpoint).ways == ("datagram",)
        assert bench.guard.stopped == "estop"
    ant = ours("ant")
    make_up(monkeypatch, ant)
    assert estop(connect=f"tcp/127.0.0.1:{free_port()}").ways == ("session",)
    assert ant.stopped == "estop"


def test_a_robot_that_is_not_there_does_not_answer_or_goes_on_moving_is_an_error_and_no_success(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nowhere = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(RobotFaultError, match="nothing listens there"):
        estop(connect=nowhere)
    with pytest.raises(InputError, match="connect"):
        estop(connect="somewhere")
    with socket.create_server(("127.0.0.1", 0)) as silent, pytest.raises(RobotFaultError, match="overloaded"):
        estop(connect=f"tcp/127.0.0.1:{silent.getsockname()[1]}")
    make_up(monkeypatch, ours("ant", at_rest=False))
    with pytest.raises(RobotFaultError, match="did not come to rest"):
        estop(connect=nowhere)
    make_up(monkeypatch, ours("ant", silent=True))
    with pytest.raises(RobotFaultError, match="no robot answers"):
        estop(connect=nowhere)


def test_a_press_that_no_robot_confirms_is_trouble_until_one_does() -> None:
    with ReadyStop(connect=f"tcp/127.0.0.1:{free_port()}", stays=False) as ready:
        assert "NOT REACHABLE" in str(ready.reach)
        assert ready.trouble is None
        ready.press()
        assert comes_true(lambda: ready.link.endpoint in (ready.trouble or ""), 5.0)
        ready._datagrams.obeyed = b"\0" * 8
        ready._see("datagram", seen(time.monotonic()))
        assert ready.trouble is None


def test_a_stop_is_cleared_with_the_keys_of_this_user_and_anothers_after_a_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ant, link = ours("ant"), Link()
    make_up(monkeypatch, ant, ours("ben"))
    estop()
    (cleared, _) = clear_stop()
    assert [claim_of(key) for key in cleared["asked"]["keys"]] == cleared["cleared"]["claims"]
    assert cleared["asked"]["id"] == STOP_ID
    assert ant.stopped is None
    ant.stopped, ant.claims = "estop", ["0" * 16]
    waits: list[tuple[str, float]] = []
    with remote_robots(link, Role.CONTROLLER) as robots:
        robots.clear(waiting=lambda by, wait_s: waits.append((by, wait_s)))
    assert waits == [("another client", 0.01)]
    assert ant.stopped is None


@pytest.mark.parametrize(
    ("robot", "error"),
    [
        (ours("ant", stopped="estop", refusal={"error": "not yet"}), "did not clear its stop: not yet"),
        (OnTheLink("ant", stopped="estop"), "connect"),
        (OnTheLink("ant", silent=True), "no robot answers"),
    ],
    ids=["it refuses", "of another user", "silent"],
)
def test_a_stop_that_is_not_cleared_is_an_error(
    robot: OnTheLink, error: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.client.remote.ANSWER_TIMEOUT_S", 0.1)
    make_up(monkeypatch, robot)
    with pytest.raises(HexctlError, match=error):
        clear_stop()
    assert robot.silent or robot.stopped == "estop"


def test_legs_of_simulations_fail_and_heal_and_those_of_a_robot_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    simulated = ours("ant", about={"simulated": {}})
    make_up(monkeypatch, simulated)
    with remote_robots(Link(), Role.CONTROLLER) as robots:
        assert robots.fail("5:limp") == [{"failures": ["5:limp"]}]
        assert robots.heal(5) == [{"failures": ["none"]}]
        with pytest.raises(InputError):
            robots.fail("7:limp")
        simulated.refusal = {"error": "too many"}
        with pytest.raises(RobotFaultError, match="too many"):
            robots.heal(5)
        simulated.about.pop("simulated")
        with pytest.raises(RobotFaultError, match="not simulated"):
            robots.heal(5)
