"""What a controller refuses, and what it says: nobody there, another robot, a robot that is not free."""

from pathlib import Path

import pytest

from hexctl.backends.zenoh.servos import ZenohServos
from hexctl.errors import RobotFaultError
from hexctl.robot.file import load_robot
from hexctl.wire.link import Link
from tests.robots import edited_file, put, shipped
from tests.serve.processes import free_port, hexctl, served


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


def test_a_lease_that_is_taken_away_ends_the_controller(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot:
        servos = ZenohServos(shipped(), link=Link(endpoint=robot.endpoint))
        with servos:
            assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
            with pytest.raises(RobotFaultError, match="no longer ours"):
                read_for(servos, seconds=10)


def read_for(servos: ZenohServos, *, seconds: float) -> None:
    """Read at every tick for a while."""
    for _ in range(round(seconds / servos.clock.period_s)):
        servos.clock.tick()
        assert servos.read().stopped in (None, "estop")
