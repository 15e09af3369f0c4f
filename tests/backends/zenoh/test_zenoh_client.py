"""Zenoh client: conformance over a served mock and simulation, plain ROS 2 robots, refusals."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.zenoh.zenoh_client import ZenohServos, granted
from hexctl.control.guard import Guard
from hexctl.errors import EStopError, InputError, RobotFaultError
from hexctl.robot.loader import load_robot
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import JointTargets, RobotState
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import decode_positions, encode_positions
from hexctl.wire.zenoh_session import open_session
from tests.backends.bus.boards import a_map, bus_board
from tests.robots import edited_file, put, shipped
from tests.server.processes import Served, free_port, hexctl, hexctl_process, served, wait_until

pytestmark = pytest.mark.realtime


class ServedConformance(LegServosConformance):
    """The suite over a link; each class of tests has a robot of its own."""

    backend = "mock"
    robot: Served

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _robot(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with served(tmp_path_factory.mktemp("robot"), backend=cls.backend) as robot:
            cls.robot = robot
            yield

    def make(self) -> LegServos:
        return ZenohServos(shipped(), link=Link(endpoint=self.robot.endpoint))


class TestServedMock(ServedConformance):
    backend = "mock"


class TestServedSimulation(ServedConformance):
    backend = "sim"


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


def connected(link: Link, robot: PlainRobot) -> ZenohServos:
    servos = ZenohServos(shipped(), link=link)

    threading.Timer(0.2, robot.say).start()
    servos.connect()
    return servos


def test_it_can_be_commanded(link: Link, robot: PlainRobot) -> None:
    with connected(link, robot) as servos:
        wanted = shipped().stance_angles_rad + 0.1
        servos.write(JointTargets(wanted, 0.0))
        wait_until(lambda: np.array_equal(robot.joint_positions_rad, wanted), "the command")
        servos.clock.tick()
        servos.clock.tick()
        np.testing.assert_array_equal(servos.read().joint_positions_rad, wanted)


def test_its_silence_stops_the_controller(link: Link, robot: PlainRobot) -> None:
    with Guard(connected(link, robot)) as guard:
        time.sleep(0.3)
        guard.clock.tick()
        guard.read()
        assert guard.stopped == "state"
        with pytest.raises(EStopError):
            guard.write(JointTargets(shipped().stance_angles_rad, guard.clock.now_s))


@pytest.mark.usefixtures("robot")
def test_without_the_word_plain_it_is_refused(link: Link) -> None:
    with pytest.raises(RobotFaultError, match="no robot called ant answers"):
        ZenohServos(shipped(), link=Link(endpoint=link.endpoint, names=NAMES)).connect()


def test_no_robot() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(RobotFaultError, match=endpoint):
        ZenohServos(shipped(), link=Link(endpoint=endpoint)).connect()
    commands = (("status",), ("estop",), ("run", "--backend", "zenoh", "--no-record"))
    with ThreadPoolExecutor() as together:
        for answer in together.map(lambda words: hexctl_process(*words, "--connect", endpoint), commands):
            assert answer.returncode == 3
            lines = answer.stderr.splitlines()
            assert all(line.startswith("hexctl: ") and endpoint in line for line in lines)
            # That nothing listens is said at once, and what became of it once it was tried long enough.
            assert len(lines) == (1 if "run" in answer.args else 2)


def test_another_robot_is_refused_and_the_message_says_where_it_differs(tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("mounts", 2, "azimuth_deg", 121))
    with served(tmp_path, backend="mock") as robot:
        link = Link(endpoint=robot.endpoint)
        with pytest.raises(RobotFaultError, match=r"another one: mount_positions_body\[2\]\[0\] is"):
            ZenohServos(load_robot(path), link=link).connect()
        with pytest.raises(
            RobotFaultError,
            match=r"no robot called pexod answers at .*; there is ant; allowed: robot ant, or its file",
        ):
            ZenohServos(shipped("pexod"), link=link).connect()


def test_a_neighbours_robot_is_commanded_only_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with served(tmp_path, backend="mock") as robot:
        by_default = Link(endpoint=robot.endpoint, named=False)
        with ZenohServos(shipped(), link=by_default) as servos:
            assert servos.identity is not None
            assert servos.identity.pid == robot.process.pid
        monkeypatch.setattr("hexctl.wire.description.user_name", lambda: "neighbour")
        with pytest.raises(InputError, match=f"name it: connect {robot.endpoint}"):
            ZenohServos(shipped(), link=by_default).connect()
        with ZenohServos(shipped(), link=Link(endpoint=robot.endpoint)):
            pass


def test_a_stop_by_another_client_is_reported_to_the_controller_as_a_stop(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot, Guard(servos_of(robot)) as guard:
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        for _ in range(100):
            guard.clock.tick()
            guard.read()
        assert guard.stopped == "estop"


def test_a_lease_that_is_lost_ends_the_controller(tmp_path: Path) -> None:
    """As when another client clears a stop, and so revokes the lease, before this end has received it."""
    with served(tmp_path, backend="mock") as robot, servos_of(robot) as servos:
        assert servos._lease is not None
        servos._lease._request("release")
        with pytest.raises(RobotFaultError, match="no longer commands the robot"):
            read_for(servos, seconds=10)


def servos_of(robot: Served) -> ZenohServos:
    return ZenohServos(shipped(), link=Link(endpoint=robot.endpoint))


def read_for(servos: ZenohServos, *, seconds: float) -> None:
    """Read at every tick for a while."""
    for _ in range(round(seconds / servos.clock.period_s)):
        servos.clock.tick()
        servos.read()


def test_what_servos_on_a_bus_report_comes_over_the_link(tmp_path: Path) -> None:
    with (
        bus_board(a_map(), "hot:2:femur:61", "mute:5:coxa@6") as bus,
        served(tmp_path, "--robot", "phantomx", "--connect", bus.path, backend="feetech") as server,
        ZenohServos("phantomx", link=Link(endpoint=server.endpoint)) as servos,
    ):
        wait_until(lambda: "mute: leg 5 coxa (id 13)" in _next(servos).warnings, "the warning")
        state = _next(servos)
        assert state.stale_joints is not None
        assert np.flatnonzero(state.stale_joints).tolist() == [12]
        readings = state.servos
        assert readings is not None
        assert readings.hottest_joint == 4
        assert readings.temperatures_c[4] == 61
        assert np.isfinite(readings.voltages_v).all()
        assert readings.ages_s[12] > 0.3
        assert np.delete(readings.ages_s, 12).max() < readings.ages_s[12]


def _next(servos: ZenohServos) -> RobotState:
    servos.clock.tick()
    return servos.read()


GRANTED = {"lease": "0f" * 16, "sequence": 3, "duration_s": 1}


def test_a_lease_is_read_and_one_that_cannot_be_held_is_refused() -> None:
    assert granted(GRANTED) == (b"\x0f" * 16, 3, 1.0)
    spoiled: dict[str, Any] = {"lease": "0f", "sequence": 1 << 32, "duration_s": 1e-9}
    for key, value in spoiled.items():
        others: tuple[Any, ...] = (value, None, True, [], "nan")
        for other in others:
            with pytest.raises(RobotFaultError, match="grants a lease that this hexctl does not understand"):
                granted({**GRANTED, key: other})
    with pytest.raises(RobotFaultError, match="same version"):
        granted({})
