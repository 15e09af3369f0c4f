"""Links, their files, page addresses, and whether something listens at an endpoint."""

import socket
import threading
from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.wire.connection_diagnosis import RefusalWatch, is_refused
from hexctl.wire.links import KINDS, Endpoint, KeyMap, load_link
from hexctl.wire.page_address import PageAddress
from tests.server.processes import free_port


def test_a_kind_may_travel_under_another_key_but_each_needs_its_own() -> None:
    keys = KeyMap.of("ant")
    assert {getattr(keys, kind) for kind in KINDS} == {f"hexctl/ant/{kind}" for kind in KINDS}
    assert keys.renamed({"odom": "mocap/ant/odom"}).odom == "mocap/ant/odom"
    for key in ("", "/a", "a/", "a//b", "a/*", "a/**", "a?b", "a#b", "a b", "$a", "@a", keys.command):
        with pytest.raises(InputError, match="keys"):
            keys.renamed({"odom": key})
    with pytest.raises(InputError, match="wheels"):
        keys.renamed({"wheels": "a"})


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


def test_anything_else_is_refused() -> None:
    places = (
        "127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", ":7447", "127.0.0.1:7447#iface=eth0", "a b:1",
        "127.0.0.1:7447\n", "999.0.0.1:7447", "127.1:7447", "[127.0.0.1]:7447", "[:::]:7447", "::1:7447",
        "224.0.0.1:7447", "robot.local:7447#enable_mtls=false", "127.0.0.1:7447?rel=0",
    )  # fmt: skip
    others = ("", "127.0.0.1:7447", "udp/127.0.0.1:7447", "TCP/127.0.0.1:7447")
    for text in (*others, *(f"tcp/{place}" for place in places)):
        with pytest.raises(InputError, match="endpoint"):
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
    given = load_link(str(path), connect="tls/other:1", credentials=Path("mine"))
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
    with pytest.raises(InputError, match=words):
        load_link(str(path))


def test_a_page_address_that_is_none_is_refused() -> None:
    for text in ("", ":", "host", "host:", "1.2.3.4:99999", "a:b"):
        with pytest.raises(InputError, match="page"):
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


@pytest.mark.parametrize(("protocol", "host"), [("tcp", "127.0.0.1"), ("tls", "localhost")])
def test_a_closed_port_refuses_and_an_open_one_does_not(protocol: str, host: str) -> None:
    assert is_refused(Endpoint(protocol, host, free_port()))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        assert not is_refused(Endpoint(protocol, host, int(listening.getsockname()[1])))


def test_what_cannot_be_known_is_no_refusal() -> None:
    assert not is_refused(Endpoint("quic", "127.0.0.1", free_port()))
    assert not is_refused(Endpoint("tcp", f"{'a' * 70}.local", free_port()))


def test_a_refusal_is_told_once_while_the_block_runs() -> None:
    told, came = list[str](), threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        came.set()

    port = free_port()
    with RefusalWatch(f"tcp/127.0.0.1:{port}", tell):
        assert came.wait(WAIT_S)
    assert told == [f"nothing listens at tcp/127.0.0.1:{port}"]


def test_nothing_is_told_of_a_robot_that_has_answered_otherwise() -> None:
    asked, told = threading.Event(), list[str]()

    def answered() -> bool:
        asked.set()
        return True

    with RefusalWatch(f"tcp/127.0.0.1:{free_port()}", told.append, answered=answered):
        assert asked.wait(WAIT_S)
    assert told == []
