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

#: Motion of the body in a tick, in its own frame, and its yaw relative to the line.
STEP_M, OFF_RAD = np.array([1e-3, 2.5e-4, 0.0]), 0.3

ACROSS_M = BLOCK_TICKS * (np.sin(OFF_RAD) * STEP_M[0] + np.cos(OFF_RAD) * STEP_M[1])


def reckoned(
    reckoning: DeadReckoning,
    contacts: BoolArray | None,
    *,
    measured: bool = True,
    ticks: int = BLOCK_TICKS + 3,
) -> FloatArray:
    """The deviation after a block, over which the body moves and its standing feet stay."""
    for tick in range(ticks):
        feet_body = ROBOT.stance_feet_body - (tick - BLOCK_TICKS / 2) * STEP_M
        joints_rad = solve_legs(ROBOT, feet_body).joint_positions_rad
        state = RobotState(joints_rad, 0.0, measured, foot_contacts=contacts)
        deviation_m = reckoning.update(state, np.float64(OFF_RAD))  # type: ignore[arg-type]
    return deviation_m


def test_a_body_that_moves_over_its_feet_is_off_by_its_motion_across_the_line() -> None:
    reckoning, standing = DeadReckoning(ROBOT, (), 0.02), np.array([True, False, True, True, True, False])
    assert reckoned(reckoning, standing, ticks=BLOCK_TICKS + 2) == 0.0, "a block counts when it is complete"
    reckoning.restart()
    assert reckoned(reckoning, standing) == pytest.approx(ACROSS_M, rel=1e-6)
    reckoning.restart()
    assert reckoned(reckoning, standing) == pytest.approx(ACROSS_M, rel=1e-6)


def test_without_contacts_or_measured_angles_it_is_unknown() -> None:
    reckoning, standing = DeadReckoning(ROBOT, (), 0.02), np.ones(6, dtype=bool)
    assert np.isnan(reckoned(reckoning, None))
    assert np.isnan(reckoned(reckoning, standing, measured=False))
    assert reckoned(reckoning, standing) == pytest.approx(ACROSS_M, rel=1e-6)
