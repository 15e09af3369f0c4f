"""A tucked leg is moved now and then; it is whole once its joints follow."""

import numpy as np
import pytest

from hexctl.control.monitor.leg_probe import FIRST_CYCLES, LATER, LegProbe

CYCLE = 50.0


def _tries(gains: tuple[float, float, float], *, moves: bool = True, steps: int = 1200) -> list[int]:
    """Steps at which a leg counts as whole whose joints make a part of what they are asked for."""
    probe, whole, lagged = LegProbe(100, CYCLE, moves=moves), [], np.zeros(3)
    for step in range(100, 100 + steps):
        targets = probe.offset_m(step, 1.0) * np.array([5.0, 5.0, 8.0])
        lagged += 0.5 * (targets - lagged)
        if probe.whole(step, targets, np.array(gains) * lagged + 0.002):
            whole.append(step)
    return whole


def test_joints_that_follow_prove_it_at_the_first_try() -> None:
    assert _tries((0.95, 1.0, 0.9))[0] == pytest.approx(100 + (FIRST_CYCLES + 1) * CYCLE, abs=2)


@pytest.mark.parametrize("gains", [(0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.3, 1.0), (-1.0, 1.0, 1.0)])
def test_one_joint_that_does_not_is_enough(gains: tuple[float, float, float]) -> None:
    assert _tries(gains) == []


def test_a_leg_whose_joints_cannot_tell_is_put_down_when_it_is_time() -> None:
    first, second = _tries((1.0, 1.0, 1.0), moves=False, steps=900)[:2]
    assert first == 100 + FIRST_CYCLES * CYCLE
    assert second == pytest.approx(first + LATER * FIRST_CYCLES * CYCLE, abs=2)


def test_between_tries_the_foot_stays() -> None:
    probe = LegProbe(0, CYCLE, moves=True)
    moved = [bool(probe.offset_m(step, 1.0).any()) for step in range(int((FIRST_CYCLES + 1) * CYCLE))]
    assert not any(moved[: int(FIRST_CYCLES * CYCLE)])
    assert sum(moved) > 0.9 * CYCLE
    assert max(abs(probe.offset_m(step, 2.0)).max() for step in range(400)) <= 0.06 + 1e-9
