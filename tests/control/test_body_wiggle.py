import numpy as np
import pytest

from hexctl.control.body_wiggle import (
    AMPLITUDE_RAD,
    DURATION_S,
    BodyWiggle,
    wiggle_targets_rad,
    wiggle_yaw_rad,
)
from hexctl.errors import InputError, LimitError, ReachError
from hexctl.ik.leg_odometry import leg_motions
from hexctl.ik.legs import foot_positions_body
from hexctl.types import RobotState
from tests.robots import ROBOT_NAMES, VENDORS_ROBOTS, shipped

TIMES_S = np.linspace(0, DURATION_S, 201)


def test_it_begins_and_ends_softly() -> None:
    yaw = wiggle_yaw_rad(TIMES_S)
    rate = np.gradient(yaw, TIMES_S)
    assert yaw[[0, -1]] == pytest.approx([0, 0])
    assert np.abs(rate[[0, -1]]).max() < 0.02
    assert AMPLITUDE_RAD * 0.95 < yaw.max() <= AMPLITUDE_RAD
    assert -AMPLITUDE_RAD <= yaw.min() < -AMPLITUDE_RAD * 0.95
    assert wiggle_yaw_rad(np.array([-1.0, 99.0])) == pytest.approx([0, 0])


@pytest.mark.parametrize("name", [*ROBOT_NAMES, *VENDORS_ROBOTS])
def test_every_shipped_robot_can_do_it_within_its_limits(name: str) -> None:
    robot = shipped(name)
    targets = wiggle_targets_rad(robot, TIMES_S)
    speeds = np.abs(np.diff(targets, axis=0)) / (TIMES_S[1] - TIMES_S[0])
    assert (speeds < robot.joint_max_speed_rad_s / 2).all()
    assert targets[[0, -1]] == pytest.approx(np.tile(robot.stance_angles_rad, (2, 1)), abs=1e-6)


def test_the_feet_stay_and_the_body_turns() -> None:
    robot = shipped()
    targets = wiggle_targets_rad(robot, TIMES_S)
    yaw = wiggle_yaw_rad(TIMES_S)
    feet = foot_positions_body(robot, targets)
    on_floor = (feet[..., 0] + 1j * feet[..., 1]) * np.exp(1j * yaw)[:, np.newaxis]
    assert np.abs(on_floor - on_floor[0]).max() < 1e-9
    assert np.abs(feet[..., 2] - feet[0, :, 2]).max() < 1e-9
    moved = leg_motions(robot, TIMES_S, targets).motions
    assert np.cumsum(moved[:, 2]) == pytest.approx(yaw[1:], abs=1e-3)


def test_as_a_controller_it_ends_where_it_began() -> None:
    robot = shipped()
    wiggle = BodyWiggle(robot, period_s=0.02)
    state = RobotState(robot.stance_angles_rad, 0.0, measured=True)
    assert not wiggle.done(199, state)
    assert wiggle.done(200, state)
    for step in (0, 200, 999):
        assert wiggle.targets_rad(step, state) == pytest.approx(robot.stance_angles_rad, abs=1e-6)


def test_a_twist_that_the_legs_cannot_make_is_refused() -> None:
    with pytest.raises((LimitError, ReachError), match="leg"):
        BodyWiggle(shipped(), period_s=0.02, amplitude_rad=1.5)
    with pytest.raises(InputError, match="one twist"):
        BodyWiggle(shipped(), period_s=0.02, duration_s=1.0)
