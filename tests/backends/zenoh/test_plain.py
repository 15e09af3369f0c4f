"""A robot that speaks the ROS 2 messages under names of its own, and nothing else of hexctl's."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hexctl.backends.zenoh.servos import ZenohServos
from hexctl.control.guard import Guard
from hexctl.errors import EStopError, RobotFaultError
from hexctl.types import JointTargets
from hexctl.wire.command import decode_positions, encode_positions
from hexctl.wire.keys import KeyMap
from hexctl.wire.link import Link
from hexctl.wire.role import Role
from hexctl.wire.session import open_session
from tests.robots import shipped
from tests.serve.processes import free_port, wait_until

NAMES = {"command": "robot7/joint_commands", "joint_states": "robot7/joint_states"}


class PlainRobot:
    """Echoes the joint angles it is sent, without tags, description or lease."""

    def __init__(self, link: Link) -> None:
        self.session = open_session(link, Role.ROBOT, KeyMap.of("ant").renamed(NAMES))
        self.positions_rad = shipped().stance_angles_rad
        self.session.declare_subscriber(NAMES["command"], self._obey)

    def _obey(self, sample: Any) -> None:
        self.positions_rad = decode_positions(bytes(sample.payload))
        self.say()

    def say(self) -> None:
        """Publish a state."""
        self.session.put(NAMES["joint_states"], encode_positions(self.positions_rad))


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
        wait_until(lambda: np.array_equal(robot.positions_rad, wanted), "the command")
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
