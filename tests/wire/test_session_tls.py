"""Mutual TLS and access control, for real: what a certificate lets its holder do. On loopback, free ports."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hexctl.wire.link import Link
from hexctl.wire.role import Role
from hexctl.wire.session import MAX_MESSAGE_BYTES, open_session
from tests.serve.processes import free_port, wait_until
from tests.wire.knocking import KEYS, ListeningRobot, answers, knocking, tls

#: Long enough for a message that is let through to arrive, many times over.
GRACE_S = 0.5

#: Whatever may be said in a robot's name, to it, or to everybody at once.
ALL_SAID = (KEYS.joint_states, KEYS.status, KEYS.command, KEYS.pose, "hexctl/ant/*", "hexctl/**", "**")


@pytest.fixture
def protocol() -> str:
    return "tls"


@pytest.fixture
def robot(protocol: str, authority: Path) -> Iterator[ListeningRobot]:
    keys = None if protocol == "tcp" else authority
    link = Link(endpoint=f"{protocol}/127.0.0.1:{free_port()}", credentials=keys)
    with open_session(link, Role.ROBOT, KEYS) as session:
        robot = ListeningRobot(link, session)
        robot.listen()
        yield robot


@contextmanager
def client(robot: ListeningRobot, role: Role) -> Iterator[zenoh.Session]:
    with open_session(robot.link, role, KEYS) as session:
        yield session


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_a_controller_commands_and_a_viewer_only_reads(robot: ListeningRobot) -> None:
    states: list[bytes] = []
    with client(robot, Role.CONTROLLER) as controller, client(robot, Role.VIEWER) as viewer:
        viewer.declare_subscriber(KEYS.joint_states, lambda sample: states.append(bytes(sample.payload)))
        wait_until(lambda: robot.publisher.put(b"state") or states, "a state")
        for kind in ("lease", "estop", "describe"):
            assert answers(controller, getattr(KEYS, kind), b"controller") == [b"robot"]
        assert answers(controller, "hexctl/*/estop") == answers(controller, "hexctl/*/describe") == [b"robot"]
        assert answers(viewer, KEYS.describe) == answers(viewer, "hexctl/*/describe") == [b"robot"]
        for key in (KEYS.lease, KEYS.estop, "hexctl/*/estop", "hexctl/**"):
            assert answers(viewer, key, b"viewer") == []
        for session, name in ((viewer, b"viewer"), (controller, b"controller")):
            session.put(KEYS.command, name)
            session.put(KEYS.pose, name)
        wait_until(lambda: ("pose", b"controller") in robot.heard, "what the controller may say")
        time.sleep(GRACE_S)
    assert ("command", b"controller") in robot.heard
    assert not [said for said in robot.heard if said[1] == b"viewer"]


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
@pytest.mark.parametrize(
    ("protocol", "role"),
    [
        ("tcp", Role.CONTROLLER),
        ("tls", Role.CONTROLLER),
        ("tls", Role.VIEWER),
        ("quic", Role.CONTROLLER),
        ("quic", Role.VIEWER),
    ],
)
def test_nobody_speaks_answers_or_listens_in_the_robots_name(
    robot: ListeningRobot, authority: Path, role: Role, mode: str
) -> None:
    settings = {} if robot.link.credentials is None else tls(authority / role.value, "connect")
    heard: list[bytes] = []
    listened: list[bytes] = []

    def answer(query: Any) -> None:
        query.reply(str(query.key_expr), b"impostor")
        query.drop()

    with (
        client(robot, Role.CONTROLLER) as victim,
        knocking(robot.link.endpoint, settings, mode) as impostor,
    ):
        for key in (KEYS.joint_states, KEYS.status):
            victim.declare_subscriber(key, lambda sample: heard.append(bytes(sample.payload)))
        impostor.declare_subscriber("**", lambda sample: listened.append(bytes(sample.payload)))
        impostor.declare_subscriber(KEYS.command, lambda sample: listened.append(bytes(sample.payload)))
        for key in (KEYS.lease, KEYS.describe, KEYS.estop, "hexctl/**"):
            impostor.declare_queryable(key, answer)
        token = impostor.liveliness().declare_token("hexctl/ant/alive")
        wait_until(lambda: robot.publisher.put(b"state") or b"state" in heard, "a state")
        for key in ALL_SAID:
            impostor.put(key, b"impostor")
            impostor.delete(key)
        victim.put(KEYS.command, b"secret")
        for kind in ("lease", "describe", "estop"):
            assert answers(victim, getattr(KEYS, kind)) == [b"robot"]
        assert answers(robot.session, KEYS.lease) == [b"robot"]
        assert not list(victim.liveliness().get("**", timeout=GRACE_S))
        token.undeclare()  # type: ignore[no-untyped-call]
    assert set(heard) == {b"state"}
    assert b"secret" not in listened
    assert ("command", b"secret") in robot.heard
    said = {kind for kind, payload in robot.heard if payload in (b"impostor", b"")}
    assert said <= {"lease", "describe", "estop"} | (
        {"command", "pose"} if role is Role.CONTROLLER else set()
    )


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_message_that_is_too_long_is_dropped_on_the_way(protocol: str, authority: Path) -> None:
    keys = authority if protocol == "tls" else None
    link = Link(endpoint=f"{protocol}/127.0.0.1:{free_port()}", credentials=keys)
    sizes: list[int] = []
    with open_session(link, Role.ROBOT, KEYS) as robot, open_session(link, Role.CONTROLLER, KEYS) as sender:
        robot.declare_subscriber(KEYS.command, lambda sample: sizes.append(len(sample.payload)))
        wait_until(lambda: sender.put(KEYS.command, b"") or sizes, "a message")
        for size in (MAX_MESSAGE_BYTES // 2, *[2 * MAX_MESSAGE_BYTES] * 5, 20_000_000, 7):
            sender.put(KEYS.command, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
            time.sleep(0.1)  # shared memory, were it on, would take long messages over from here on
        wait_until(lambda: 7 in sizes, "the message after them")
    assert [size for size in sizes if size] == [MAX_MESSAGE_BYTES // 2, 7]
