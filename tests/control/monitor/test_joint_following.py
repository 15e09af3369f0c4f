"""Joints that do not follow, and whole ones under a load at which no servo follows."""

import numpy as np

from hexctl.control.monitor.joint_following import JointFollowing
from hexctl.control.monitor.phase_habit import cycle_parts
from hexctl.types import FloatArray, RobotState

TICKS_PER_CYCLE = 50


def _rho(off_rad: FloatArray, torques_nm: FloatArray, *, from_tick: int = 300) -> FloatArray:
    """Greatest rho of each joint from a tick on, (18,), of joints that are off by angles, (T, 18)."""
    following = JointFollowing((), 0.02, np.array(1 / TICKS_PER_CYCLE), np.full(18, 2.0))
    greatest = np.zeros(18)
    for tick in range(len(off_rad)):
        phases = (tick / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
        targets = 0.25 * min(1.0, tick / 100) * np.repeat(np.sin(2 * np.pi * phases), 3)
        state = RobotState(targets + off_rad[tick], 0.0, True, joint_torques_nm=torques_nm[tick])
        following.update(state, cycle_parts(phases))
        following.sent(targets, 0.0)
        if tick >= from_tick:
            greatest = np.maximum(greatest, following.rho)
    return greatest


def _legs_standing(ticks: int) -> FloatArray:
    phases = (np.arange(ticks)[:, np.newaxis] / TICKS_PER_CYCLE + np.arange(6) / 6) % 1
    return np.repeat((phases < 1 / 3) | (phases >= 2 / 3), 3, axis=1)


def test_a_joint_that_stays_behind_stands_out() -> None:
    off, torques = np.zeros((500, 18)), np.where(_legs_standing(500), 1.0, 0.2)
    off[300:, 7] = -0.3
    rho = _rho(off, torques)
    assert rho[7] > 0.8
    assert np.delete(rho, 7).max() < 0.1


def test_an_offset_from_the_start_is_usual() -> None:
    off = np.tile(np.radians(10.0) * np.ones(18), (500, 1))
    assert _rho(off, np.full((500, 18), 0.2), from_tick=0).max() < 0.3


def test_a_load_that_all_servos_give_in_to_is_no_failure() -> None:
    """The legs stand with all the torque they have; then one of them gives in."""
    ticks = 600
    standing = _legs_standing(ticks)
    torques = np.where(standing, 1.0, 0.2)
    off = np.zeros((ticks, 18))
    off[300:, 4] = np.where(standing[300:, 4], -0.3, 0.0)
    assert _rho(off, torques).max() < 0.15
    spared = np.where(standing, 0.4, 0.2)
    spared[:50] = 1.0
    assert _rho(off, spared)[4] > 0.3, "with torque to spare the same is one"


def test_a_jam_takes_more_than_other_servos_ever_gave() -> None:
    ticks = 600
    torques, off = np.where(_legs_standing(ticks), 1.0, 0.2), np.zeros((ticks, 18))
    off[300:, 4], torques[300:, 4] = -0.3, 1.6
    assert _rho(off, torques)[4] > 0.8


def test_robots_of_a_batch_get_to_know_their_servos_at_their_own_pace() -> None:
    """Servos that may give all they have, until it is known that others gave more."""
    cycles, limits, rng = np.array([1 / 50, 1 / 70]), np.full(18, 2.5), np.random.default_rng(0)
    together = JointFollowing((2,), 0.02, cycles, limits)
    alone = [JointFollowing((), 0.02, each, limits) for each in cycles]
    torques = np.full((2, 18), 1.2)
    torques[:, ::7] = 1.9
    for tick in range(200):
        parts = cycle_parts((tick * cycles[:, np.newaxis] + np.arange(6) / 6) % 1)
        measured, targets = 0.1 * rng.standard_normal((2, 2, 18))
        together.update(RobotState(measured, 0.0, True, joint_torques_nm=torques), parts)
        together.sent(targets, 0.0)
        for row, following in enumerate(alone):
            state = RobotState(measured[row], 0.0, True, joint_torques_nm=torques[row])
            following.update(state, parts[row])
            following.sent(targets[row], 0.0)
            assert (together.rho[row] == following.rho).all()


def test_a_joint_that_always_needs_all_its_servo_to_swing_may_get_caught_for_a_cycle() -> None:
    """Friction and a servo with a fifth of its torque: a foot that catches stays where it is for a while."""
    ticks = 1000
    standing = _legs_standing(ticks)
    torques, off = np.where(standing, 1.0, 0.2), np.zeros((ticks, 18))
    caught = slice(800, 800 + TICKS_PER_CYCLE)
    off[caught, 4], torques[caught, 4] = np.where(standing[caught, 4], 0.0, -0.3), 1.0
    assert _rho(off, torques)[4] > 0.5, "one that swung with ease before is jammed"
    torques[:, 4] = 1.0
    assert _rho(off, torques)[4] < 0.1
