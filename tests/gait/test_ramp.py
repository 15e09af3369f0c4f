"""The soft start and stop: half of the full stride per second, never beyond, never a jump."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.gait.ramp import ramp


@pytest.mark.parametrize(
    ("time_s", "stop_s", "level"),
    [
        (-1, None, 0),
        (0, None, 0),
        (1, None, 0.5),
        (2, None, 1),
        (60, None, 1),
        (61, 60, 0.5),
        (62, 60, 0),
        (99, 60, 0),
        (1, 1, 0.5),
        (1.5, 1, 0.25),
        (2, 1, 0),
    ],
)
def test_levels_of_the_ramp(time_s: float, stop_s: float | None, level: float) -> None:
    assert float(ramp(time_s, stop_s)) == pytest.approx(level)


@given(times=st.lists(st.floats(-5, 100), min_size=2, max_size=2), stop_s=st.none() | st.floats(0, 100))
def test_the_ramp_changes_by_half_a_stride_per_second_at_most(
    times: list[float], stop_s: float | None
) -> None:
    levels = ramp(np.array(times), stop_s)
    assert ((levels >= 0) & (levels <= 1)).all()
    assert abs(levels[1] - levels[0]) <= 0.5 * abs(times[1] - times[0]) + 1e-12
