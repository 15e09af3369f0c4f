"""What a trial showed: its path at any time, and whether it came to its end."""

import numpy as np
import pytest

from hexctl.adapt.shown import Shown
from hexctl.control.result import STATUSES
from tests.adapt.walking import result_of


def shown(points: int = 50, duration_s: float = 10.0, status: str = "ok") -> Shown:
    path = np.column_stack([np.arange(1.0, points + 1), -np.arange(1.0, points + 1)])
    return Shown(path_m=path, duration_s=duration_s, yaw_change_rad=0.1, status=status)


def test_it_is_what_the_result_has() -> None:
    result = result_of(-0.3)
    one = Shown.of(result)
    assert (one.duration_s, one.yaw_change_rad, one.status) == (30.0, 0.1, "ok")
    np.testing.assert_array_equal(one.path_m, result.path_m)


@pytest.mark.parametrize("status", STATUSES)
def test_only_walks_of_their_whole_time_are_finished(status: str) -> None:
    assert shown(status=status).finished == (status in ("ok", "no_progress"))


def test_a_row_of_the_path_belongs_to_the_time_at_its_end() -> None:
    rows = shown().at(np.array([0.2, 1.0, 5.0, 9.8, 10.0]))
    np.testing.assert_array_equal(rows[:, 0], [1, 5, 25, 49, 50])
    np.testing.assert_array_equal(rows[:, 1], -rows[:, 0])


def test_before_the_start_and_after_the_end_there_is_nothing() -> None:
    rows = shown().at(np.array([-1.0, 0.0, 10.2, 1e6]))
    assert np.isnan(rows).all()


def test_a_path_without_points_shows_nothing() -> None:
    nothing = Shown(path_m=np.zeros((0, 2)), duration_s=0.0, yaw_change_rad=None, status="fell")
    assert np.isnan(nothing.at(np.array([0.0, 1.0]))).all()


def test_how_finely_a_walk_was_kept_does_not_matter() -> None:
    fine = np.column_stack([np.linspace(0.002, 4, 1500), np.linspace(-0.001, -2, 1500)])
    times = np.arange(3.0, 30.1, 3.0)
    whole, thinned = (
        Shown(path_m=path, duration_s=30.0, yaw_change_rad=None, status="ok").at(times)
        for path in (fine, fine[9::10])
    )
    np.testing.assert_array_equal(whole, thinned)
