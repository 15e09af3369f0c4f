"""Stopping from anywhere, and robots on a link seen from outside: real processes."""

import os
import random
import re
import select
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import hexctl
from faults.programs.relay import Condition, Queue, UdpRelay
from hexctl.client.remote import RemoteRobots, remote_robots
from hexctl.client.stop_client import ReadyStop, clear_stop, estop
from hexctl.errors import InputError
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session
from tests.cli.terminals import OnTerminal
from tests.server.processes import (
    Served,
    controlling,
    free_port,
    relayed,
    repeated,
    served,
    stopped_by_session,
    swayed,
    wait_until,
)
from tests.server.processes import hexctl as hexctl_command
from tests.server.test_link_faults import STILL_ON_A_BUSY_MACHINE_S, stopped, wait_for_motion

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A robot that a controller sways whenever it is not stopped."""
    with swayed(tmp_path_factory.mktemp("robot")) as robot:
        yield robot


@pytest.fixture
def walking(robot: Served) -> Iterator[Served]:
    """The robot while it moves; what stops it is cleared afterwards."""
    wait_for_motion(robot)
    yield robot
    if stopped(robot) == "estop":
        clear_stop(connect=robot.endpoint)
    assert stopped(robot) != "estop"


def rests(robot: Served, since_s: float) -> bool:
    """Whether a robot has come to rest soon after a moment, and stays so."""
    time.sleep(0.2)
    return robot.log().moved_after(since_s) <= STILL_ON_A_BUSY_MACHINE_S


def test_both_ways_confirm_one_stop_that_is_cleared_by_its_id(walking: Served) -> None:
    at_s = time.monotonic()
    result = hexctl.estop(connect=walking.endpoint)
    assert rests(walking, at_s)
    assert (result.stopped, result.robot, result.at_rest) == ("estop", "ant", True)
    assert result.echoed, "these servos measure nothing"
    assert "datagram" in result.ways
    assert result.took_s <= result.rested_s + 0.5
    status = walking.status()
    assert status["stop"]["id"] == result.stop_id
    assert status["at_rest"] is True
    assert status["stop_port"] == walking.port
    (cleared,) = clear_stop(connect=walking.endpoint)
    assert cleared["stopped"] is None
    assert cleared["cleared"]["id"] == result.stop_id


def test_a_session_stops_where_no_datagram_comes_through(walking: Served) -> None:
    with relayed(walking.endpoint) as (endpoint, _):
        at_s = time.monotonic()
        result = estop(connect=endpoint)
        assert rests(walking, at_s)
    assert result.ways == ("session",)
    assert result.at_rest
    assert result.echoed
    assert result.answers[0]["stopped"] == "estop"


def test_a_datagram_stops_where_no_session_comes_through(walking: Served) -> None:
    relay = UdpRelay(walking.port, Queue(Condition(), random.Random()))

    def pass_on() -> None:
        for ready in select.select(relay.sockets(), [], [], 0.05)[0]:
            relay.come(ready)

    with repeated(pass_on, 0.0):
        at_s = time.monotonic()
        result = estop(connect=f"tcp/127.0.0.1:{relay.number}")
        assert rests(walking, at_s)
    for one in relay.sockets():
        one.close()
    assert result.ways == ("datagram",)
    assert result.answers == ()


def test_stops_of_a_client_that_is_ready_have_one_claim_and_after_a_clear_another(walking: Served) -> None:
    with ReadyStop(connect=walking.endpoint, stays=False) as ready:
        wait_until(lambda: ready.reach.ways == ("datagram", "session"), "both ways")
        assert stopped(walking) != "estop", "nothing is pressed yet"
        at_s = time.monotonic()
        ready.press()
        assert ready.wait_for_rest().stopped == "estop"
        assert rests(walking, at_s)
        first = walking.status()["stop"]
        for _ in range(10):
            ready.press()
            again = walking.status()["stop"]
        assert again["claims"] == first["claims"]
        assert len(first["claims"]) == 1
        assert ready.trouble is None
        clear_stop(connect=walking.endpoint)
        ready.press()
        wait_until(lambda: (walking.status()["stop"] or {}).get("claims"), "a claimed stop")
        assert walking.status()["stop"]["id"] != first["id"]


def test_a_stop_that_is_ready_says_when_the_robot_is_out_of_reach_and_back(tmp_path: Path) -> None:
    port = free_port()
    with ReadyStop(connect=f"tcp/127.0.0.1:{port}", stays=False) as ready:
        assert "NOT REACHABLE" in str(ready.reach)
        ready.press()
        assert "127.0.0.1" in wait_until(lambda: ready.trouble, "trouble")
    with ReadyStop(connect=f"tcp/127.0.0.1:{port}") as ready:
        with served(tmp_path, port=port):
            wait_until(lambda: ready.reach.ways == ("datagram", "session"), "the robot")
        wait_until(lambda: ready.reach.ways == (), "its end")
        assert "NOT REACHABLE" in str(ready.reach)


#: Keys that stop; Ctrl-S usually pauses what is printed.
KEYS = {"a key": " ", "Ctrl-S": "\x13"}


@pytest.mark.parametrize("how", [*KEYS, "the terminal goes"])
def test_one_key_stops_and_so_does_a_terminal_that_goes(walking: Served, tmp_path: Path, how: str) -> None:
    with OnTerminal(tmp_path, "--ready", "--connect", walking.endpoint, command="estop") as terminal:
        terminal.wait("any key stops it")
        assert stopped(walking) != "estop"
        at_s = time.monotonic()
        if how in KEYS:
            terminal.type(KEYS[how])
            terminal.wait(r"stopped \(estop\), its targets no longer change")
        else:
            terminal.close()
        wait_until(lambda: stopped(walking) == "estop", "the stop")
        assert rests(walking, at_s)
        if how == "a key":
            terminal.wait("Ctrl-C ends the watch")
            clear_stop(connect=walking.endpoint)
            terminal.wait(rf"(?i)cleared by .*process {os.getpid()}")
            terminal.wait("(?i)the robot moves again")
            assert stopped(walking) != "estop", "it is not stopped again"
            terminal.process.send_signal(signal.SIGINT)
            assert terminal.code() == 0


def test_a_neighbours_robot_may_be_stopped_by_default_and_cleared_only_by_its_name(
    walking: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.wire.description.user_name", lambda: "neighbour")
    by_default = Link(endpoint=walking.endpoint, named=False)
    with open_session(by_default, Role.CONTROLLER, KeyMap.of("*")) as session:
        robots = RemoteRobots(session, by_default)
        assert [answer["stopped"] for answer in robots.stop("mine")] == ["estop"]
        with pytest.raises(InputError, match="name it"):
            robots.clear()
        assert robots.await_statuses()[0]["stopped"] == "estop"
    with remote_robots(Link(endpoint=walking.endpoint), Role.CONTROLLER) as named:
        assert [answer["stopped"] for answer in named.clear()] == [None]


def test_commands_say_which_robot_answered_and_a_real_robot_lets_no_leg_fail(walking: Served) -> None:
    here = ("--connect", walking.endpoint)
    failed = hexctl_command("sim", "fail", "5:limp", *here)
    assert failed.returncode == 3
    assert "not simulated" in failed.stderr
    stop = stopped_by_session(
        lambda: hexctl_command("estop", *here), lambda done: "started by" in done.stderr
    )
    clear = hexctl_command("estop", "--clear", *here)
    for done in (stop, clear):
        assert done.returncode == 0, done.stderr
        assert f"process {walking.process.pid}" in done.stderr


def test_legs_of_a_served_simulation_fail_and_heal_on_request_and_its_log_tells_it(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot:
        changes = (("fail", "5:limp"), ("fail", "2:stuck:femur"), ("heal", "5"), ("fail", "7:limp"))
        told = [hexctl_command("sim", *change, "--connect", robot.endpoint) for change in changes]
        with remote_robots(Link(endpoint=robot.endpoint), Role.CONTROLLER) as robots:
            assert robots.statuses()[0]["simulated"]["failure"] == "leg 2 femur stuck"
            assert robots.statuses()[0]["failures"] == ["2:stuck:femur:0"]
            assert [answer["failures"] for answer in robots.heal(2)] == [[]]
            with pytest.raises(InputError, match="LEG:KIND"):
                robots.fail("limp")
        robot.wait_for("leg 5 limp")
        robot.wait_for("all are whole")
        with controlling(tmp_path, robot.endpoint):
            robot.wait_for("commanded by")
            robot.signal(signal.SIGINT)
            assert robot.wait() == 0
    assert [done.returncode for done in told] == [0, 0, 0, 2]
    assert told[1].stdout == "failed now: leg 2 femur stuck, leg 5 limp\n"
    assert re.search(r" ended while hexctl on .* commanded it; ", robot.said().splitlines()[-1])
