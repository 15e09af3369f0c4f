"""The standing test: within the joints' limits on every robot, and stopped where it is not safe."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.control.diagnosis.standing_test import ALL_PROBES, LIFTS, StandingTest, probe_targets_rad
from hexctl.errors import LimitError
from hexctl.ik.legs import range_excess_rad
from hexctl.robot.loader import load_robot
from hexctl.types import RobotState

PERIOD_S = 0.02


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_every_probe_keeps_within_ranges_and_speeds_and_ends_in_the_stance(name: str) -> None:
    robot = load_robot(name)
    for probe in ALL_PROBES:
        targets = probe_targets_rad(robot, probe, PERIOD_S)
        whole = np.vstack([robot.stance_angles_rad, targets])
        assert range_excess_rad(robot, targets).max() <= 0
        assert (np.abs(np.diff(whole, axis=0)) <= robot.joint_max_speed_rad_s * PERIOD_S).all()
        np.testing.assert_allclose(targets[-1], robot.stance_angles_rad, atol=1e-9)


@pytest.mark.parametrize("name", ["ant", "phantomx", "pexod"])
def test_a_lift_moves_each_joint_of_its_leg_enough_to_be_seen(name: str) -> None:
    robot = load_robot(name)
    for probe in LIFTS:
        targets = probe_targets_rad(robot, probe, PERIOD_S).reshape(-1, 6, 3)[:, probe.legs[0] - 1]
        assert (np.degrees(np.ptp(targets, axis=0)) > 10).all()


def test_the_whole_test_takes_less_than_twelve_seconds() -> None:
    assert sum(probe.duration_s for probe in ALL_PROBES) < 12


def test_a_robot_without_room_around_its_stance_is_refused() -> None:
    robot = load_robot("ant")
    angles = robot.stance_angles_rad
    tight = replace(robot, joint_lower_rad=angles - 1e-4, joint_upper_rad=angles + 1e-4)
    with pytest.raises(LimitError, match="room"):
        StandingTest(tight, PERIOD_S)


def _state(tilt_rad: float, contacts: list[bool]) -> RobotState:
    robot = load_robot("ant")
    return RobotState(
        robot.stance_angles_rad,
        0.0,
        True,
        base_quaternion_world=np.array([np.cos(tilt_rad / 2), np.sin(tilt_rad / 2), 0, 0]),
        foot_contacts=np.array(contacts),
    )


def _leg_height(targets_rad: np.ndarray, leg: int) -> float:
    return float(targets_rad[3 * leg - 2] - load_robot("ant").stance_angles_rad[3 * leg - 2])


def test_a_lean_puts_the_leg_down_at_once_and_the_next_one_follows() -> None:
    test = StandingTest(load_robot("ant"), PERIOD_S)
    level, leaning = _state(0.0, [True] * 6), _state(np.radians(15), [True] * 6)
    for step in range(20):
        raised = test.targets_rad(step, level)
    first = test.observed.sections[0]
    assert _leg_height(raised, first.probe.legs[0]) > 0.1
    lowered = test.targets_rad(20, leaning)
    assert _leg_height(lowered, first.probe.legs[0]) < _leg_height(raised, first.probe.legs[0])
    assert first.stopped is not None
    assert "15 degrees" in first.stopped
    for step in range(21, 42):
        test.targets_rad(step, level)
    second = test.observed.sections[1]
    assert second.probe == LIFTS[1]
    assert second.stopped is None


def test_lost_contacts_of_the_other_feet_stop_a_lift_where_the_body_leans_a_little() -> None:
    test = StandingTest(load_robot("ant"), PERIOD_S)
    test.targets_rad(0, _state(0.0, [True] * 6))
    for step in range(1, 12):
        test.targets_rad(step, _state(np.radians(6), [False, True, True, False, False, False]))
    assert test.observed.sections[0].stopped == "fewer than 3 other feet had contact"


def test_lost_contacts_alone_stop_a_lift_where_no_lean_is_known() -> None:
    test = StandingTest(load_robot("ant"), PERIOD_S)
    for step in range(12):
        state = _state(0.0, [True, True, False, False, False, False])
        test.targets_rad(step, replace(state, base_quaternion_world=None))
    assert test.observed.sections[0].stopped == "fewer than 3 other feet had contact"


@pytest.mark.slow
def test_a_leg_that_cannot_bear_carries_no_tripod() -> None:
    robot = load_robot("ant")
    test = StandingTest(robot, PERIOD_S, probes=ALL_PROBES[-2:], unsafe=lambda _: {2: "leg 2 limp"})
    step = 0
    while True:
        test.targets_rad(step, _state(0.0, [True] * 6))
        if test.done(step, _state(0.0, [True] * 6)):
            break
        step += 1
    assert [section.left_out for section in test.observed.sections] == [None, "leg 2 limp"]
