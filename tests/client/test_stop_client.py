"""Stopping from anywhere: by each of the two ways alone, connected beforehand, and what failure says."""

import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import hexctl
from hexctl.client.datagram_stop import Sighting
from hexctl.client.stop_client import ReadyStop, clear_stop, estop
from hexctl.errors import InputError, RobotFaultError
from hexctl.waiting import wait_for
from tests.cli.terminals import OnTerminal
from tests.server.cable import Cable
from tests.server.processes import Served, controlling, free_port, served, wait_until
from tests.server.processes import hexctl as hexctl_command
from tests.server.test_link_faults import STILL_ON_A_BUSY_MACHINE_S, stopped

pytestmark = pytest.mark.realtime


@contextmanager
def walking(folder: Path, *options: str) -> Iterator[Served]:
    """A robot that is swayed by a controller."""
    with served(folder, *options) as robot, controlling(folder, robot.endpoint, "again=1") as controller:
        controller.wait_for("moving")
        yield robot


def rests(robot: Served, since_s: float) -> bool:
    """Whether a robot has come to rest soon after a moment, and stays so."""
    time.sleep(0.2)
    return robot.log().moved_after(since_s) <= STILL_ON_A_BUSY_MACHINE_S


def test_both_ways_confirm_one_stop_that_is_cleared_by_its_id(tmp_path: Path) -> None:
    with walking(tmp_path) as robot:
        at_s = time.monotonic()
        result = hexctl.estop(connect=robot.endpoint)
        assert rests(robot, at_s)
        assert (result.stopped, result.robot, result.at_rest) == ("estop", "ant", True)
        assert result.echoed, "these servos measure nothing"
        assert "datagram" in result.ways
        assert result.took_s <= result.rested_s + 0.5
        status = robot.status()
        assert status["stop"]["id"] == result.stop_id
        assert status["at_rest"] is True
        assert status["stop_port"] == int(robot.endpoint.rpartition(":")[2])
        (cleared,) = clear_stop(connect=robot.endpoint)
        assert cleared["stopped"] is None
        assert cleared["cleared"]["id"] == result.stop_id


def test_a_session_stops_where_no_datagram_comes_through(tmp_path: Path) -> None:
    with walking(tmp_path) as robot, Cable(robot.endpoint) as cable:  # which carries TCP alone
        at_s = time.monotonic()
        result = estop(connect=cable.endpoint)
        assert rests(robot, at_s)
        assert result.ways == ("session",)
        assert result.at_rest
        assert result.echoed
        assert result.answers[0]["stopped"] == "estop"


def test_a_datagram_stops_where_no_session_comes_through(tmp_path: Path) -> None:
    with walking(tmp_path) as robot:
        port = int(robot.endpoint.rpartition(":")[2])
        with UdpRelay(port) as relay:  # which carries UDP alone
            at_s = time.monotonic()
            result = estop(connect=f"tcp/127.0.0.1:{relay.port}")
            assert rests(robot, at_s)
        assert result.ways == ("datagram",)
        assert result.answers == ()


def test_a_stop_that_is_ready_says_how_it_reaches_the_robot_and_needs_no_new_connection(
    tmp_path: Path,
) -> None:
    with walking(tmp_path) as robot, ReadyStop(connect=robot.endpoint) as ready:
        wait_until(lambda: ready.reach.ways == ("datagram", "session"), "both ways")
        assert str(ready.reach) == "ant is reached by datagram and session"
        assert stopped(robot) != "estop", "nothing is pressed yet"
        at_s = time.monotonic()
        ready.press()
        assert ready.wait_for_rest().stopped == "estop"
        assert rests(robot, at_s)


def test_a_stop_that_is_ready_says_when_the_robot_is_out_of_reach_and_back(tmp_path: Path) -> None:
    port = free_port()
    with ReadyStop(connect=f"tcp/127.0.0.1:{port}") as ready:
        assert "NOT REACHABLE" in str(ready.reach)
        with served(tmp_path, port=port):
            wait_until(lambda: "datagram" in ready.reach.ways, "the robot")
        wait_until(lambda: ready.reach.ways == (), "its end")
        assert "NOT REACHABLE" in str(ready.reach)
        with served(tmp_path, port=port, name="back"):
            wait_until(lambda: ready.reach.ways == ("datagram", "session"), "its return")


def seen(at_s: float, stopped: str | None = "estop") -> Sighting:
    """What a robot at rest says at a time."""
    return Sighting(at_s=at_s, stopped=stopped, stop_id="00" * 8, at_rest=True, kept=True, robot="ant")


def test_what_one_way_sees_is_no_rest_while_the_other_sees_a_robot_that_is_not_stopped() -> None:
    ready, now_s = ReadyStop(connect=f"tcp/127.0.0.1:{free_port()}"), time.monotonic()
    try:
        ready.press()
        ready._datagrams.obeyed = b"\0" * 8
        for later_s in (0.0, 0.3, 0.6):
            ready._see("datagram", seen(now_s + later_s))
        ready._see("session", seen(now_s + 0.4, None))
        assert ready._rested_since_s() is None, "of several robots one has not stopped"
        ready._see("session", seen(now_s + 0.5))
        assert ready._rested_since_s() == now_s
        ready._see("session", seen(now_s - 0.1, None))
        assert ready._rested_since_s() == now_s, "asked for before the robot was at rest"
    finally:
        ready._datagrams.end()


