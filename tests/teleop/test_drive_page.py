"""The page: a client that drives, and everyone who must not."""

import http.client
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus
from websockets.protocol import State
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.errors import InputError, RobotFaultError
from hexctl.teleop.drive_page import MOST_CLIENTS, MOST_VIEWERS, PROTOCOL, DrivePage, new_token
from hexctl.teleop.picture_relay import Picture, PictureRelay
from hexctl.waiting import wait_for
from hexctl.wire.certificates import find_credentials, make_certificates
from hexctl.wire.links import Role
from hexctl.wire.page_address import PageAddress

pytestmark = pytest.mark.realtime

#: What clients have to know, where they have to.
TOKEN = new_token()


class Served:
    """A page, the arbiter behind it, and what it asked for."""

    def __init__(self, token: str | None = None, **options: Any) -> None:
        self.now_s = 0.0
        self.arbiter = Arbiter(lambda: self.now_s)
        self.asked: list[str] = []
        self.page = DrivePage(
            PageAddress("127.0.0.1", 0),
            self.arbiter.source("page"),
            Velocity,
            self.asked.append,
            token=token,
            now_s=lambda: self.now_s,
            **options,
        )

    def client(
        self, *, origin: str | None = None, token: str | None = None, path: str = "/drive"
    ) -> ClientConnection:
        words = [Subprotocol(PROTOCOL), *([] if token is None else [Subprotocol(f"token.{token}")])]
        own = f"http://127.0.0.1:{self.page.port}"
        return connect(
            f"ws://127.0.0.1:{self.page.port}{path}", origin=Origin(origin or own), subprotocols=words
        )

    def drives(self, client: ClientConnection) -> None:
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
        while (said := json.loads(client.recv(timeout=5))) == {}:
            pass
        assert said == {"robot": "ant", "battery_v": 7.4}


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
            assert robot.arbiter.decide() == Decision()


def test_a_long_message_ends_its_connection_alone() -> None:
    with served() as robot, robot.client() as client, robot.client() as other:
        client.send("x" * 1000)
        robot.drives(other)


def refused(robot: Served, **options: Any) -> int:
    with pytest.raises(InvalidStatus) as caught, robot.client(**options):
        pass
    return int(caught.value.response.status_code)


def test_pages_from_elsewhere_are_refused() -> None:
    with served() as robot:
        for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1"):
            assert refused(robot, origin=origin) == 403


def test_a_wrong_token_is_refused_and_the_right_one_is_not() -> None:
    with served(token=TOKEN) as robot:
        assert TOKEN not in robot.page.url
        assert refused(robot) == 403
        assert refused(robot, token="x" * 12) == 403
        with robot.client(token=TOKEN) as client:
            robot.drives(client)
            assert client.subprotocol == PROTOCOL


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
        DrivePage(address, arbiter.source("page"), Velocity, print)


def test_a_port_in_use_is_a_fault_that_names_the_option() -> None:
    with served() as robot:
        address = PageAddress("127.0.0.1", robot.page.port)
        with pytest.raises(RobotFaultError, match="page: cannot listen"):
            DrivePage(address, robot.arbiter.source("page"), Velocity, print).__enter__()


def test_with_certificates_it_is_served_over_tls(tmp_path: Path) -> None:
    import ssl

    make_certificates(tmp_path / "keys", hosts=["127.0.0.1"], days=2)
    with served(credentials=find_credentials(tmp_path / "keys", Role.ROBOT), token=TOKEN) as robot:
        assert robot.page.url.startswith("https://127.0.0.1:")
        context = ssl.create_default_context(cafile=tmp_path / "keys" / "robot" / "ca.pem")
        own = f"127.0.0.1:{robot.page.port}"
        with connect(
            f"wss://{own}/drive",
            ssl=context,
            origin=Origin(f"https://{own}"),
            subprotocols=[Subprotocol(PROTOCOL), Subprotocol(f"token.{TOKEN}")],
        ) as client:
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
            wait_for(lambda: json.loads(client.recv(timeout=5)) == {"robot": str(index)}, 5.0, "no status")  # noqa: B023
        client.send(json.dumps({"do": "stop"}))
        robot.does("stop")


def test_what_a_camera_sees_needs_the_token_and_a_page_of_ours(pictures: PictureRelay) -> None:
    with served(pictures=pictures, token=TOKEN) as robot:
        for path in ("/drive", "/view"):
            for wrong in (
                {"token": None},
                {"token": "wrong"},
                {"token": TOKEN, "origin": "http://elsewhere"},
            ):
                assert refused(robot, path=path, **wrong) == 403
            with robot.client(path=path, token=TOKEN):
                pass


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
