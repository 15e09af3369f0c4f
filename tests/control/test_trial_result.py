"""Results of trials: their JSON, their equality, one line and a plot."""

import json
from dataclasses import replace

import matplotlib
import numpy as np
import pytest

from hexctl.control.trial_result import Deviation, TrialResult
from hexctl.errors import InputError
from tests.control.assessment.scores import along, scored


def test_the_numbers_are_plain_json_with_the_promised_keys() -> None:
    numbers = scored(along(1.2, np.array([0.0, 0.1]))).to_dict()
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert set(numbers) >= {
        "duration_s",
        "distance_m",
        "deviation_m",
        "yaw_change_deg",
        "status",
        "stopped",
        "self_rotation_deg",
        "clipped_ticks",
    }
    assert set(numbers["deviation_m"]) == {"final", "mean", "max", "signed"}


def test_results_compare_by_value_and_travel_as_json() -> None:
    one = scored(along(1.2, np.array([0.0, 0.1])))
    other = scored(along(1.2, np.array([0.0, 0.1])))
    assert one == other
    assert one != replace(one, path_m=one.path_m + 1e-12)
    assert one != replace(one, status="fell")
    back = TrialResult.from_dict(json.loads(json.dumps(one.to_dict(path=True), allow_nan=False)))
    assert back.to_dict(path=True) == one.to_dict(path=True)
    assert back.deviation == one.deviation
    assert TrialResult.from_dict(one.to_dict()).path_m.shape == (0, 2)


def test_a_result_that_knows_nothing_travels_as_json_too() -> None:
    one = scored(along(1.2, np.array([0.0, 0.1])))
    partly = replace(one, deviation=Deviation(0.1, float("nan"), float("nan"), 0.1), yaw_change_rad=None)
    for result in (partly, replace(one, deviation=None, distance_m=None, path_m=np.zeros((0, 2)))):
        data = json.loads(json.dumps(result.to_dict(path=True), allow_nan=False))
        assert TrialResult.from_dict(data).deviation == result.deviation
        assert TrialResult.from_dict(data).to_dict(path=True) == data


@pytest.mark.parametrize("data", [{}, {"status": "ok"}, 3, None])
def test_what_is_no_result_is_refused_in_one_line(data: object) -> None:
    with pytest.raises(InputError, match=r"trial result: cannot be read .* allowed: what `to_dict` gives"):
        TrialResult.from_dict(data)  # type: ignore[arg-type]


def test_a_result_is_one_line_and_can_be_drawn() -> None:
    matplotlib.use("Agg")
    result = scored(along(1.2, np.array([0.0, 0.1])))
    assert "\n" not in repr(result)
    assert repr(result).startswith("TrialResult(")
    ax = result.plot()
    np.testing.assert_array_equal(ax.lines[1].get_xydata(), result.path_m)
    assert result.plot(ax) is ax
