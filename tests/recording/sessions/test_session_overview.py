"""The values of a session's overview, and its table."""

import numpy as np

from hexctl.recording.sessions.session_overview import drawable, make_table
from tests.recording.conftest import SESSION


def test_the_table_has_the_best_trial_in_bold() -> None:
    lines = make_table(SESSION).splitlines()
    bold = [line for line in lines if line.startswith("| **")]
    assert len(bold) == 1
    assert "**30.0 cm left** | **4.00 m** | **ok** | **30.0 cm**" in bold[0]
    assert "| 2 | 20 | 1,2,3,4,5,6 | 0.0 cm right | 4.00 m | fell | 80.0 cm |" in lines


def test_points_that_cannot_be_drawn_are_left_out() -> None:
    path = np.array([[0.0, 0.0], [0.1, 0.0], [np.nan, 0.0], [np.inf, 1.0], [0.0, -1e9]])
    np.testing.assert_array_equal(drawable(path), path[:2])
    assert drawable(np.zeros((0, 2))).shape == (0, 2)
