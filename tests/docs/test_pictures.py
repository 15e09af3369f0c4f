"""The pictures of the pages: what they show is what the walks do."""

import math

import numpy as np
import pytest
from PIL import Image, ImageSequence

from hexctl.control.monitor.recovery import GlideToStableGait, WalkOn
from hexctl.demo.rescue import RECOVER, WALK_ON, speed_kept, walk_and_fail
from pictures.failure_strip import FAILS_S, FailedWalk, walk
from pictures.rescue import RACE
from pictures.step_response import SHIFT_M, TURN_RAD, respond
from tests.docs.pages import ROOT

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


@pytest.fixture(scope="module")
def walks() -> tuple[FailedWalk, FailedWalk]:
    return walk("walks on", WalkOn), walk("recovers", GlideToStableGait)


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


def test_the_failed_leg_is_where_the_simulation_had_it(walks: tuple[FailedWalk, FailedWalk]) -> None:
    """Feet that carry are on the floor, with the foot's radius of the robot as its height."""
    heights_m = walks[0].points_world(-0.5)[:, -1, 2]
    assert sorted(heights_m)[2] == pytest.approx(sorted(heights_m)[0], abs=0.004)
    assert max(heights_m) - min(heights_m) > 0.01


PICTURE = ROOT / "docs" / "images" / "rescue.gif"


@pytest.mark.parametrize(("policy", "kept"), [(WALK_ON, 0.47), (RECOVER, 1.02)])
def test_the_race_is_what_the_walks_do(policy: str, kept: float) -> None:
    assert speed_kept(walk_and_fail(policy, None)) == pytest.approx(kept, abs=0.03)


def test_the_picture_is_small_and_on_top_of_the_readme() -> None:
    assert PICTURE.stat().st_size <= 2_000_000
    with Image.open(PICTURE) as gif:
        assert gif.size[0] == RACE["width_px"]
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert 5 <= shown_ms / 1000 <= 8.1
    head = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:6]
    assert any("docs/images/rescue.gif" in line for line in head)
