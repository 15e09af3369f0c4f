"""Postures between two messages, and robots that tell theirs."""

import math
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import RobotFaultError
from hexctl.types import FloatArray
from hexctl.vision.twin import posture_history
from hexctl.vision.twin.posture_history import KEPT, PostureHistory, followed_robot
from hexctl.wire.links import Link
from tests.server.processes import free_port, served

pytestmark = pytest.mark.realtime

JOINTS = np.arange(18.0)


def turned(yaw_rad: float) -> FloatArray:
    return np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)])


def test_between_two_states_it_is_between_them() -> None:
    history = PostureHistory()
    history.add_joints(1.0, JOINTS)
    history.add_joints(1.02, JOINTS + 0.2)
    history.add_truth(1.0, np.array([0.0, 1.0, 0.1]), turned(0.1))
    history.add_truth(1.02, np.array([0.1, 1.0, 0.1]), -turned(0.2))  # the same orientation as turned(0.2)
    posture = history.at(1.005)
    assert posture is not None
    assert posture.position_floor == pytest.approx([0.025, 1.0, 0.1])
    assert posture.quaternion_floor == pytest.approx(turned(0.125), abs=1e-5)
    assert posture.joint_positions_rad == pytest.approx(JOINTS + 0.05)


def test_before_and_after_all_states_it_is_the_nearest() -> None:
    history = PostureHistory()
    for number in range(KEPT + 50):
        history.add_joints(number / 50, JOINTS)
        history.add_truth(number / 50, np.array([number, 0.0, 0.1]), turned(0))
    early, late = history.at(0.0), history.at(1e6)
    assert early is not None
    assert late is not None
    assert (early.position_floor[0], late.position_floor[0]) == (50, KEPT + 49)
    assert history.newest_at_s == (KEPT + 49) / 50


def test_without_both_joints_and_truth_there_is_no_posture() -> None:
    history = PostureHistory()
    history.add_truth(1.0, np.zeros(3), turned(0))
    assert history.at(1.0) is None
    assert history.newest_at_s is None
    history.add_joints(1.1, JOINTS)
    assert history.at(1.0) is not None


def test_a_robot_that_is_not_simulated_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posture_history, "FIRST_TRUTH_S", 0.5)
    with (
        served(tmp_path, backend="mock") as robot,
        pytest.raises(RobotFaultError, match=r"ant at .* does not tell where it truly is"),
        followed_robot(Link(endpoint=robot.endpoint)),
    ):
        pass


def test_where_no_robot_is_it_is_said() -> None:
    with (
        pytest.raises(RobotFaultError, match="nothing listens"),
        followed_robot(Link(endpoint=f"tcp/127.0.0.1:{free_port()}")),
    ):
        pass
