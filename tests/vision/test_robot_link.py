"""The robot at the other end of a link, served in real time."""

from collections.abc import Iterator

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.robot_link import LegState, robot_link
from hexctl.waiting import wait_for
from hexctl.wire.links import Link
from tests.server.processes import Served, served


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("robot"), backend="sim") as running:
        yield running


@pytest.mark.realtime
def test_states_come_once_in_their_order(robot: Served) -> None:
    states: list[LegState] = []
    with robot_link(Link(endpoint=robot.endpoint), "ant") as end:

        def many() -> bool:
            states.extend(end.states())
            return len(states) > 100

        wait_for(many, 30, "no states came")
    times_s = np.array([state.at_s for state in states])
    assert (np.diff(times_s) > 0).mean() > 0.95
    assert np.diff(times_s).mean() > 0.016  # a tick takes 0.02 s, more on a busy machine
    assert states[-1].joint_positions_rad.shape == (18,)
    assert states[-1].yaw_rad is not None  # a simulated robot has an orientation of its own


@pytest.mark.realtime
def test_the_robot_takes_the_pose_for_its_own(robot: Served) -> None:
    with robot_link(Link(endpoint=robot.endpoint)) as end:

        def taken() -> bool:
            end.publish(PlanarPose(1.5, -0.5, 0.7), 0.12, position_variance_m2=1e-4, yaw_variance_rad2=1e-4)
            status = robot.status()
            return bool(status["pose"] and status["malformed"]["poses"] == 0)

        wait_for(taken, 30, "the pose was never taken")


@pytest.mark.realtime
def test_another_name_than_that_of_the_robot_there_is_told(robot: Served) -> None:
    with (
        pytest.raises(InputError, match="robot"),
        robot_link(Link(endpoint=robot.endpoint), "pexod"),
    ):
        pass
