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
    support, rng = LegSupport((), np.array(1 / TICKS_PER_CYCLE), np.ones(18)), np.random.default_rng(0)
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


def test_a_foot_on_the_floor_is_there_whatever_the_torques_say() -> None:
    """Torques that vanish while the foot touches as always: another part of the body carries for a while."""
    support, most = LegSupport((), np.array(1 / TICKS_PER_CYCLE), np.ones(18)), np.zeros(6)
    for tick in range(700):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        torques = np.repeat(np.where(contacts, 0.5, 0.0), 3)
        if tick >= 600:
            torques[:6], contacts[0] = 0.0, False
        state = RobotState(np.zeros(18), 0.0, True, None, None, contacts, joint_torques_nm=torques)
        support.update(state, cycle_parts(phases))
        most = np.maximum(most, support.missing) if tick > 600 else most
    assert most[0] > 0.95  # neither load nor contact
    assert 0.3 < most[1] < 0.6


def test_without_contacts_and_efforts_nothing_is_known() -> None:
    support = LegSupport((), np.array(0.02), np.ones(18))
    support.update(RobotState(np.zeros(18), 0.0, True), cycle_parts(np.zeros(6)))
    assert not support.known
    assert (support.missing == 0).all()


def test_a_tick_without_torques_is_no_tick_without_load() -> None:
    """Contacts are no torques: where these are missing for a while, what was learned of them is kept."""
    support, most = LegSupport((), np.float64(1 / TICKS_PER_CYCLE), np.ones(18)), 0.0  # type: ignore[arg-type]
    for tick in range(400):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        torques = np.repeat(np.where(contacts, 5.0, 0.0), 3)
        lost = 300 <= tick < 350
        state = RobotState(
            np.zeros(18), 0.0, True, None, None, contacts, joint_torques_nm=None if lost else torques
        )
        support.update(state, cycle_parts(phases))
        assert support.known == (not lost)
        most = max(most, float(support.missing.max())) if tick > 250 else most
    assert most < 0.5


def test_legs_miss_nothing_while_their_gait_changes() -> None:
    """Phases glide for 1.5 cycles, in which a leg that is whole may carry nothing for most of one."""
    support, most = LegSupport((), np.array(1 / TICKS_PER_CYCLE), np.ones(18)), np.zeros(6)
    every, none = np.ones(6, dtype=bool), np.zeros(1, dtype=bool)
    for tick in range(800):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        contacts = (phases < 1 / 3) | (phases >= 2 / 3)
        if tick == 500:
            support.forget(~none, every, every)
        contacts[1] &= not 550 <= tick < 590  # carries first, and then for the time of the change nothing
        contacts[4] &= tick < 660  # fails once the gait has changed
        support.update(RobotState(np.zeros(18), 0.0, True, None, None, contacts), cycle_parts(phases))
        most = np.maximum(most, support.missing) if tick > 500 else most
    assert most[4] > 0.95
    assert np.delete(most, 4).max() < 0.5
