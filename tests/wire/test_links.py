"""Links: keys, endpoints and link files."""

from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.wire.links import DEFAULT_ENDPOINT, KINDS, Endpoint, KeyMap, Link, load_link


def test_every_kind_has_a_key_of_its_own_under_the_robots_name() -> None:
    keys = KeyMap.of("ant")
    assert {getattr(keys, kind) for kind in KINDS} == {f"hexctl/ant/{kind}" for kind in KINDS}


def test_a_kind_may_travel_under_another_key() -> None:
    keys = KeyMap.of("ant").renamed({"odom": "mocap/ant/odom"})
    assert keys.odom == "mocap/ant/odom"
    assert keys.command == "hexctl/ant/command"


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


def test_without_a_file_it_is_the_shipped_loopback() -> None:
    assert load_link() == load_link("loopback") == Link(endpoint=DEFAULT_ENDPOINT)


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


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match="loopback"):
        load_link("moon")
