"""The step responses of the page on steering, by the code that draws them."""

import math

import pytest

from pictures.step_response import SHIFT_M, TURN_RAD, respond

pytestmark = pytest.mark.slow


def test_a_walk_comes_to_a_line_that_moves_as_the_page_says() -> None:
    moved = respond("ant", None, shift_m=SHIFT_M, turn_rad=0.0)
    assert moved.deviation_m[0] < -0.99 * SHIFT_M
    assert moved.reached_at(moved.deviation_m) < 5
    assert moved.deviation_m.max() < 0.06
    assert moved.settled_at(moved.deviation_m, SHIFT_M) < 18


def test_a_walk_turns_with_its_line_as_the_page_says() -> None:
    turned = respond("ant", 3, shift_m=0.0, turn_rad=TURN_RAD)
    assert turned.yaw_off_rad[0] < -0.95 * TURN_RAD
    assert turned.reached_at(turned.yaw_off_rad) < 6
    assert turned.yaw_off_rad.max() < math.radians(4.0)
    assert abs(turned.deviation_m).max() < 0.04
    assert abs(turned.deviation_m[-50:]).max() < 0.01
