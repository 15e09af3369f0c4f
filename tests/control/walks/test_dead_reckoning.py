"""Dead reckoning of a made-up body whose feet stay on the floor."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl import RobotState
from hexctl.control.walks.dead_reckoning import BLOCK_TICKS, DeadReckoning
from hexctl.ik.legs import solve_legs
from hexctl.types import BoolArray, FloatArray
from tests.robots import shipped

ROBOT = replace(shipped(), foot_radius_m=1e-9)

STANDING = np.array([True, False, True, True, True, False])

#: Motion of the body in a tick, in its own frame, and its yaw relative to the line.
STEP_M, OFF_RAD = np.array([1e-3, 2.5e-4, 0.0]), 0.3

ACROSS_M = BLOCK_TICKS * (np.sin(OFF_RAD) * STEP_M[0] + np.cos(OFF_RAD) * STEP_M[1])


def reckoned(
    reckoning: DeadReckoning,
    contacts: BoolArray | None = STANDING,
    *,
    measured: bool = True,
    lifted: int = BLOCK_TICKS // 2,
    first: int = 0,
    ticks: int = BLOCK_TICKS + 3,
) -> FloatArray:
    """The deviation after a block, in which the body moves and its feet stay, but for one that lifts."""
    for tick in range(first, first + ticks):
        feet_body = ROBOT.stance_feet_body - (tick - BLOCK_TICKS / 2) * STEP_M
        joints_rad = solve_legs(ROBOT, feet_body).joint_positions_rad
        touching = None if contacts is None else contacts & (np.arange(6) != 0 if tick >= lifted else True)
        state = RobotState(joints_rad, 0.0, measured, foot_contacts=touching)
        deviation_m = reckoning.update(state, np.float64(OFF_RAD))  # type: ignore[arg-type]
    return deviation_m


def test_a_body_that_moves_over_its_feet_is_off_by_its_motion_across_the_line() -> None:
    reckoning = DeadReckoning(ROBOT, (), 0.02)
    assert reckoned(reckoning, ticks=BLOCK_TICKS + 2) == 0.0, "a block counts when it is complete"
    reckoning.restart()
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)
    reckoning.restart()
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)


def test_without_contacts_or_measured_angles_it_is_unknown() -> None:
    reckoning = DeadReckoning(ROBOT, (), 0.02)
    assert np.isnan(reckoned(reckoning, None))
    assert np.isnan(reckoned(reckoning, measured=False))
    assert reckoned(reckoning) == pytest.approx(ACROSS_M, rel=1e-6)


def test_contacts_that_never_change_are_not_believed() -> None:
    for contacts in (np.zeros(6, dtype=bool), STANDING):
        assert reckoned(DeadReckoning(ROBOT, (), 0.02), contacts, lifted=BLOCK_TICKS + 3) == 0.0
