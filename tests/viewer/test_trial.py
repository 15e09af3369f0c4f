"""A trial as the viewer shows it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb

from hexctl.recording.recording import APPLICATION_ID
from pictures.window import Window
from tests.viewer.checks import check_robot, check_trial, check_whole, of_kind
from tests.viewer.conftest import WALK_S, Opener

pytestmark = pytest.mark.slow

#: When the robot stands, and when it is about to stop.
BEGUN_S, WALKED_S = 0.5, 5.0 + WALK_S


@pytest.fixture(scope="module")
def window(opened: Opener, trial: Path) -> Iterator[Window]:
    """A viewer that shows the trial, in mid-walk."""
    with opened(trial) as window:
        window.await_shown()
        window.show_time(WALKED_S)
        yield window


def test_a_trial_opens_with_all_its_panels(window: Window) -> None:
    check_trial(window)


def test_the_robot_moves_with_the_time_cursor(window: Window) -> None:
    pictures = []
    for time_s in (BEGUN_S, WALKED_S):
        window.show_time(time_s)
        window.picture()
        pictures.append(of_kind(window, "3D"))
        check_robot(pictures[-1])
    begun, walked = pictures
    assert walked.difference(begun) > 0.01


def test_all_of_the_robot_is_in_the_picture(window: Window) -> None:
    window.picture()
    check_whole(of_kind(window, "3D"))


def written(path: Path, *views: object) -> Path:
    """Write a recording of hexctl with some views and nothing to be seen in them."""
    stream = rr.RecordingStream(APPLICATION_ID)
    blueprint = rrb.Blueprint(rrb.Horizontal(*views), auto_views=False, auto_layout=False)
    stream.save(str(path), default_blueprint=blueprint)
    stream.log("world/floor", rr.Boxes3D(half_sizes=[[1, 1, 0.01]], colors=[(90, 90, 90)]), static=True)
    stream.flush()
    stream.disconnect()
    return path


def test_these_tests_see_that_a_robot_is_missing(opened: Opener, tmp_path: Path) -> None:
    path = written(tmp_path / "wrong.rrd", rrb.Spatial3DView(origin="world"))
    with opened(path) as window:
        window.await_shown()
        window.picture()
        with pytest.raises(AssertionError, match="no trunk is seen"):
            check_robot(of_kind(window, "3D"))
        with pytest.raises(AssertionError, match="views are missing"):
            check_trial(window)
