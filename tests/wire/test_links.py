"""Links, their files, page addresses, whether something listens, and how a robot describes itself."""

import socket
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError, MessageError, RobotFaultError
from hexctl.types import JOINT_NAMES
from hexctl.wire.connection_diagnosis import RefusalWatch, is_refused
from hexctl.wire.description import (
    RobotIdentity,
    check_may_command,
    check_same_robot,
    decode_json,
    describe,
    encode_json,
    robot_of,
)
from hexctl.wire.links import DEFAULT_ENDPOINT, KINDS, Endpoint, KeyMap, Link, load_link
from hexctl.wire.page_address import PageAddress
from tests.robots import shipped
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


def test_a_page_address_has_a_port_and_by_default_this_computer() -> None:
    for text, host, loopback in (
        ("8017", "127.0.0.1", True),
        ("localhost:1", "localhost", True),
        ("[::1]:1", "::1", True),
        ("0.0.0.0:1", "0.0.0.0", False),  # noqa: S104
        ("robot.local:1", "robot.local", False),
    ):
        address = PageAddress.parse(text)
        assert (address.host, address.loopback) == (host, loopback)
    for text in ("", ":", "host", "host:", "1.2.3.4:99999", "a:b"):
        with pytest.raises(InputError, match="page"):
            PageAddress.parse(text)


@pytest.mark.parametrize(("protocol", "host"), [("tcp", "127.0.0.1"), ("tls", "localhost")])
def test_a_closed_port_refuses_and_an_open_one_does_not(protocol: str, host: str) -> None:
    assert is_refused(Endpoint(protocol, host, free_port()))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        assert not is_refused(Endpoint(protocol, host, int(listening.getsockname()[1])))


def test_what_cannot_be_known_is_no_refusal() -> None:
    assert not is_refused(Endpoint("quic", "127.0.0.1", free_port()))
    assert not is_refused(Endpoint("tcp", f"{'a' * 70}.local", free_port()))


@pytest.mark.parametrize("answered", [False, True])
def test_a_refusal_is_told_once_unless_the_robot_has_answered_otherwise(answered: bool) -> None:
    endpoint, told, came = f"tcp/127.0.0.1:{free_port()}", list[str](), threading.Event()

    def tell(text: str) -> None:
        told.append(text)
        came.set()

    def has_answered() -> bool:
        if answered:
            came.set()
        return answered

    with RefusalWatch(endpoint, tell, answered=has_answered):
        assert came.wait(60)
    assert told == [] if answered else [f"nothing listens at {endpoint}"]


OURS = RobotIdentity.of_this_process("ant", "sim")
NEIGHBOURS = replace(OURS, user="mallory")


@pytest.mark.parametrize("other", [NEIGHBOURS, replace(OURS, host="elsewhere")])
def test_a_robot_of_another_user_or_computer_is_not_commanded_by_default(other: RobotIdentity) -> None:
    by_default = load_link()
    with pytest.raises(InputError, match=f"{other.user} on {other.host}"):
        check_may_command(other, by_default)
    check_may_command(OURS, by_default)
    for named in (load_link(connect=DEFAULT_ENDPOINT), load_link("loopback"), Link()):
        check_may_command(other, named)


@pytest.mark.parametrize(
    "said",
    [
        {"robot": "ant", "backend": "sim"},
        {"robot": "ant", "backend": "sim", "host": 5, "user": ["x"], "pid": "1"},
        {"robot": "ant", "backend": "sim", "host": "a\nb", "user": "", "pid": None},
    ],
    ids=["nothing", "wrong types", "unprintable"],
)
def test_a_robot_that_does_not_say_who_started_it_is_commanded_only_by_name(said: dict[str, object]) -> None:
    identity = RobotIdentity.of_answer(said)
    assert str(identity) == "ant (sim), started by ? on ?"
    with pytest.raises(InputError, match="connect tcp/127"):
        check_may_command(identity, load_link())
    check_may_command(identity, load_link("loopback"))


def test_another_robot_is_refused_with_the_place_where_it_differs() -> None:
    answer = describe(shipped())
    answer["robot"]["mount_positions_body"][2][1] += 0.001
    with pytest.raises(RobotFaultError, match=r"mount_positions_body\[2\]\[1\] is .* there and .* here"):
        check_same_robot(answer, shipped())
    answer["robot"]["body"] = None
    with pytest.raises(RobotFaultError, match="body is None there"):
        check_same_robot(answer, shipped())


def test_another_protocol_or_other_joints_are_refused() -> None:
    with pytest.raises(RobotFaultError, match="protocol 2"):
        check_same_robot({**describe(shipped()), "protocol": 2}, shipped())
    with pytest.raises(RobotFaultError, match="other joints"):
        check_same_robot({**describe(shipped()), "joints": list(JOINT_NAMES[::-1])}, shipped())
    with pytest.raises(RobotFaultError):
        check_same_robot({}, shipped())


@pytest.mark.parametrize("payload", [b"", b"{", b"[]", b"1", b"\xff", b"[" * 60_000, b"x" * 70_000])
def test_what_is_no_json_object_is_refused(payload: bytes) -> None:
    with pytest.raises(MessageError, match="JSON: got"):
        decode_json(payload)


@pytest.mark.parametrize("spoil", [{}, {"protocol": 1, "robot": {"name": "x"}}, {"protocol": 1, "robot": 5}])
def test_a_description_of_no_robot_is_refused(spoil: dict[str, object]) -> None:
    with pytest.raises(RobotFaultError, match="describes itself"):
        robot_of(spoil)


def test_a_robot_with_masses_and_friction_of_its_own_arrives_whole() -> None:
    body = replace(shipped().body, com_m=(0.01, 0.0, 0.02), inertia_kg_m2=(1e-4, 1e-4, 1.5e-4))
    robot = replace(
        shipped(),
        body=body,
        joint_dry_friction_nm=np.full(18, 0.1),
        joint_no_load_speed_rad_s=np.full(18, 7.0),
        joint_stiffness_nm_per_rad=np.arange(1.0, 19.0),
        link_coms_m=np.full((3, 2), 0.01),
    )
    answer = decode_json(encode_json(describe(robot)))
    assert robot_of(answer) == robot
    assert robot_of(answer).fingerprint == robot.fingerprint
    check_same_robot(answer, robot)
    with pytest.raises(RobotFaultError, match=r"another one: body\.com_m"):
        check_same_robot(answer, replace(robot, body=shipped().body))
