"""Legs that no longer carry."""

import numpy as np
import pytest

from hexctl.control.monitor.leg_support import LegSupport
from hexctl.control.monitor.phase_habit import cycle_parts
from hexctl.types import RobotState

TICKS_PER_CYCLE = 50


@pytest.mark.parametrize("efforts", [True, False])
@pytest.mark.parametrize("reliable", [1.0, 0.8])
def test_a_leg_that_carries_nothing_misses_all_of_its_load(efforts: bool, reliable: float) -> None:
    support, rng = LegSupport((), np.array(1 / TICKS_PER_CYCLE)), np.random.default_rng(0)
    most = np.zeros(6)
    for tick in range(700):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        contacts = ((phases < 1 / 3) | (phases >= 2 / 3)) & (rng.random(6) < reliable)
        if tick >= 600:
            most = np.maximum(most, support.missing) if tick > 600 else most
            contacts[3] = False
        torques = np.repeat(np.where(contacts, 0.5, 0.0), 3)
        state = RobotState(
            np.zeros(18), 0.0, True, None, None, contacts, joint_torques_nm=torques if efforts else None
        )
        support.update(state, cycle_parts(phases))
    assert support.known
    assert most[3] > 0.95
    assert np.delete(most, 3).max() < 0.7


def test_without_contacts_and_efforts_nothing_is_known() -> None:
    support = LegSupport((), np.array(0.02))
    support.update(RobotState(np.zeros(18), 0.0, True), cycle_parts(np.zeros(6)))
    assert not support.known
    assert (support.missing == 0).all()