def test_what_was_asked_before_a_press_does_not_confirm_it() -> None:
    ready = ReadyStop(connect=f"tcp/127.0.0.1:{free_port()}", stays=False)
    try:
        ready._datagrams.obeyed = b"\0" * 8  # a stop of before, which has been cleared since
        asked_s = time.monotonic()
        ready.press()
        ready._see("datagram", seen(asked_s))
        assert ready._order.wanted.is_set(), "the stop goes on being sent"
        ready._see("datagram", seen(time.monotonic()))
        assert not ready._order.wanted.is_set()
    finally:
        ready._datagrams.end()


def test_a_robot_that_is_not_there_is_an_error_and_no_success() -> None:
    port = free_port()
    with pytest.raises(RobotFaultError, match=f"nothing listens at tcp/127.0.0.1:{port}"):
        estop(connect=f"tcp/127.0.0.1:{port}")
    with pytest.raises(InputError, match="connect: got"):
        estop(connect="somewhere")


def test_where_something_listens_and_no_answer_comes_through_it_says_what_else_stops_the_robot() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent, socket.socket(type=socket.SOCK_DGRAM) as drain:
        port = silent.getsockname()[1]
        drain.bind(("127.0.0.1", port))
        with pytest.raises(RobotFaultError, match="hexctl estop on its own computer"):
            estop(connect=f"tcp/127.0.0.1:{port}")


#: Keys that stop; the last pauses what is printed unless that is switched off.
KEYS = {"a key": " ", "Ctrl-S": "\x13"}


@pytest.mark.parametrize("how", [*KEYS, "the terminal goes"])
def test_one_key_stops_and_so_does_a_terminal_that_goes(tmp_path: Path, how: str) -> None:
    with walking(tmp_path) as robot:
        terminal = OnTerminal(["--ready", "--connect", robot.endpoint], tmp_path, command="estop")
        try:
            terminal.wait("any key stops it")
            assert stopped(robot) != "estop"
            at_s = time.monotonic()
            if how in KEYS:
                terminal.type(KEYS[how])
                terminal.wait(r"stopped \(estop\), its targets no longer change")
                terminal.wait("Ctrl-C ends the watch")
                terminal.process.send_signal(signal.SIGINT)
                assert terminal.code() == 0
            else:
                terminal.close()
            wait_until(lambda: stopped(robot) == "estop", "the stop")
            assert rests(robot, at_s)
        finally:
            terminal.end()


def test_in_a_terminal_it_reports_who_cleared_the_stop_and_that_the_robot_moves(tmp_path: Path) -> None:
    with walking(tmp_path) as robot:
        terminal = OnTerminal(["--connect", robot.endpoint], tmp_path, command="estop")
        try:
            terminal.wait("Ctrl-C ends the watch")
            assert stopped(robot) == "estop"
            (cleared,) = clear_stop(connect=robot.endpoint)
            assert cleared["stopped"] is None
            terminal.wait(rf"(?i)cleared by .*process {os.getpid()}")
            terminal.wait("(?i)the robot moves again")
            assert stopped(robot) != "estop", "it is not stopped again"
            terminal.process.send_signal(signal.SIGINT)
            assert terminal.code() == 0
        finally:
            terminal.end()


class UdpRelay:
    """Passes datagrams to a port of this computer and back, and no connections."""

    def __init__(self, port: int) -> None:
        self._to = ("127.0.0.1", port)
        self._ended = False
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.port = int(self._front.getsockname()[1])

    def __enter__(self) -> "UdpRelay":
        self._back.settimeout(0.05)
        self._front.settimeout(0.05)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._thread.join()
        self._front.close()
        self._back.close()

    def _run(self) -> None:
        while not self._ended:
            try:
                data, sender = self._front.recvfrom(2000)
                self._back.sendto(data, self._to)
                self._front.sendto(self._back.recv(2000), sender)
            except TimeoutError:
                continue


#: For a stop of the command line.
WAIT_S = 30.0


def test_stops_in_a_row_have_one_claim_and_one_after_a_clear_has_another(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot, ReadyStop(connect=robot.endpoint, stays=False) as ready:

        def stop() -> dict[str, Any] | None:
            ready.press()
            stopped: dict[str, Any] | None = robot.status()["stop"]
            return stopped

        first = wait_for(stop, WAIT_S, "the robot is not stopped")
        for _ in range(20):
            again = stop()
        assert again is not None
        assert again["claims"] == first["claims"]
        assert len(first["claims"]) == 1
        assert ready.trouble is None
        assert hexctl_command("estop", "--clear", "--connect", robot.endpoint).returncode == 0
        assert robot.status()["stop"] is None
        after = wait_for(stop, WAIT_S, "the robot is not stopped again")
        wait_for(lambda: robot.status()["stop"]["claims"], WAIT_S, "the stop is not claimed")
        assert after["id"] != first["id"]


def test_a_stop_that_reaches_no_robot_says_so() -> None:
    with ReadyStop(connect="tcp/127.0.0.1:1", stays=False) as ready:
        ready.press()
        trouble = wait_for(lambda: ready.trouble, WAIT_S, "nothing is said")
    assert "127.0.0.1:1" in trouble
