"""The decentralised rule: what loads do to phases, and a walk by it."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.study.recovery.decentralised import LegLoads, phase_rate
from hexctl.study.recovery.episodes import RecoveryCase
from hexctl.types import RobotState
from tests.robots import ROBOT_NAMES, shipped
from tests.study.recovery.made_up import plan

#: Times of the cycle: late and early in the stance, and the two ends of the swing.
LATE, EARLY = 0.25, 0.75


def test_a_leg_waits_under_its_own_load_and_hurries_once_its_neighbours_carry() -> None:
    u = np.full(6, LATE)
    nothing, own, beside = np.zeros(6), np.eye(6)[2], np.eye(6)[1] + np.eye(6)[3]
    assert phase_rate(u, nothing).tolist() == [1.0] * 6
    assert phase_rate(u, own)[2] < 1 < phase_rate(u, beside)[2]
    assert phase_rate(np.full(6, EARLY), own)[2] > 1 > phase_rate(np.full(6, EARLY), beside)[2]
    assert phase_rate(u, 100 * own).min() == 0, "no phase goes back"
    several = phase_rate(np.stack([u, u]), np.stack([own, beside]))
    assert np.array_equal(several, [phase_rate(u, own), phase_rate(u, beside)])


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_loads_are_read_from_torques_else_from_contacts(name: str) -> None:
    robot = shipped(name)
    state = RobotState(robot.stance_angles_rad, 0.0, True)
    loads = LegLoads(robot)
    assert loads.of(state) is None
    contacts = np.array([True, False] * 3)
    (touching,) = [loads.of(replace(state, foot_contacts=contacts))]
    assert touching is not None
    assert touching.tolist() == [1, 0] * 3
    torques_nm = np.zeros(18)
    torques_nm[4], torques_nm[7] = -1.0, 1.0  # the femur of leg 2 holds the body up, that of leg 3 does not
    read = loads.of(replace(state, joint_torques_nm=torques_nm, foot_contacts=contacts))
    assert read is not None
    assert read[1] > 0
    assert np.count_nonzero(read) == 1


@pytest.mark.slow
def test_a_walk_by_it_goes_on_without_a_leg_and_is_in_a_batch_as_alone() -> None:
    place = replace(plan().walked()[0][0], duration_s=6.0)
    cases = [
        RecoveryCase(
            gait="tripod",
            legs=legs,
            failure="limp" if legs else "intact",
            at_s=2.5,
            heading_deg=0.0,
            method="decentralised",
        )
        for legs in ((), (2,), (3,), (5,))
    ]
    together = place.walk(cases)
    assert {one.status for one in together} == {"ok"}
    assert {one.alarms for one in together} == {()}
    assert repr(place.walk(cases[1:2])) == repr(together[1:2])
    left = place.walk([replace(case, method="nothing") for case in cases[1:]])
    assert np.mean([one.last_m_s for one in together[1:]]) > np.mean([one.last_m_s for one in left])
