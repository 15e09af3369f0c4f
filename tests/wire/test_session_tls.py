"""Mutual TLS and access control, for real: who is let in, and what each may do. On loopback, free ports."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.serve.certificates import make_certificates
from hexctl.wire.keys import KeyMap
from hexctl.wire.link import Link
from hexctl.wire.role import Role
from hexctl.wire.session import open_session
from tests.serve.processes import free_port, wait_until

KEYS = KeyMap.of("ant")

#: Long enough for a message that is let through to arrive, many times over.
GRACE_S = 0.5


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tls") / "keys"
    make_certificates(folder, hosts=["127.0.0.1"], days=1)
    return folder


@pytest.fixture(scope="module")
def other_authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("other") / "keys"
    make_certificates(folder, hosts=["127.0.0.1"], days=1)
    return folder


@dataclass
class ListeningRobot:
    """A robot's session that keeps what reaches it."""

    link: Link
    session: zenoh.Session
    heard: list[tuple[str, bytes]] = field(default_factory=list)

    def listen(self) -> None:
        for kind in ("command", "pose", "joint_states", "status"):
            self.session.declare_subscriber(getattr(KEYS, kind), self._keeper(kind))
        for kind in ("describe", "lease", "estop"):
            self.session.declare_queryable(getattr(KEYS, kind), self._answerer(kind))
        self.publisher = self.session.declare_publisher(KEYS.joint_states)

    def _keeper(self, kind: str) -> Any:
        return lambda sample: self.heard.append((kind, bytes(sample.payload)))

    def _answerer(self, kind: str) -> Any:
        def answer(query: Any) -> None:
            self.heard.append((kind, bytes(query.payload or b"")))
            query.reply(getattr(KEYS, kind), b"robot")
            query.drop()

        return answer


@pytest.fixture(params=["tls", "quic"])
def robot(request: pytest.FixtureRequest, authority: Path) -> Iterator[ListeningRobot]:
    link = Link(endpoint=f"{request.param}/127.0.0.1:{free_port()}", credentials=authority)
    with open_session(link, Role.ROBOT, KEYS) as session:
        robot = ListeningRobot(link, session)
        robot.listen()
        yield robot


@contextmanager
def client(robot: ListeningRobot, role: Role) -> Iterator[zenoh.Session]:
    with open_session(robot.link, role, KEYS) as session:
        yield session


def answers(session: zenoh.Session, key: str, payload: bytes = b"") -> list[bytes]:
    return [bytes(reply.ok.payload) for reply in session.get(key, payload=payload, timeout=1.0) if reply.ok]


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


@pytest.mark.parametrize("role", [Role.VIEWER, Role.CONTROLLER])
def test_nobody_speaks_or_answers_in_the_robots_name(robot: ListeningRobot, role: Role) -> None:
    heard: list[bytes] = []
    asked: list[bytes] = []

    def answer(query: Any) -> None:
        asked.append(b"asked")
        query.reply(str(query.key_expr), b"impostor")
        query.drop()

    with client(robot, Role.CONTROLLER) as victim, client(robot, role) as impostor:
        victim.declare_subscriber(KEYS.joint_states, lambda sample: heard.append(bytes(sample.payload)))
        victim.declare_subscriber(KEYS.status, lambda sample: heard.append(bytes(sample.payload)))
        for kind in ("lease", "describe", "estop"):
            impostor.declare_queryable(getattr(KEYS, kind), answer)
        wait_until(lambda: robot.publisher.put(b"state") or heard, "a state")
        impostor.put(KEYS.joint_states, b"impostor")
        impostor.put(KEYS.status, b"impostor")
        for kind in ("lease", "describe", "estop"):
            assert answers(victim, getattr(KEYS, kind)) == [b"robot"]
        assert answers(robot.session, KEYS.lease) == [b"robot"]
        time.sleep(GRACE_S)
    assert set(heard) == {b"state"}
    assert not asked
    assert not [said for said in robot.heard if said[1] == b"impostor"]


def test_a_certificate_of_another_authority_is_not_let_in(
    robot: ListeningRobot, other_authority: Path
) -> None:
    stranger = replace(robot.link, credentials=other_authority)
    with pytest.raises(RobotFaultError, match=r"does not accept this end|nothing listens"):
        open_session(stranger, Role.CONTROLLER, KEYS)
    assert not robot.heard


def test_a_peer_without_a_certificate_is_not_let_in(robot: ListeningRobot, authority: Path) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", f'["{robot.link.endpoint}"]')
    config.insert_json5("connect/timeout_ms", "2000")
    config.insert_json5("transport/link/tls/root_ca_certificate", f'"{authority}/robot/ca.pem"')
    with pytest.raises(zenoh.ZError):
        zenoh.open(config)
    plain = Link(endpoint=robot.link.endpoint.replace("tls/", "tcp/").replace("quic/", "tcp/"))
    with pytest.raises(RobotFaultError):
        open_session(plain, Role.CONTROLLER, KEYS)
    assert not robot.heard


def test_a_robot_under_another_name_than_its_certificates_is_not_trusted(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    make_certificates(folder, hosts=["robot.example"], days=1)
    link = Link(endpoint=f"tls/127.0.0.1:{free_port()}", credentials=folder)
    with (
        open_session(link, Role.ROBOT, KEYS),
        pytest.raises(RobotFaultError, match=r"made for 127\.0\.0\.1"),
    ):
        open_session(link, Role.CONTROLLER, KEYS)


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp/0.0.0.0:7447", "without certificates"),
        ("tcp/192.168.1.20:7447", "without certificates"),
        ("tcp/robot.local:7447", "--insecure"),
        ("tcp/[::]:7447", "without certificates"),
        ("tls/127.0.0.1:7447", "needs certificates"),
        ("quic/0.0.0.0:7447", "needs certificates"),
    ],
)
@pytest.mark.parametrize("role", list(Role))
def test_beyond_this_computer_nothing_opens_without_certificates(
    endpoint: str, words: str, role: Role
) -> None:
    with pytest.raises(InputError, match=words):
        open_session(Link(endpoint=endpoint), role, KEYS)


def test_whoever_types_insecure_gets_it() -> None:
    link = Link(endpoint=f"tcp/0.0.0.0:{free_port()}", insecure=True)
    with open_session(link, Role.ROBOT, KEYS) as robot:
        robot.declare_queryable(KEYS.describe, lambda query: query.reply(KEYS.describe, b"robot"))
        near = Link(endpoint=link.endpoint.replace("0.0.0.0", "127.0.0.1"))  # noqa: S104  meant so
        with open_session(near, Role.VIEWER, KEYS) as viewer:
            assert answers(viewer, KEYS.describe) == [b"robot"]
