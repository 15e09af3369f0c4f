"""The picture of a failure in mid-walk."""

import numpy as np
import pytest

from hexctl.control.monitor.recovery import GlideToStableGait, WalkOn
from pictures.failure_strip import FAILS_S, FailedWalk, walk


@pytest.fixture(scope="module")
def walks() -> tuple[FailedWalk, FailedWalk]:
    return walk("walks on", WalkOn), walk("recovers", GlideToStableGait)


@pytest.mark.slow
def test_the_walk_that_recovers_keeps_its_speed_and_the_other_does_not(
    walks: tuple[FailedWalk, FailedWalk],
) -> None:
    speeds_m_s = []
    for one in walks:
        times_s, way_m = one.way_m()
        assert times_s[0] == pytest.approx(-FAILS_S)
        assert (one.leg, 0 < one.alarm_s < 1) == (5, True)
        before, after = (way_m[(times_s > begin) & (times_s < begin + 3), 0] for begin in (-4, 6))
        speeds_m_s.append(float(np.ptp(after) / np.ptp(before)))
    walking_on, recovering = speeds_m_s
    assert walking_on < 0.75
    assert recovering > 0.95


@pytest.mark.slow
def test_the_failed_leg_is_where_the_simulation_had_it(walks: tuple[FailedWalk, FailedWalk]) -> None:
    """Feet that carry are on the floor, with the foot's radius of the robot as its height."""
    heights_m = walks[0].points_world(-0.5)[:, -1, 2]
    assert sorted(heights_m)[2] == pytest.approx(sorted(heights_m)[0], abs=0.004)
    assert max(heights_m) - min(heights_m) > 0.01
