"""The page: a client that drives, everyone who must not, and floods, in which stops come through in time."""

import http.client
import itertools
import json
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.protocol import State
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.control.drive.drive import Drive
from hexctl.errors import InputError, RobotFaultError
from hexctl.teleop.control_page import (
    MOST_CLIENTS,
    MOST_VIEWERS,
    PROTOCOL,
    ControlPage,
    new_token,
    page_html,
)
from hexctl.teleop.drive_session import DriveSession
from hexctl.teleop.page_connection import (
    CONNECTIONS_S,
    MESSAGES_S,
    Addresses,
    Allowance,
    LimitedConnection,
    least_needed,
)
from hexctl.teleop.picture_relay import Picture, PictureRelay
from hexctl.waiting import wait_for
from hexctl.wire.certificates import find_credentials, make_certificates
from hexctl.wire.links import Role
from hexctl.wire.page_address import PageAddress

pytestmark = pytest.mark.realtime

#: What clients have to know, where they have to.
TOKEN = new_token()

LOOPBACK = PageAddress("127.0.0.1", 0)

HTML = page_html("drive")


def page_client(
    page: ControlPage,
    *,
    origin: str | None = None,
    token: str | None = None,
    path: str = "/drive",
    **options: Any,
) -> Connection:
    """A client of a page, by default from the page itself."""
    words = [Subprotocol(PROTOCOL), *([] if token is None else [Subprotocol(f"token.{token}")])]
    own, tls = f"127.0.0.1:{page.port}", "s" if "ssl" in options else ""
    place, origin = f"ws{tls}://{own}{path}", origin or f"http{tls}://{own}"
    client: Connection = connect(place, origin=Origin(origin), subprotocols=words, **options)
    return client


class Served:
    """A page, the arbiter behind it, and what it asked for."""

    def __init__(self, token: str | None = None, **options: Any) -> None:
        self.now_s = 0.0
        self.arbiter = Arbiter(lambda: self.now_s)
        self.asked: list[str] = []
        self.page = ControlPage(
            LOOPBACK,
            HTML,
            self.arbiter.source("page"),
            Velocity,
            self.asked.append,
            token=token,
            now_s=lambda: self.now_s,
            **options,
        )

    def client(self, **options: Any) -> Connection:
        return page_client(self.page, **options)

    def drives(self, client: Connection) -> None:
        """A client drives forward."""
        client.send(json.dumps({"v": [1, 0, 0]}))
        self.wait(Decision(Velocity(1, 0, 0), "page"))

    def does(self, request: str) -> None:
        """It was asked for something, once."""
        wait_for(lambda: self.asked == [request], 5.0, f"{request} does not come")

    def wait(self, decision: Decision) -> None:
        wait_for(lambda: self.arbiter.decide() == decision, 5.0, f"it is {self.arbiter.decide()}")


@contextmanager
def served(**options: Any) -> Iterator[Served]:
    made = Served(**options)
    with made.page:
        yield made


def test_a_finger_drives_and_letting_go_is_a_release() -> None:
    with served() as robot, robot.client() as client:
        client.send(json.dumps({"v": [0.5, -0.25, 1]}))
        robot.wait(Decision(Velocity(0.5, -0.25, 1), "page"))
        client.send(json.dumps({"release": True}))
        robot.wait(Decision(Velocity(), "page"))


def test_one_client_drives_and_any_may_stop() -> None:
    with served() as robot, robot.client() as first, robot.client() as second:
        robot.drives(first)
        second.send(json.dumps({"v": [-1, 0, 0]}))
        second.send(json.dumps({"release": True}))
        second.send(json.dumps({"do": "stop"}))
        robot.does("stop")
        assert robot.arbiter.decide() == Decision(Velocity(1, 0, 0), "page")
        robot.now_s = 0.6
        second.send(json.dumps({"v": [-1, 0, 0]}))
        robot.wait(Decision(Velocity(-1, 0, 0), "page"))


def test_clients_hear_what_the_robot_does() -> None:
    with served() as robot, robot.client() as client:
        robot.page.report({"robot": "ant", "battery_v": 7.4})
        while "robot" not in (said := json.loads(client.recv(timeout=5))):
            pass
        assert said == {"robot": "ant", "battery_v": 7.4, "owner": None}


def owner_seen(client: Connection) -> str | None:
    """What a client hears about to whom the robot listens."""
    while "robot" not in (said := json.loads(client.recv(timeout=5))):
        pass
    owner: str | None = said["owner"]
    return owner


def test_clients_hear_who_drives() -> None:
    with served() as robot, robot.client() as first, robot.client() as second:
        robot.page.report({"robot": "ant"})
        robot.drives(first)
        wait_for(lambda: owner_seen(first) == "you", 5.0, "the driver does not hear it")
        wait_for(lambda: owner_seen(second) == "127.0.0.1", 5.0, "the other does not hear it")
        first.send(json.dumps({"release": True}))
        wait_for(lambda: owner_seen(second) is None, 5.0, "it is not free")


