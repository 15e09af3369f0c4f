"""Sessions over real links: refused clients, with the message that a user reads, beside admitted ones."""

import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.wire import certificates, zenoh_session
from hexctl.wire.certificates import make_certificates, renew_certificates
from hexctl.wire.links import Link, Role
from hexctl.wire.zenoh_session import MAX_MESSAGE_BYTES, open_session
from tests.server.processes import free_port, wait_until
from tests.wire.knocking import KEYS, ListeningRobot, answers, knocking, posing_as_robot, tls


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that is refused in these tests would not be admitted later either."""
    monkeypatch.setattr(zenoh_session, "CONNECT_MS", 1000)


@pytest.fixture
def protocol() -> str:
    return "tls"


@pytest.fixture
def link(protocol: str, authority: Path) -> Link:
    keys = None if protocol == "tcp" else authority
    return Link(endpoint=f"{protocol}/127.0.0.1:{free_port()}", credentials=keys)


@contextmanager
def listening(link: Link) -> Iterator[ListeningRobot]:
    with open_session(link, Role.ROBOT, KEYS) as session:
        robot = ListeningRobot(link, session)
        robot.listen()
        yield robot


@pytest.fixture
def robot(link: Link) -> Iterator[ListeningRobot]:
    with listening(link) as robot:
        yield robot


def let_in(link: Link, role: Role = Role.CONTROLLER) -> bool:
    with open_session(link, role, KEYS) as opened:
        return answers(opened, KEYS.describe) == [b"robot"]


def refused(link: Link) -> str:
    with pytest.raises(RobotFaultError) as error:
        open_session(link, Role.CONTROLLER, KEYS)
    assert "\n" not in str(error.value)
    return str(error.value)


def expired(authority: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a controller's certificate of an authority that was good until some weeks ago."""

    class LongAgo(datetime):
        @classmethod
        def now(cls, _tz: object = None) -> "datetime":  # type: ignore[override]
            return datetime.now(UTC) - timedelta(days=30)

    shutil.copytree(authority, folder)
    with monkeypatch.context() as patched:
        patched.setattr(certificates, "datetime", LongAgo)
        renew_certificates(folder, days=5)
    return folder / "controller"


