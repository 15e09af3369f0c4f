"""Kinds of failure, told from joints that move, or do not, as a test says."""

import numpy as np
import pytest

from hexctl.control.monitor.recent_motion import STILL_CYCLES, LegMotion, RecentMotion, failure_shown

TICKS_PER_CYCLE = 50
NONE_NM = np.full(3, 0.005)


def _motion(gains: tuple[float, float, float], torques_nm: tuple[float, float, float] | None) -> LegMotion:
    """Leg 3 of a robot whose targets go over half a sine, which its joints follow with gains."""
    recent = RecentMotion((), np.asarray(1 / TICKS_PER_CYCLE))
    targets = np.zeros(18)
    torques = None if torques_nm is None else np.tile(torques_nm, 6)
    for tick in range(3 * TICKS_PER_CYCLE):
        recent.measured(np.tile(gains, 6) * targets, torques)
        targets = np.full(18, np.radians(20) * np.sin(2 * np.pi * (tick + 13) / TICKS_PER_CYCLE))
        recent.sent(targets)
    recent.measured(np.tile(gains, 6) * targets, torques)
    return recent.of_leg(3)


def test_the_motion_of_a_leg_has_the_targets_from_before_it_was_measured() -> None:
    motion = _motion((1, 1, 1), None)
    assert motion.measured_rad.shape == (round(STILL_CYCLES * TICKS_PER_CYCLE), 3)
    assert motion.measured_rad == pytest.approx(motion.targets_rad)


@pytest.mark.parametrize(
    ("gains", "torques_nm", "follows", "kind", "joint"),
    [
        ((1, 1, 1), (0.0, 0.0, 0.0), True, "missing", None),
        ((1, 1, 1), None, True, "missing", None),
        ((0, 0, 0), (0.5, 0.5, 0.5), False, "locked", None),
        ((0, 0, 0), None, False, "locked", None),
        ((-0.5, -0.5, -0.5), (0.0, 0.0, 0.0), False, "limp", None),
        ((1, 0, 1), (0.5, 0.5, 0.5), False, "stuck", "femur"),
        ((1, 0, 1), None, False, "stuck", "femur"),
        ((1, 1, -0.5), (0.5, 0.5, 0.0), False, "limp", "tibia"),
        ((-0.5, 1, 1), None, False, "limp", "coxa"),
    ],
)
def test_the_kind_of_a_failure(
    gains: tuple[float, float, float],
    torques_nm: tuple[float, float, float] | None,
    follows: bool,
    kind: str,
    joint: str | None,
) -> None:
    rho = 1 - np.array(gains)
    found = failure_shown(3, _motion(gains, torques_nm), rho, follows=follows, none_nm=NONE_NM)
    assert (found.leg, found.kind, found.joint) == (3, kind, joint)


def test_a_leg_that_has_power_is_not_limp() -> None:
    """Later on a leg in the air needs no torque, which then says nothing."""
    motion, rho = _motion((0, 0, 0), (0.0, 0.0, 0.0)), np.ones(3)
    found = failure_shown(3, motion, rho, follows=False, none_nm=NONE_NM, powered=True)
    assert found.kind == "locked"