def test_a_page_with_an_owner_obeys_only_it_and_anybodys_stop() -> None:
    with served(owned_s=5.0) as robot, robot.client() as second:
        robot.page.report({"robot": "ant"})
        with robot.client() as first:
            first.send(json.dumps({"here": True}))
            wait_for(lambda: owner_seen(first) == "you", 5.0, "nobody owns it")
            for message in (
                {"here": True},
                {"do": "zero"},
                {"v": [1, 0, 0]},
                {"release": True},
                {"do": "stop"},
            ):
                second.send(json.dumps(message))
            robot.does("stop")
            assert (robot.arbiter.decide(), owner_seen(second)) == (Decision(), "127.0.0.1")
            robot.drives(first)
            first.send(json.dumps({"release": True}))  # it stays the owner
            robot.wait(Decision(Velocity(), "page"))
            robot.now_s = 4.0
            second.send(json.dumps({"here": True}))
            robot.drives(first)
        robot.wait(Decision(Velocity(), "page"))  # its page is closed in mid-jog
        second.send(json.dumps({"do": "zero"}))
        wait_for(lambda: robot.asked == ["stop", "zero"], 5.0, f"{robot.asked}")
        assert owner_seen(second) == "you"


def test_an_owner_that_is_silent_loses_the_page() -> None:
    with served(owned_s=5.0) as robot, robot.client() as first, robot.client() as second:
        robot.drives(first)
        robot.now_s = 6.0
        second.send(json.dumps({"do": "zero"}))
        robot.does("zero")
        first.send(json.dumps({"do": "flip"}))
        second.send(json.dumps({"do": "save"}))
        wait_for(lambda: robot.asked == ["zero", "save"], 5.0, f"{robot.asked}")


def test_what_is_no_command_moves_nothing() -> None:
    messages: list[str | bytes] = [
        "", "{", "[]", "5", "null", '"v"', '{"v": 1}', '{"v": [1, 0]}', '{"v": [2, 0, 0]}',
        '{"v": [NaN, 0, 0]}', '{"v": ["a", 0, 0]}', '{"v": [1e999, 0, 0]}', '{"x": 0}',
        b"\xff\xfe", "[" * 200,
    ]  # fmt: skip
    for message in messages:
        with served() as robot, robot.client() as client:
            client.send(message)
            client.send(json.dumps({"do": "stand"}))
            robot.does("stand")
            assert robot.arbiter.decide() == Decision(), message


def test_a_long_message_ends_its_connection_alone() -> None:
    with served() as robot, robot.client() as client, robot.client() as other:
        client.send("x" * 1000)
        robot.drives(other)


def refused(robot: Served, **options: Any) -> int:
    with pytest.raises(InvalidStatus) as caught, robot.client(**options):
        pass
    return int(caught.value.response.status_code)


