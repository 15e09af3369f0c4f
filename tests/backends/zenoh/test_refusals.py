"""What a controller refuses, and what it says: nobody there, another robot, a robot that is not free."""

from pathlib import Path

import pytest

from hexctl.backends.zenoh.servos import ZenohServos
from hexctl.control.guard import Guard
from hexctl.errors import RobotFaultError
from hexctl.robot.loader import load_robot
from hexctl.wire.link import Link
from tests.robots import edited_file, put, shipped
from tests.serve.processes import Served, free_port, hexctl, served


def test_nobody_there() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(RobotFaultError, match=endpoint):
        ZenohServos(shipped(), link=Link(endpoint=endpoint)).connect()
    for command in (("status",), ("estop",), ("run", "--backend", "zenoh", "--no-record")):
        answer = hexctl(*command, "--connect", endpoint)
        assert answer.returncode == 3
        assert answer.stderr.startswith("hexctl: ")
        assert len(answer.stderr.splitlines()) == 1


def test_another_robot_is_refused_and_the_message_says_where_it_differs(tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("mounts", 2, "azimuth_deg", 121))
    with served(tmp_path, backend="mock") as robot:
        link = Link(endpoint=robot.endpoint)
        with pytest.raises(RobotFaultError, match=r"another one: mount_positions_body\[2\]\[0\] is"):
            ZenohServos(load_robot(path), link=link).connect()
        with pytest.raises(RobotFaultError, match="no robot called pexod answers"):
            ZenohServos(shipped("pexod"), link=link).connect()


def test_a_stop_by_somebody_else_is_told_to_the_controller_as_a_stop(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot, Guard(servos_of(robot)) as guard:
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        for _ in range(100):
            guard.clock.tick()
            guard.read()
        assert guard.stopped == "estop"


def test_a_lease_that_is_lost_ends_the_controller(tmp_path: Path) -> None:
    """As when somebody clears a stop, and with it takes the lease away, before this end has seen it."""
    with served(tmp_path, backend="mock") as robot, servos_of(robot) as servos:
        assert hexctl("estop", "--clear", "--connect", robot.endpoint).returncode == 0
        with pytest.raises(RobotFaultError, match="no longer ours"):
            read_for(servos, seconds=10)


def servos_of(robot: Served) -> ZenohServos:
    return ZenohServos(shipped(), link=Link(endpoint=robot.endpoint))


def read_for(servos: ZenohServos, *, seconds: float) -> None:
    """Read at every tick for a while."""
    for _ in range(round(seconds / servos.clock.period_s)):
        servos.clock.tick()
        servos.read()
