"""Drawing without a screen, where this machine can."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.export.render import CAMERAS, NoRendererError, RunRenderer, open_context
from hexctl.recording.recorded_trial import LEG_CONDITIONS, RecordedTrial


@pytest.fixture
def _renderer(monkeypatch: Any) -> None:
    """Skip where nothing draws without a screen."""
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    try:
        open_context(16, 16).free()
    except NoRendererError as error:
        pytest.skip(str(error))


def test_without_a_renderer_one_line_says_what_to_install(walk: RecordedTrial, monkeypatch: Any) -> None:
    def missing(name: str) -> Any:
        raise ImportError(f"no {name}\nat all")

    monkeypatch.setattr("hexctl.export.render.import_module", missing)
    with pytest.raises(NoRendererError, match=r"apt-get install libegl1 .*osmesa") as refused:
        RunRenderer(walk, "side", 64, 48)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.usefixtures("_renderer")
def test_every_camera_sees_the_robot_from_its_side(walk: RecordedTrial) -> None:
    pictures = {}
    for camera in CAMERAS:
        renderer = RunRenderer(walk, camera, 96, 72)
        pictures[camera] = renderer.draw(0)
        later = renderer.draw(len(walk) - 1)
        renderer.close()
        assert pictures[camera].shape == (72, 96, 3)
        blue = pictures[camera].astype(int)
        body = (blue[..., 2] - blue[..., 0] > 60).sum()
        assert 20 < body < 96 * 72 / 2, camera
        assert (later != pictures[camera]).any()
    assert len({picture.tobytes() for picture in pictures.values()}) == len(CAMERAS)


def tinted(trial: RecordedTrial) -> tuple[list[int], list[int]]:
    """Numbers of red and of amber pixels in the first ticks, seen from above."""
    renderer = RunRenderer(trial, "top", 160, 120)
    red, amber = [], []
    for row in range(5):
        picture = renderer.draw(row).astype(int)
        warm = picture[..., 0] - picture[..., 2] > 60
        yellow = picture[..., 1] - picture[..., 2] > 60
        red.append(int((warm & ~yellow).sum()))
        amber.append(int((warm & yellow).sum()))
    renderer.close()
    return red, amber


@pytest.mark.usefixtures("_renderer")
def test_the_failed_leg_is_red(walk: RecordedTrial) -> None:
    red, amber = tinted(walk)
    assert min(red) > 30
    assert max(amber) == 0


@pytest.mark.usefixtures("_renderer")
def test_legs_have_the_colours_of_their_conditions_while_they_last(walk: RecordedTrial) -> None:
    conditions = np.zeros_like(walk.leg_conditions)
    for row, condition in enumerate(("whole", "noticed", "failed", "missing", "whole")):
        conditions[row, 4] = LEG_CONDITIONS.index(condition)
    red, amber = tinted(replace(walk, leg_conditions=conditions))
    assert [count > 30 for count in red] == [False, False, True, False, False]
    assert [count > 30 for count in amber] == [False, True, False, False, False]
    assert red[3] < red[2] / 2  # almost transparent
    assert [red[0], amber[0]] == [red[4], amber[4]] == [0, 0]


def yellow(picture: Any) -> int:
    """Number of the yellow pixels."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return int(((red - blue > 60) & (green - blue > 60)).sum())


@pytest.mark.slow
@pytest.mark.usefixtures("_renderer")
def test_the_way_until_then_is_drawn_where_the_line_is_known(walk: RecordedTrial) -> None:
    assert walk.course_world is not None
    walk = replace(walk, base_position_world=walk.base_position_world * [8, 1, 1])  # beyond its own body
    renderer = RunRenderer(walk, "top", 320, 240)
    way = [yellow(renderer.draw(row)) for row in (0, len(walk) // 2, len(walk) - 1)]
    renderer.close()
    without = RunRenderer(replace(walk, course_world=None), "top", 320, 240)
    assert yellow(without.draw(len(walk) - 1)) == 0
    without.close()
    assert way[0] == 0
    assert way[2] > max(20, way[1])


@pytest.mark.usefixtures("_renderer")
def test_a_sloping_floor_slopes(walk: RecordedTrial) -> None:
    tilted = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])
    renderer = RunRenderer(replace(walk, floor_quaternion=tilted), "side", 64, 48)
    renderer.place(0)
    normal = renderer.data.geom("floor").xmat.reshape(3, 3)[:, 2]
    renderer.close()
    assert normal == pytest.approx([np.sin(0.2), 0.0, np.cos(0.2)], abs=1e-6)


@pytest.mark.usefixtures("_renderer")
def test_a_robot_that_knows_no_place_is_drawn_above_the_origin(walk: RecordedTrial) -> None:
    nowhere = replace(walk, base_position_world=np.full_like(walk.base_position_world, np.nan))
    renderer = RunRenderer(nowhere, "side", 64, 48)
    renderer.place(10)
    assert renderer.data.qpos[:3] == pytest.approx([0, 0, walk.robot.standing_height_m])
    renderer.close()
