"""Endpoints: which are understood, and which stay on this computer."""

import pytest

from hexctl.errors import InputError
from hexctl.wire.endpoint import Endpoint


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
