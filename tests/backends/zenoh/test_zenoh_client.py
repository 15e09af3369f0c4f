"""Zenoh client: conformance over a served robot, plain ROS 2 robots, refusals, leases on a bad link."""

import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import zenoh

from hexctl.backends.base import LegServos
from hexctl.backends.zenoh.subscriber import PLAIN_TAG, LatestValues, StateSubscriber
from hexctl.backends.zenoh.zenoh_client import LeaseClient, ZenohServos, granted, linked_robot
from hexctl.control.guard import Guard
from hexctl.errors import EStopError, HexctlError, RobotFaultError
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.server.leases import LEASE_S, LeaseManager
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import JointTargets, ServoReadings
from hexctl.wire.description import describe, user_name
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import encode_pose
from hexctl.wire.zenoh_messages import CommandTag, decode_positions, encode_battery, encode_positions
from hexctl.wire.zenoh_session import open_session
from tests.backends.bus.boards import a_map, bus_board
from tests.backends.fake_time import FakeTime
from tests.backends.standing import command, next_state, stand, until
from tests.robots import edited_file, put, shipped
from tests.server.processes import Served, free_port, hexctl, hexctl_process, served, wait_until


@pytest.fixture(scope="module")
def served_mock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A robot that tests share; each leaves it without a lease and without a stop."""
    with served(tmp_path_factory.mktemp("robot"), backend="mock") as robot:
        yield robot


@pytest.mark.realtime
class TestServed(LegServosConformance):
    @pytest.fixture(autouse=True)
    def robot(self, served_mock: Served) -> None:
        self.endpoint = served_mock.endpoint

    def make(self) -> LegServos:
        return ZenohServos(shipped(), link=Link(endpoint=self.endpoint))


NAMES = {"command": "robot7/joint_commands", "joint_states": "robot7/joint_states"}


class PlainRobot:
    """Echoes the joint angles it is sent, without tags, description or lease."""

    def __init__(self, link: Link) -> None:
        self.session = open_session(link, Role.ROBOT, KeyMap.of("ant").renamed(NAMES))
        self.joint_positions_rad = shipped().stance_angles_rad
        self.session.declare_subscriber(NAMES["command"], self._obey)

    def _obey(self, sample: Any) -> None:
        self.joint_positions_rad = decode_positions(bytes(sample.payload))
        self.say()

    def say(self) -> None:
        """Publish a state."""
        self.session.put(NAMES["joint_states"], encode_positions(self.joint_positions_rad))


@pytest.fixture
def link() -> Link:
    return Link(endpoint=f"tcp/127.0.0.1:{free_port()}", names=NAMES, plain=True)


@pytest.fixture
def robot(link: Link) -> Iterator[PlainRobot]:
    robot = PlainRobot(link)
    yield robot
    robot.session.close()  # type: ignore[no-untyped-call]


@pytest.mark.realtime
def test_a_plain_robot_can_be_commanded_and_its_silence_stops_the_controller(
    link: Link, robot: PlainRobot
) -> None:
    threading.Timer(0.2, robot.say).start()
    with Guard(ZenohServos(shipped(), link=link)) as guard:
        wanted = shipped().stance_angles_rad + 0.05
        stand(guard, 10, 0.05)
        wait_until(lambda: np.allclose(robot.joint_positions_rad, wanted), "the command")
        np.testing.assert_allclose(next_state(guard).joint_positions_rad, wanted)
        time.sleep(0.3)
        next_state(guard)
        assert guard.stopped == "state"
        with pytest.raises(EStopError):
            command(guard)


@pytest.mark.realtime
def test_no_robot() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(RobotFaultError, match=endpoint):
        ZenohServos(shipped(), link=Link(endpoint=endpoint)).connect()
    commands = (("status",), ("estop",), ("run", "--backend", "zenoh", "--no-record"))
    with ThreadPoolExecutor() as together:
        for answer in together.map(lambda words: hexctl_process(*words, "--connect", endpoint), commands):
            assert answer.returncode == 3
            assert all(endpoint in line for line in answer.stderr.splitlines())


@pytest.mark.realtime
def test_a_stop_by_another_client_ends_the_controller(tmp_path: Path) -> None:
    with (
        served(tmp_path, backend="mock") as robot,
        Guard(ZenohServos(shipped(), link=Link(endpoint=robot.endpoint))) as guard,
    ):
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        until(guard, lambda _: guard.stopped is not None, write=False)
        assert guard.stopped == "estop"


@pytest.mark.realtime
def test_what_servos_on_a_bus_report_comes_over_the_link(tmp_path: Path) -> None:
    with (
        bus_board(a_map(), "hot:2:femur:61", "mute:5:coxa@6") as bus,
        served(tmp_path, "--robot", "phantomx", "--port", bus.path, backend="feetech") as server,
        ZenohServos("phantomx", link=Link(endpoint=server.endpoint)) as servos,
    ):
        mute = "mute: leg 5 coxa (id 13)"
        state = until(servos, lambda state: mute in state.warnings, write=False, ticks=1500)
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [12]
        readings = state.servos
        assert readings is not None
        assert readings.hottest_joint == 4
        assert readings.temperatures_c[4] == 61
        assert np.isfinite(np.delete(readings.voltages_v, 12)).all()
        assert readings.ages_s[12] > 0.3
        assert np.delete(readings.ages_s, 12).max() < readings.ages_s[12]


@pytest.mark.parametrize(
    ("plain", "named", "user", "error"),
    [
        (False, True, user_name(), r"mount_positions_body\[2\]\[0\]"),
        (True, True, user_name(), "sends no state"),  # a plain robot describes itself to nobody
        (False, False, "neighbour", "neighbour on"),
    ],
)
def test_another_robot_is_refused_before_the_lease_is_asked_for(
    plain: bool, named: bool, user: str, error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, asked = "hexctl.backends.zenoh.zenoh_client", list[str]()
    path = edited_file(tmp_path, put("mounts", 2, "azimuth_deg", 121 if named else 120))
    answer = describe(shipped()) | {"status": {"user": user, "host": socket.gethostname()}}

    def answers(_: object, key: str, *__: object, **___: object) -> list[dict[str, Any]]:
        asked.append(key)
        return [answer]

    monkeypatch.setattr(f"{client}.open_session", MagicMock())
    monkeypatch.setattr(f"{client}.ask_until", answers)
    link, time = Link(endpoint="tcp/127.0.0.1:1", plain=plain, named=named), FakeTime()
    servos = ZenohServos(load_robot(path), link=link, latest=LatestValues(time), time=time)
    with pytest.raises(HexctlError, match=error):
        servos.connect()
    assert len(asked) == (not plain)


GRANTED = {"lease": "0f" * 16, "sequence": 3, "duration_s": 1}


def test_a_lease_is_read_and_one_that_cannot_be_held_is_refused() -> None:
    assert granted(GRANTED) == (b"\x0f" * 16, 3, 1.0)
    spoiled: dict[str, Any] = {"lease": "0f", "sequence": 1 << 32, "duration_s": 1e-9}
    for key, value in spoiled.items():
        others: tuple[Any, ...] = (value, None, True, [], "nan")
        for other in others:
            with pytest.raises(RobotFaultError, match="lease"):
                granted({**GRANTED, key: other})
    with pytest.raises(RobotFaultError, match="same version"):
        granted({})


# Without a server, on simulated time.

#: Of so many requests in a row one is obeyed and answered.
ANSWERED = 3


class LossyRobot:
    """Gives leases; of the requests after the first most are lost before they arrive.

    Attributes:
        heard: requests that arrived, by kind.
        gone: whether nothing is answered any more.
    """

    gone = False

    def __init__(self, session: zenoh.Session, key: str, time: FakeTime) -> None:
        self._time = time
        self.heard: Counter[str] = Counter()
        self._leases, self._asked = LeaseManager(), 0
        session.declare_queryable(key, self._answer)

    def _answer(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        content: dict[str, Any] = json.loads(query.payload.to_bytes())
        op, now_s = content["op"], self._time.now()
        if op != "acquire":
            self._asked += 1
            if self._asked % ANSWERED or self.gone:
                return
        self.heard[op] += 1
        answer: dict[str, Any] = {}
        try:
            if op == "acquire":
                lease = self._leases.acquire(content["owner"], now_s)
                answer = {"lease": lease.lease_id.hex(), "sequence": lease.sequence}
                answer["duration_s"] = LEASE_S
            elif op == "renew":
                self._leases.renew(bytes.fromhex(content["lease"]), now_s)
        except HexctlError as error:
            answer = {"error": str(error)}
        query.reply(query.key_expr, json.dumps(answer).encode())


@pytest.fixture
def fake_time() -> FakeTime:
    return FakeTime()


@pytest.fixture
def lossy(fake_time: FakeTime) -> Iterator[tuple[LossyRobot, LeaseClient]]:
    at = Link(endpoint=f"tcp/127.0.0.1:{free_port()}")
    keys = KeyMap.of("ant")
    with open_session(at, Role.ROBOT, keys) as there, open_session(at, Role.CONTROLLER, keys) as here:
        yield LossyRobot(there, keys.lease, fake_time), LeaseClient(here, keys.lease, time=fake_time)


def test_requests_that_are_lost_are_sent_again(lossy: tuple[LossyRobot, LeaseClient]) -> None:
    robot, lease = lossy
    lease.acquire()
    for count in range(1, 6):
        lease.pause_watchdog(after=3)
        assert robot.heard["rest"] >= count
    lease.release()
    assert robot.heard["release"] == 1


def test_a_lease_outlasts_a_bad_link(lossy: tuple[LossyRobot, LeaseClient], fake_time: FakeTime) -> None:
    robot, lease = lossy
    lease.acquire()
    fake_time.sleep(60.0)
    assert lease.lost is None
    assert robot.heard["renew"] >= 60
    robot.gone, gone_s = True, fake_time.now()
    fake_time.sleep(3 * LEASE_S)
    assert lease.lost is not None
    assert LEASE_S / 2 < lease.lost_at_s - gone_s < 2 * LEASE_S
    lease.release()


def state(sequence: int) -> SimpleNamespace:
    tag = replace(PLAIN_TAG, sequence=sequence)
    return SimpleNamespace(payload=encode_positions(np.zeros(18)), attachment=tag.packed())


def test_states_of_before_the_lease_are_not_waited_for() -> None:
    """They come on another thread than the answer that grants it, and may tell of a stop that it lifted."""
    latest = LatestValues(FakeTime())
    states = StateSubscriber(KeyMap.of("ant"), latest)
    states.forget(after=5)
    for sequence in (4, 5):
        latest.put("joint_states", state(sequence))
        with pytest.raises(RobotFaultError, match="sends no state"):
            states.wait_for_first_s()
    latest.put("joint_states", state(6))
    assert states.wait_for_first_s() == states.heard_at_s


@pytest.mark.parametrize("plain", [False, True])
def test_a_state_is_as_old_as_its_stamp_and_a_late_pose_is_none(plain: bool) -> None:
    time = FakeTime()
    latest = LatestValues(time)
    states = StateSubscriber(KeyMap.of("ant"), latest, plain=plain)
    ahead = ((-3600.0, 0.0, True), *10 * ((0.0, 3600.0, False),), (0.0, 0.0, True))
    for late_s, age_s, posed in ((0.0, 0.0, True), (0.3, 0.3, True), (0.7, 0.7, False), *ahead):
        time.sleep(1.0)
        stamp_ns = round(1e9 * (time.now_s - late_s + 50))
        tag = None if plain else replace(PLAIN_TAG, stamp_ns=stamp_ns).packed()
        for kind, payload in (
            ("joint_states", encode_positions(np.zeros(18), stamp_ns)),
            ("odom", encode_pose(np.zeros(3), None, stamp_ns=stamp_ns)),
        ):
            latest.put(kind, SimpleNamespace(payload=payload, attachment=tag))
        state = states.newest(time.now_s)
        assert state.age_s == pytest.approx(age_s, abs=0.02)
        assert (state.base_position_world is not None) is posed


def test_what_a_robot_reports_arrives_and_what_is_nonsense_is_unknown() -> None:
    time = FakeTime()
    latest = LatestValues(time)
    states = StateSubscriber(KeyMap.of("ant"), latest)
    contacts, stale, torques = np.arange(6) % 2 == 0, np.arange(18) == 4, np.linspace(0.0, 1.7, 18)
    tag = replace(
        PLAIN_TAG, contacts=contacts, stale_joints=stale, measured=False, age_us=20_000,
        healthy=False, fault="no \x1b power", stopped="estop",
    ).packed()  # fmt: skip
    half = np.full(18, 0.5)
    servos = ServoReadings(ages_s=half, efforts=half, currents_a=half, voltages_v=half, temperatures_c=half)
    status = {"failures": ["5:limp"], "warnings": ["leg 2: low"], "servos": servos.to_json()}
    good = {
        "joint_states": encode_positions(np.arange(18.0), 0, torques, 2 * torques),
        "status": json.dumps(status).encode(),
        "battery": encode_battery(12.5, 0.5),
        "odom": encode_pose(np.ones(3), np.array([1.0, 0.0, 0.0, 0.0])),
    }
    for kind, payload in good.items():
        latest.put(kind, SimpleNamespace(payload=payload, attachment=tag))
    time.sleep(0.1)
    told = states.newest(time.now_s)
    assert (told.measured, told.healthy, told.stopped, told.warnings) == (
        False,
        False,
        "estop",
        ("leg 2: low",),
    )
    assert (told.fault, told.battery_v, told.battery_share) == ("no \\x1b power", 12.5, 0.5)
    assert (told.age_s, told.stamp_s) == pytest.approx((0.12, time.now_s - 0.1))
    assert told.servos is not None
    numbers: tuple[tuple[Any, Any], ...] = (
        (told.joint_positions_rad, np.arange(18.0)),
        (told.joint_torques_nm, torques),
        (told.joint_velocities_rad_s, 2 * torques),
        (told.foot_contacts, contacts),
        (told.stale_joints, stale),
        (told.base_position_world, np.ones(3)),
        (told.servos.ages_s, half + 0.1),
    )
    for got, wanted in numbers:
        np.testing.assert_allclose(got, wanted)
    assert states.failures == (Failure(leg=5, kind="limp"),)
    for kind in ("status", "battery", "odom"):
        latest.put(kind, SimpleNamespace(payload=b"{", attachment=tag))
    told = states.newest(time.now_s)
    assert (told.warnings, told.servos, told.battery_v, told.base_position_world) == ((), None, None, None)
    assert states.failures is None
    time.sleep(5.0)
    with pytest.raises(RobotFaultError, match="silent for 5 s"):
        states.newest(time.now_s)
    latest.put("joint_states", SimpleNamespace(payload=b"{", attachment=tag))
    with pytest.raises(RobotFaultError, match="invalid states"):
        states.newest(time.now_s)


def test_commands_are_numbered_under_the_lease_and_end_soon_after_it_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """For a moment a state may still come that says why it is lost."""
    client, time, asked = "hexctl.backends.zenoh.zenoh_client", FakeTime(), list[dict[str, Any]]()
    session, arrivals, answer, number = MagicMock(), dict[str, Any](), dict[str, Any](), 4

    def ask(_: object, __: str, content: dict[str, Any], **___: object) -> list[dict[str, Any]]:
        asked.append(content)
        return [answer]

    def publisher(*_: object, **__: object) -> MagicMock:
        arrivals[KeyMap.of("ant").joint_states](state(number))
        return session

    monkeypatch.setattr(f"{client}.open_session", lambda *_: nullcontext(session))
    monkeypatch.setattr(f"{client}.ask_until", lambda *_, **__: [describe(shipped()) | granting])
    monkeypatch.setattr(f"{client}.ask", ask)
    monkeypatch.setattr("hexctl.backends.zenoh.subscriber.FIRST_STATE_TIMEOUT_S", 0.1)
    session.declare_subscriber.side_effect = arrivals.__setitem__
    session.declare_publisher.side_effect = publisher
    link = Link(endpoint="tcp/127.0.0.1:1")
    servos = ZenohServos(shipped(), link=link, latest=LatestValues(time), time=time)
    granting: dict[str, Any] = {"error": "alice commands the robot"}
    with pytest.raises(RobotFaultError, match="alice"):
        servos.connect()
    granting = GRANTED | {"state": 5, "status": {"simulated": {"world": "flat"}}}
    with pytest.raises(RobotFaultError, match="sends no state"):  # but one of before the lease
        servos.connect()
    assert asked.pop()["op"] == "release"
    asked.clear()
    number = 7
    with servos:
        assert servos.simulated == {"world": "flat"}
        targets = JointTargets(shipped().stance_angles_rad, 0.0)
        for sequence in (1, 2):
            servos.clock.tick()
            servos.write(targets)
            (payload,), more = session.put.call_args
            np.testing.assert_allclose(decode_positions(payload), targets.joint_positions_rad)
            tag = CommandTag.unpacked(more["attachment"])
            assert (tag.sequence, tag.lease_id, tag.lease_sequence) == (sequence, b"\x0f" * 16, 3)
            assert (tag.time_to_live_ms, tag.stamp_ns) == (200, int(1e9 * time.now()))
        servos.pause_watchdog()
        assert (asked[-1]["op"], asked[-1]["after"]) == ("rest", 2)
        answer = {"error": "taken by another"}
        for _ in range(25):
            servos.clock.tick()
            servos.read()
        for _ in range(15):
            servos.clock.tick()
        with pytest.raises(RobotFaultError, match="no longer commands the robot: taken by another"):
            servos.read()
    assert {one["op"] for one in asked} == {"rest", "renew"}, "the lease is another client's"


def test_of_several_robots_a_viewer_sees_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    client, link = "hexctl.backends.zenoh.zenoh_client", Link(endpoint="tcp/127.0.0.1:1")
    robots = [SimpleNamespace(name="ant"), SimpleNamespace(name="bee")]
    monkeypatch.setattr(f"{client}.open_session", MagicMock())
    monkeypatch.setattr(f"{client}.ask_until", lambda *_, **__: robots)
    monkeypatch.setattr(f"{client}.robot_of", lambda answer: answer)
    with linked_robot(link, Role.VIEWER, first=True) as (_, robot):
        assert robot.name == "ant"
    for name, error in ((None, "robot: got none, and there are: ant, bee"), ("ant", "2 robots called ant")):
        with pytest.raises(HexctlError, match=error), linked_robot(link, Role.VIEWER, name):
            pass
