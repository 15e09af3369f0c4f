"""Floods on the page: the stop of another client is in force in time, whatever one client sends."""

import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import cast

import pytest
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.protocol import State
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from hexctl.control.drive.drive import Drive
from hexctl.teleop.drive_page import PROTOCOL, DrivePage
from hexctl.teleop.drive_session import DriveSession
from hexctl.teleop.page_connection import (
    CONNECTIONS_S,
    MESSAGES_S,
    Addresses,
    Allowance,
    LimitedConnection,
    least_needed,
)
from hexctl.waiting import wait_for
from hexctl.wire.page_address import PageAddress

pytestmark = pytest.mark.realtime

#: How long a stop may take until the tick that obeys it.
STOP_S = 0.3

#: A stop that takes longer counts as lost.
LOST_S = 5.0

#: Stops of each flood: in the ordinary tests, and in the soak test.
FEW, MANY = 3, 100

FLOODS = [*itertools.product(("valid", "invalid", "gait"), ("30", "1500", "full")), ("connect", "full")]


def test_an_allowance_fills_up_to_what_is_allowed_in_a_second() -> None:
    now_s = 0.0
    allowance = Allowance(10, lambda: now_s)
    assert [allowance.take() for _ in range(11)] == [True] * 10 + [False]
    now_s = 0.25
    assert [allowance.take() for _ in range(3)] == [True, True, False]
    now_s = 100.0
    assert not allowance.take(11)
    assert allowance.take(10)


def test_an_address_that_connects_too_often_is_refused_and_others_are_not() -> None:
    addresses = Addresses(lambda: 0.0)
    admitted = [addresses.admit("192.0.2.1") for _ in range(200)]
    assert sum(admitted) == CONNECTIONS_S
    assert addresses.admit("192.0.2.2")


@dataclass
class Connected:
    """A connection, as far as its place goes."""

    address: str
    begun_at_s: float
    has_spoken: bool = False


def test_an_address_with_many_connections_takes_no_place_of_another() -> None:
    alone, crowd = Connected("192.0.2.1", 0.0), [Connected("192.0.2.2", at_s) for at_s in (3.0, 1.0, 2.0)]
    connections = cast("list[LimitedConnection]", [alone, *crowd])
    for newcomer in ("192.0.2.1", "192.0.2.2", "192.0.2.3"):
        assert least_needed(connections, newcomer).begun_at_s == 1.0


def test_a_page_that_was_there_keeps_its_place_from_later_ones_of_its_address() -> None:
    page = Connected("192.0.2.1", 0.0, has_spoken=True)
    silent, speaking = Connected("192.0.2.1", 1.0), Connected("192.0.2.1", 2.0, has_spoken=True)
    for others, expected in (([silent, speaking], silent), ([speaking], speaking)):
        connections = cast("list[LimitedConnection]", [page, *others])
        assert least_needed(connections, "192.0.2.1") is cast("LimitedConnection", expected)


class Driven:
    """A robot that is driven with a page, in real time."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self.session = DriveSession(drive)
        self.page = DrivePage(
            PageAddress("127.0.0.1", 0), drive.arbiter.source("page"), drive.share, self.session.ask
        )

    def client(self) -> ClientConnection:
        """A client that has connected, as soon as its address may after a flood."""
        own = f"127.0.0.1:{self.page.port}"
        origin, words = Origin(f"http://{own}"), [Subprotocol(PROTOCOL)]

        def connected() -> ClientConnection | None:
            with suppress(WebSocketException, EOFError, OSError):
                return connect(f"ws://{own}/drive", origin=origin, subprotocols=words, open_timeout=1.0)
            return None

        client = wait_for(connected, 10.0, "the page takes no client")
        assert client is not None
        client.send(json.dumps({"release": True}))  # as the page does at its start
        return client

    def stop_s(self, client: ClientConnection) -> float:
        """Time from a client's stop to the tick that obeys it; `LOST_S` for one that is lost."""
        assert self.drive.decision.stopped is None
        at_s = time.monotonic()
        client.send(json.dumps({"do": "stop"}))
        while self.drive.decision.stopped is None and time.monotonic() - at_s < LOST_S:
            time.sleep(0.002)
        return min(LOST_S, time.monotonic() - at_s)

    def stand(self) -> None:

        def stands() -> bool:
            self.session.ask("stand")
            return self.drive.decision.stopped is None

        wait_for(stands, 10.0, "the stop is not cleared", poll_s=0.1)


@pytest.fixture(scope="module")
def robot() -> Iterator[Driven]:
    with Drive("ant", backend="sim", realtime=True) as drive:
        robot = Driven(drive)
        with robot.page:
            walk = threading.Thread(target=robot.session.run, args=([robot.page],))
            walk.start()
            try:
                wait_for(lambda: drive.mode == "driving", 20.0, "the robot does not stand up")
                yield robot
            finally:
                robot.session.ask("quit")
                walk.join(20.0)


@contextmanager
def flooded(port: int, kind: str, rate: str) -> Iterator[None]:
    flood = [sys.executable, "-m", "tests.teleop.flooding", str(port), kind, rate]
    with subprocess.Popen(flood, stdin=subprocess.PIPE) as process:
        try:
            yield
        finally:
            process.kill()


def _drain(client: ClientConnection) -> None:
    """Take what the robot says, as a page does: one that takes nothing hears no pong either."""
    with suppress(ConnectionClosed):
        for _ in client:
            pass


def stops_s(robot: Driven, kind: str, rate: str, times: int) -> list[float]:
    """Times of stops during a flood."""
    with robot.client() as client, flooded(robot.page.port, kind, rate):
        threading.Thread(target=_drain, args=(client,), daemon=True).start()
        time.sleep(0.5)  # until it floods
        times_s = []
        for number in range(times):
            times_s.append(robot.stop_s(client))
            robot.stand()
            time.sleep(0.05 + 0.13 * (number % 5))
    return times_s


@pytest.mark.parametrize("kind", ["valid", "invalid", "gait", "connect"])
def test_a_flood_at_full_speed_delays_no_stop(robot: Driven, kind: str) -> None:
    times_s = stops_s(robot, kind, "full", FEW)
    assert sorted(times_s)[FEW // 2] <= STOP_S, times_s
    assert max(times_s) <= 2 * STOP_S, times_s  # beside other tests a machine may be busy


def test_a_client_that_sends_too_much_is_closed_and_may_connect_again(robot: Driven) -> None:
    with robot.client() as client:
        with suppress(ConnectionClosed):
            for _ in range(2 * int(MESSAGES_S)):
                client.send(json.dumps({"do": "up"}))
        wait_for(lambda: client.state is State.CLOSED, 5.0, "the connection is not closed")
        with robot.client() as again:
            assert robot.stop_s(again) < LOST_S
        robot.stand()


@pytest.mark.soak
@pytest.mark.parametrize(("kind", "rate"), FLOODS)
def test_a_flood_delays_none_of_a_hundred_stops(robot: Driven, kind: str, rate: str) -> None:
    assert max(stops_s(robot, kind, rate, MANY)) <= STOP_S
