"""The trial frame: progress along the heading, deviation to its left."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.control.trace import TrialFrame

near = st.floats(-20, 20)


@given(heading=st.floats(-7, 7), progress=near, left=near, x=near, y=near)
def test_a_point_ahead_and_to_the_left_has_those_coordinates(
    heading: float, progress: float, left: float, x: float, y: float
) -> None:
    frame = TrialFrame(np.array([x, y, 0.1]), heading, 0.0)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-math.sin(heading), math.cos(heading)])
    point = np.array([x, y]) + progress * ahead + left * aside
    path = frame.path(np.array([[*point, 5.0]]))
    assert path.shape == (1, 2)
    assert path[0].tolist() == pytest.approx([progress, left], abs=1e-9)