@pytest.mark.realtime
def test_who_knocks_without_a_good_certificate_is_not_let_in(
    robot: ListeningRobot,
    authority: Path,
    other_authority: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (stranger := tmp_path / "stranger").mkdir()
    for name, home in (
        ("ca.pem", authority),
        ("certificate.pem", other_authority),
        ("key.pem", other_authority),
    ):
        (stranger / name).write_bytes((home / "controller" / name).read_bytes())
    good = tls(authority / "controller", "connect")
    for settings in (
        {"transport/link/tls/root_ca_certificate": good["transport/link/tls/root_ca_certificate"]},
        tls(stranger, "connect"),
        tls(authority / "robot", "connect"),
        tls(expired(authority, tmp_path / "expired", monkeypatch), "connect"),
    ):
        with pytest.raises(zenoh.ZError):
            knocking(robot.link.endpoint, settings)
    assert not robot.heard
    with knocking(robot.link.endpoint, good) as opened:
        assert answers(opened, KEYS.lease) == [b"robot"]


@pytest.mark.realtime
def test_only_a_robots_certificate_is_good_for_a_robot(link: Link, authority: Path) -> None:
    for role, trusted in ((Role.CONTROLLER, False), (Role.ROBOT, True)):
        with posing_as_robot(link.endpoint, tls(authority / role.value, "listen")) as posing:
            ListeningRobot(link, posing).listen()
            if trusted:
                assert let_in(link)
            else:
                assert "certificate purpose" in refused(link)


@pytest.mark.realtime
def test_a_certificate_of_another_authority(robot: ListeningRobot, other_authority: Path) -> None:
    assert "same authority" in refused(replace(robot.link, credentials=other_authority))
    assert not robot.heard
    assert let_in(robot.link)


@pytest.mark.realtime
def test_a_robot_under_another_name_than_its_certificates(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    link = Link(endpoint=f"tls/127.0.0.1:{free_port()}", credentials=tmp_path / "keys")
    with listening(link):
        assert "127.0.0.1" in refused(link)
        assert let_in(replace(link, endpoint=link.endpoint.replace("127.0.0.1", "localhost")))


@pytest.mark.realtime
def test_plain_to_secured_and_secured_to_plain(robot: ListeningRobot, authority: Path) -> None:
    plain = Link(endpoint=robot.link.endpoint.replace("tls/", "tcp/"))
    assert "tls/" in refused(plain)
    assert not robot.heard
    open_one = Link(endpoint=f"tcp/127.0.0.1:{free_port()}")
    with listening(open_one):
        secured = Link(endpoint=open_one.endpoint.replace("tcp/", "tls/"), credentials=authority)
        assert "credentials" in refused(secured)
        assert let_in(open_one, Role.VIEWER)


@pytest.mark.realtime
def test_where_no_robot_is(authority: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as hung:  # its kernel goes on taking connections
        assert "no answer" in refused(Link(endpoint=f"tcp/127.0.0.1:{hung.getsockname()[1]}"))
    assert "nothing listens" in refused(Link(endpoint=f"tcp/127.0.0.1:{free_port()}"))
    assert "nowhere.invalid" in refused(Link(endpoint="tcp/nowhere.invalid:7447", insecure=True))
    assert "no robot" in refused(Link(endpoint=f"quic/127.0.0.1:{free_port()}", credentials=authority))


def test_where_a_robot_cannot_listen(robot: ListeningRobot) -> None:
    for link in (robot.link, Link(endpoint="tcp/192.0.2.1:7447", insecure=True)):
        with pytest.raises(RobotFaultError, match="cannot listen at"):
            open_session(link, Role.ROBOT, KEYS)


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.0:7447", "tcp/192.168.1.20:7447", "tcp/robot.local:7447", "tcp/[::]:7447",
     "tls/127.0.0.1:7447", "quic/0.0.0.0:7447"],
)  # fmt: skip
def test_beyond_this_computer_nothing_opens_without_certificates(endpoint: str) -> None:
    for role in Role:
        with pytest.raises(InputError, match=r"certificates|insecure"):
            open_session(Link(endpoint=endpoint), role, KEYS)


def test_certificates_that_would_not_be_used_are_not_taken(authority: Path) -> None:
    for role in Role:
        with pytest.raises(InputError, match=r"tls/127\.0\.0\.1:7447"):
            open_session(Link(credentials=authority), role, KEYS)


def test_all_addresses_are_for_listening_only() -> None:
    everywhere = Link(endpoint=f"tcp/0.0.0.0:{free_port()}", insecure=True)
    with pytest.raises(InputError, match="where a robot listens"):
        open_session(everywhere, Role.VIEWER, KEYS)
    with listening(everywhere):
        near = Link(endpoint=everywhere.endpoint.replace("0.0.0.0", "127.0.0.1"))  # noqa: S104  meant so
        assert let_in(near, Role.VIEWER)


#: Long enough for a message that is let through to arrive, many times over.
GRACE_S = 0.5

#: Key expressions under which an impostor could speak for a robot, to it, or to all peers.
ALL_SAID = (
    *(KEYS.joint_states, KEYS.status, KEYS.imu, KEYS.truth, KEYS.command, KEYS.pose),
    *("hexctl/ant/*", "hexctl/**", "**"),
)


def hearing(session: zenoh.Session, key: str) -> list[bytes]:
    """What is heard at a key from now on."""
    heard: list[bytes] = []
    session.declare_subscriber(key, lambda sample: heard.append(bytes(sample.payload)))
    return heard


@pytest.mark.realtime
@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_a_controller_commands_and_a_viewer_only_reads(robot: ListeningRobot) -> None:
    states: list[bytes] = []
    with (
        open_session(robot.link, Role.CONTROLLER, KEYS) as controller,
        open_session(robot.link, Role.VIEWER, KEYS) as viewer,
    ):
        viewer.declare_subscriber(KEYS.joint_states, lambda sample: states.append(bytes(sample.payload)))
        wait_until(lambda: robot.publisher.put(b"state") or states, "a state")
        for key in (KEYS.imu, KEYS.truth):
            heard = hearing(viewer, key)
            wait_until(lambda: robot.session.put(key, b"own") or heard, key)  # noqa: B023
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


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("protocol", "role", "mode"),
    [
        ("tcp", Role.CONTROLLER, "peer"),
        ("tcp", Role.CONTROLLER, "router"),
        ("tls", Role.CONTROLLER, "client"),
        ("tls", Role.VIEWER, "router"),
        ("quic", Role.CONTROLLER, "router"),
        ("quic", Role.VIEWER, "peer"),
    ],
)
def test_no_other_peer_publishes_answers_or_listens_in_the_robots_name(
    robot: ListeningRobot, authority: Path, role: Role, mode: str
) -> None:
    settings = {} if robot.link.credentials is None else tls(authority / role.value, "connect")
    heard: list[bytes] = []
    listened: list[bytes] = []

    def answer(query: Any) -> None:
        query.reply(str(query.key_expr), b"impostor")
        query.drop()

    with (
        open_session(robot.link, Role.CONTROLLER, KEYS) as victim,
        knocking(robot.link.endpoint, settings, mode) as impostor,
    ):
        for key in (KEYS.joint_states, KEYS.status, KEYS.imu, KEYS.truth):
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
        wait_until(lambda: ("command", b"secret") in robot.heard, "the command")
        token.undeclare()  # type: ignore[no-untyped-call]
    assert set(heard) == {b"state"}
    assert b"secret" not in listened
    said = {kind for kind, payload in robot.heard if payload in (b"impostor", b"")}
    assert said <= {"lease", "describe", "estop"} | (
        {"command", "pose"} if role is Role.CONTROLLER else set()
    )


@pytest.mark.realtime
@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_message_that_is_too_long_is_dropped_on_the_way(link: Link) -> None:
    sizes: list[int] = []
    with (
        open_session(link, Role.ROBOT, KEYS) as opened,
        open_session(link, Role.CONTROLLER, KEYS) as sender,
    ):
        opened.declare_subscriber(KEYS.command, lambda sample: sizes.append(len(sample.payload)))
        wait_until(lambda: sender.put(KEYS.command, b"") or sizes, "a message")
        for size in (MAX_MESSAGE_BYTES // 2, *[2 * MAX_MESSAGE_BYTES] * 5, 20_000_000, 7):
            sender.put(KEYS.command, bytes(size), congestion_control=zenoh.CongestionControl.BLOCK)
            time.sleep(0.1)  # shared memory, were it on, would take long messages over from here on
        wait_until(lambda: 7 in sizes, "the message after them")
    assert [size for size in sizes if size] == [MAX_MESSAGE_BYTES // 2, 7]