def get(port: int, path: str = "/", host: str | None = None) -> tuple[int, str, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest("GET", path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{port}")
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, answer.headers.get("Content-Security-Policy", ""), answer.read()


def test_the_page_is_one_file_that_loads_nothing_from_elsewhere() -> None:
    with served() as robot:
        status, policy, body = get(robot.page.port)
        assert status == 200
        assert b"STOP" in body
        assert b"http://" not in body.replace(b"https?://", b"")
        assert b"src=" not in body
        assert policy.startswith("default-src 'none'")
        assert get(robot.page.port, "/other")[0] == 404


def test_names_that_are_not_this_computers_are_refused() -> None:
    allowed = ("localhost", "[::1]:80", "192.168.1.7:8017", socket.gethostname())
    with served() as robot:
        for host in ("evil.example", "evil.example:8017", "-", *allowed):
            assert get(robot.page.port, host=host)[0] == (200 if host in allowed else 403)


def test_beyond_this_computer_it_takes_certificates_and_a_token() -> None:
    arbiter = Arbiter()
    address = PageAddress.parse("0.0.0.0:0")
    assert not address.loopback
    with pytest.raises(InputError, match=r"page: got 0\.0\.0\.0"):
        ControlPage(address, HTML, arbiter.source("page"), Velocity, print)


def test_a_port_in_use_is_a_fault_that_names_the_option() -> None:
    with served() as robot:
        address = PageAddress("127.0.0.1", robot.page.port)
        with pytest.raises(RobotFaultError, match="page: cannot listen"):
            ControlPage(address, HTML, robot.arbiter.source("page"), Velocity, print).__enter__()


def test_with_certificates_it_is_served_over_tls(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["127.0.0.1"], days=2)
    with served(credentials=find_credentials(tmp_path / "keys", Role.ROBOT), token=TOKEN) as robot:
        assert robot.page.url.startswith("https://127.0.0.1:")
        context = ssl.create_default_context(cafile=tmp_path / "keys" / "robot" / "ca.pem")
        with robot.client(ssl=context, token=TOKEN) as client:
            robot.drives(client)


@pytest.fixture
def pictures() -> PictureRelay:
    """A relay that fetches nothing: what it has comes from the test."""
    made = PictureRelay("http://127.0.0.1:9/picture.jpg")
    made.newest = Picture(1, b"first")
    return made


def test_a_camera_is_seen_picture_by_picture(pictures: PictureRelay) -> None:
    with served(pictures=pictures) as robot, robot.client(path="/view") as viewer:
        viewer.send("next")
        assert viewer.recv(timeout=5) == b"first"
        viewer.send("next")
        pictures.newest = Picture(2, b"second")
        assert viewer.recv(timeout=5) == b"second"
        pictures.newest, pictures.trouble = None, "the camera answers 404"
        viewer.send("next")
        assert json.loads(viewer.recv(timeout=5)) == {"trouble": "the camera answers 404"}
        pictures.newest = Picture(3, b"third")
        viewer.send("next")
        assert viewer.recv(timeout=5) == b"third"


def test_who_looks_does_not_drive_and_hears_no_status(pictures: PictureRelay) -> None:
    with served(pictures=pictures) as robot, robot.client(path="/view") as viewer, robot.client() as client:
        robot.page.report({"robot": "ant"})
        viewer.send(json.dumps({"v": [1, 0, 0]}))
        viewer.send(json.dumps({"do": "stop"}))
        assert viewer.recv(timeout=5) == b"first"
        assert viewer.recv(timeout=5) == '{"trouble": "none comes"}'
        assert client.recv(timeout=5)
        assert (robot.asked, robot.arbiter.decide()) == ([], Decision())


def test_a_viewer_that_takes_nothing_holds_nobody_up(pictures: PictureRelay) -> None:
    pictures.newest = Picture(1, bytes(50_000_000))
    with served(pictures=pictures) as robot, robot.client(path="/view") as viewer, robot.client() as client:
        viewer.send("next")
        for index in range(5):
            robot.page.report({"robot": str(index)})
            wait_for(lambda: json.loads(client.recv(timeout=5)).get("robot") == str(index), 5.0, "no status")  # noqa: B023
        client.send(json.dumps({"do": "stop"}))
        robot.does("stop")


def test_foreign_origins_and_wrong_tokens_are_refused(pictures: PictureRelay) -> None:
    elsewhere = ("http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1")
    wrong = [{}, {"token": "x" * 12}, *({"token": TOKEN, "origin": origin} for origin in elsewhere)]
    with served(pictures=pictures, token=TOKEN) as robot:
        assert TOKEN not in robot.page.url
        for path, options in itertools.product(("/drive", "/view"), wrong):
            assert refused(robot, path=path, **options) == 403
        with robot.client(path="/view", token=TOKEN), robot.client(token=TOKEN) as client:
            robot.drives(client)
            assert client.subprotocol == PROTOCOL
    with served(pictures=pictures) as robot:  # on this computer, without a token
        for path, origin in itertools.product(("/drive", "/view"), elsewhere):
            assert refused(robot, path=path, origin=origin) == 403


def test_those_who_look_do_not_keep_out_who_drives(pictures: PictureRelay) -> None:
    with served(pictures=pictures) as robot, ExitStack() as stack:
        for _ in range(MOST_VIEWERS):
            stack.enter_context(robot.client(path="/view"))
        assert refused(robot, path="/view") == 503
        client = stack.enter_context(robot.client())
        robot.drives(client)


def test_idle_clients_give_way_to_a_new_one_and_the_one_that_drives_stays() -> None:
    with served() as robot, ExitStack() as stack:
        driver = stack.enter_context(robot.client())
        robot.drives(driver)
        idle = [stack.enter_context(robot.client()) for _ in range(MOST_CLIENTS - 1)]
        stopping = stack.enter_context(robot.client())
        stopping.send(json.dumps({"do": "stop"}))
        robot.does("stop")
        wait_for(lambda: idle[0].state is State.CLOSED, 5.0, "the client that was silent for longest stays")
        assert [one.state is State.OPEN for one in (driver, *idle[1:])] == [True] * (MOST_CLIENTS - 1)


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
        self.page = ControlPage(LOOPBACK, HTML, drive.arbiter.source("page"), drive.share, self.session.ask)

    def client(self) -> Connection:
        """A client that has connected, as soon as its address may after a flood."""

        def connected() -> Connection | None:
            with suppress(WebSocketException, EOFError, OSError):
                return page_client(self.page, open_timeout=1.0)
            return None

        client = wait_for(connected, 10.0, "the page takes no client")
        client.send(json.dumps({"release": True}))  # as the page does at its start
        return client

    def stop_s(self, client: Connection) -> float:
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


def _drain(client: Connection) -> None:
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
