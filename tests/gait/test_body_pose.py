"""Poses of the body over its feet: rigid motions, and ranges."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.gait.body_pose import BodyPose, feet_from_body
from hexctl.types import FloatArray
from tests.robots import shipped

NUMBERS = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array)


def distances_m(feet: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(feet[:, None] - feet[None], axis=-1))


@given(NUMBERS)
def test_a_pose_keeps_the_distances_between_the_feet(numbers: FloatArray) -> None:
    feet = shipped("ant").stance_feet_body
    posed = feet_from_body(feet, BodyPose.of(numbers).array)
    np.testing.assert_allclose(distances_m(posed), distances_m(feet), atol=1e-12)
    both = feet_from_body(feet, np.stack([np.zeros(6), numbers]))
    assert (both[0] == feet).all()
    assert (both[1] == posed).all()


@pytest.mark.parametrize(
    ("pose", "axis", "first", "second"),
    [
        # The front is lower: nearer to its feet.
        (BodyPose(pitch_rad=0.1), 2, (0.2, 0, -0.1), (-0.2, 0, -0.1)),
        (BodyPose(roll_rad=0.1), 2, (0, -0.2, -0.1), (0, 0.2, -0.1)),
        (BodyPose(yaw_rad=0.1), 1, (-0.2, 0, -0.1), (0.2, 0, -0.1)),
        (BodyPose(), 0, (0.2, 0, 0), (0.1, 0, 0)),
    ],
)
def test_signs_are_those_of_rep_103(
    pose: BodyPose, axis: int, first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    posed = feet_from_body(np.array([first, second]), pose.array)
    assert posed[0, axis] > posed[1, axis]
