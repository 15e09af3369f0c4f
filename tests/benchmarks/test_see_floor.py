"""What a floor is summed up to, of places where the robot was seen and of those where it was not."""

import math
import warnings

import numpy as np
import pytest

from benchmarks.see_floor import FloorErrors
from hexctl.vision.detection.floor import LearnedFloor

FLOOR = LearnedFloor(tags={}, cameras=(), residuals_px={}, doubts=())


def errors(off: list[tuple[float, float, float]]) -> FloorErrors:
    rows = np.array(off).reshape(-1, 3)
    return FloorErrors(np.zeros((len(rows), 2)), rows[:, :2], rows[:, 2], np.zeros(len(rows)), FLOOR)


def test_places_where_it_was_not_seen_do_not_count() -> None:
    seen = errors([(0.003, 0.004, 0.1), (math.nan, math.nan, math.nan), (0.0, -0.005, -0.1)])
    assert seen.position_rms_m == pytest.approx(0.005)
    assert seen.yaw_rms_rad == pytest.approx(0.1)
    assert seen.seen.tolist() == [1, 0, 1]


@pytest.mark.parametrize("off", [[], [(math.nan, math.nan, math.nan)]])
def test_seen_nowhere_is_no_number_and_no_warning(off: list[tuple[float, float, float]]) -> None:
    nowhere = errors(off)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert math.isnan(nowhere.position_rms_m)
        assert math.isnan(nowhere.yaw_rms_rad)
