"""Springs between targets and angles: a servo with part of its torque is a softer spring."""

import numpy as np
import pytest

from hexctl.control.monitor.joint_stiffness import BLOCK_TICKS, JointStiffness
from hexctl.control.monitor.recent_motion import RecentMotion
from hexctl.types import FloatArray

TICKS_PER_CYCLE, WEAKENS, WALKED = 55, 8 * 55, 10 * 55
HURRIES = 3 * TICKS_PER_CYCLE
LIMITS_NM, STIFFNESS = np.full(18, 2.0), 20.0


def _walk(
    joint: int,
    share: float,
    weakens: int = WEAKENS,
    limit_nm: float = 2.0,
    shape: tuple[int, ...] = (),
    turns: int = WALKED,
    haste: float = 1.0,
) -> list[tuple[int, int, float]]:
    """Joints found weak: tick, joint and share of the first robot; others of a batch stay intact.

    Joints move backwards from the tick `turns` on, and at a multiple of their pace from `HURRIES` on.
    """
    random, joints = np.random.default_rng(2), (*shape, 18)
    motion = RecentMotion(shape, np.full(shape, 1 / TICKS_PER_CYCLE))
    stiffness = JointStiffness(shape, LIMITS_NM)
    phases, sent, found = random.uniform(0, 6, 18), np.zeros((4, 18)), []
    for tick in range(WALKED):
        ticks = turns - abs(tick - turns) + (haste - 1) * max(0, tick - HURRIES)
        cycle = 2 * np.pi * ticks / TICKS_PER_CYCLE + phases
        if tick == HURRIES:
            motion.cycles = motion.cycles * haste
        load_nm = 0.5 * (np.sin(cycle + 1) + 0.5 * np.sin(3 * cycle)) ** 3
        shares: FloatArray = np.ones(joints)
        shares[(*[0] * len(shape), joint)] = share if tick >= weakens else 1.0
        off_rad = load_nm / (STIFFNESS * shares) + random.normal(scale=np.radians(0.05), size=18)
        torques_nm = np.clip(load_nm, -limit_nm, limit_nm)
        motion.measured(sent[-2] - off_rad, np.broadcast_to(torques_nm, joints))
        if (tick + 1) % BLOCK_TICKS == 0:
            stiffness.update(motion, 0, np.ones((*shape, 6), dtype=bool))
            places = map(tuple, np.argwhere(stiffness.new))
            found += [(tick, int(place[-1]), float(stiffness.share[place])) for place in places]
        sent = np.concatenate([sent[1:], 0.25 * np.sin(cycle)[np.newaxis]])
        motion.sent(np.broadcast_to(sent[-1], joints))
    return found


@pytest.mark.parametrize(("joint", "share"), [(3, 0.5), (10, 0.3), (17, 0.6)])
def test_a_joint_that_weakens_is_named_with_its_share_within_two_cycles(joint: int, share: float) -> None:
    [(tick, found, measured)] = _walk(joint, share)
    assert found == joint
    assert 0 < tick - WEAKENS <= 2 * TICKS_PER_CYCLE
    assert measured == pytest.approx(share, abs=0.1)


@pytest.mark.parametrize("haste", [1.1, 1.25, 1.5])
def test_a_joint_that_weakens_is_named_at_a_higher_pace(haste: float) -> None:
    [(_, found, measured)] = _walk(10, 0.5, haste=haste)
    assert found == 10
    assert measured == pytest.approx(0.5, abs=0.1)
    assert not _walk(10, 1.0, haste=haste)


def test_a_joint_weak_from_the_first_step_is_compared_with_other_legs() -> None:
    [(_, found, measured)] = _walk(4, 0.3, weakens=0)
    assert found == 4
    assert measured == pytest.approx(0.3, abs=0.1)


def test_joints_that_differ_by_less_than_servos_do_are_left_alone() -> None:
    assert not _walk(4, 0.9) + _walk(4, 0.7, weakens=0)


def test_servos_at_their_limits_are_not_weak() -> None:
    """Overloaded, the distance from the target grows with no torque to show for it."""
    assert not _walk(4, 1.0, limit_nm=0.2)


def test_another_motion_is_learned_before_it_is_judged() -> None:
    assert not _walk(3, 0.5, turns=WEAKENS)


def test_a_robot_of_a_batch_is_judged_as_alone() -> None:
    assert _walk(10, 0.5, shape=(2,)) == _walk(10, 0.5)
