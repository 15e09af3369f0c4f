"""Two walks as the viewer shows them together."""

from pathlib import Path

import pytest

from hexctl.recording.side_by_side import write_together
from tests.viewer.checks import check_robot, of_kind
from tests.viewer.conftest import WALK_S, Opener

pytestmark = pytest.mark.slow


def test_two_walks_are_seen_in_one_scene_with_the_list_of_recordings(
    opened: Opener, trial: Path, tmp_path: Path
) -> None:
    scene, copy, _ = write_together([trial, trial], tmp_path)
    with opened(scene) as window:
        window.await_view("walks side by side")
        window.await_shown()
        window.show_time(5.0 + WALK_S)
        whole = window.picture()
        drawn = of_kind(window, "3D")
        check_robot(drawn)
        # The list is at the left, where a single recording has its scene.
        assert drawn.pixels.shape[1] < 0.65 * whole.pixels.shape[1]
        window.open(copy.as_uri())
        window.await_view("robot")
        window.picture()
        assert of_kind(window, "3D").pixels.shape[1] < 0.65 * whole.pixels.shape[1]
