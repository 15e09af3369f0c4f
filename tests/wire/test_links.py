"""Links, their files, page addresses, and whether something listens at an endpoint."""

import socket
import threading
from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.wire.connection_diagnosis import RefusalWatch, is_refused
from hexctl.wire.links import Endpoint, KeyMap, load_link
from hexctl.wire.page_address import PageAddress
from tests.server.processes import free_port


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a/*", "a/**", "a?b", "a#b", "a b", "$a", "@a"])
def test_what_is_no_plain_key_is_refused(key: str) -> None:
    with pytest.raises(InputError, match="keys: got"):
        KeyMap.of("ant").renamed({"odom": key})


def test_two_kinds_under_one_key_and_unknown_kinds_are_refused() -> None:
    with pytest.raises(InputError, match="a key each"):
        KeyMap.of("ant").renamed({"odom": "hexctl/ant/command"})
    with pytest.raises(InputError, match="allowed: command"):
        KeyMap.of("ant").renamed({"wheels": "a"})


@pytest.mark.parametrize(
    ("text", "expected", "loopback"),
    [
        ("tcp/127.0.0.1:7447", Endpoint("tcp", "127.0.0.1", 7447), True),
        ("tcp/localhost:1", Endpoint("tcp", "localhost", 1), True),
        ("tcp/[::1]:65535", Endpoint("tcp", "::1", 65535), True),
        ("tls/127.9.9.9:80", Endpoint("tls", "127.9.9.9", 80), True),
        ("tls/0.0.0.0:7447", Endpoint("tls", "0.0.0.0", 7447), False),  # noqa: S104
        ("tls/[::]:7447", Endpoint("tls", "::", 7447), False),
        ("quic/robot.local:7447", Endpoint("quic", "robot.local", 7447), False),
        ("tcp/localhost.example.org:7447", Endpoint("tcp", "localhost.example.org", 7447), False),
    ],
)
def test_an_endpoint_is_understood(text: str, expected: Endpoint, loopback: bool) -> None:
    assert Endpoint.parse(text) == expected
    assert str(expected) == text
    assert expected.is_loopback == loopback
    assert expected.encrypted == (expected.protocol != "tcp")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "127.0.0.1:7447",
        "tcp/127.0.0.1",
        "tcp/127.0.0.1:0",
        "tcp/127.0.0.1:65536",
        "tcp/:7447",
        "udp/127.0.0.1:7447",
        "tcp/127.0.0.1:7447#iface=eth0",
        "tcp/a b:1",
        "tcp/127.0.0.1:7447\n",
        "TCP/127.0.0.1:7447",
        "tcp/999.0.0.1:7447",
        "tcp/127.1:7447",
        "tcp/[127.0.0.1]:7447",
        "tcp/[:::]:7447",
        "tcp/::1:7447",
        "tcp/224.0.0.1:7447",
        "tls/robot.local:7447#enable_mtls=false",
        "tcp/127.0.0.1:7447?rel=0",
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"endpoint: got .*; allowed: PROTOCOL/HOST:PORT"):
        Endpoint.parse(text)


def test_a_file_is_read_and_what_is_given_besides_wins(tmp_path: Path) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(
        "endpoint: tls/robot.local:7447\ncredentials: ./keys\nnames: {odom: mocap/ant/odom}\nplain: true\n"
    )
    link = load_link(str(path))
    assert link.endpoint == "tls/robot.local:7447"
    assert link.credentials == tmp_path / "keys"
    assert link.plain
    assert link.keys("ant").odom == "mocap/ant/odom"
    given = load_link(str(path), endpoint="tls/other:1", credentials=Path("mine"))
    assert (given.endpoint, given.credentials) == ("tls/other:1", Path("mine"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("endpoints: tcp/a:1", "endpoints"),
        ("insecure: 1", "insecure"),
        ("names: [a]", "names"),
        ("endpoint: 5", "endpoint"),
        ("- a", "mapping"),
    ],
)
def test_a_file_that_is_none_is_refused_with_its_key(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "lab.yaml"
    path.write_text(content)
    with pytest.raises(InputError, match=words) as refused:
        load_link(str(path))
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", ":", "host", "host:", "1.2.3.4:99999", "a:b"])
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="page: got "):
        PageAddress.parse(text)


@pytest.mark.parametrize(
    ("text", "host", "loopback"),
    [("8017", "127.0.0.1", True), ("localhost:1", "localhost", True), ("[::1]:1", "::1", True),
     ("0.0.0.0:1", "0.0.0.0", False), ("robot.local:1", "robot.local", False)],  # noqa: S104
)  # fmt: skip
def test_addresses_are_parsed(text: str, host: str, loopback: bool) -> None:
    address = PageAddress.parse(text)
    assert (address.host, address.loopback) == (host, loopback)


WAIT_S = 60.0


class Told:
    """Takes what a watch tells."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.came = threading.Event()

    def __call__(self, text: str) -> None:
        self.texts.append(text)
        self.came.set()


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_closed_port_refuses_and_an_open_one_does_not(protocol: str, host: str) -> None:
    assert is_refused(Endpoint(protocol, host, free_port()))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        assert not is_refused(Endpoint(protocol, host, int(listening.getsockname()[1])))


def test_what_cannot_be_known_is_no_refusal() -> None:
    assert not is_refused(Endpoint("quic", "127.0.0.1", free_port()))
    assert not is_refused(Endpoint("tcp", f"{'a' * 70}.local", free_port()))


def test_a_refusal_is_told_once_while_the_block_runs() -> None:
    told, port = Told(), free_port()
    with RefusalWatch(f"tcp/127.0.0.1:{port}", told):
        assert told.came.wait(WAIT_S)
    assert told.texts == [f"nothing listens at tcp/127.0.0.1:{port}"]


def test_nothing_is_told_of_a_robot_that_has_answered_otherwise() -> None:
    asked = threading.Event()
    told = Told()

    def answered() -> bool:
        asked.set()
        return True

    with RefusalWatch(f"tcp/127.0.0.1:{free_port()}", told, answered=answered):
        assert asked.wait(WAIT_S)
    assert told.texts == []
