import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlanarPose, tag_pose
from hexctl.vision.detection.tags import TagFinder
from hexctl.vision.twin.rendering import CameraFlaws
from tests.vision.scenes import FLOOR_TAGS, scene, standing

HERE = standing(load_robot("ant"), PlanarPose(0.1, 0, 0))


@pytest.mark.slow
def test_without_flaws_a_picture_is_the_same_each_time() -> None:
    with scene(flaws=CameraFlaws(noise=0, blur_px=0)) as renderer:
        first, second = renderer.draw(HERE), renderer.draw(HERE)
    assert first.shape == (720, 1280)
    assert (first == second).all()


@pytest.mark.slow
def test_noise_is_as_strong_as_asked() -> None:
    with scene(flaws=CameraFlaws(noise=5, blur_px=0)) as renderer:
        first, second = (renderer.draw_color(HERE).astype(float) for _ in range(2))
    assert (first - second)[:100].std() == pytest.approx(5 * np.sqrt(2), rel=0.1)


@pytest.mark.slow
def test_a_long_exposure_smears_a_robot_that_moved_and_not_the_floor() -> None:
    there = standing(load_robot("ant"), PlanarPose(0.2, 0, 0))
    with scene(flaws=CameraFlaws(noise=0, exposure_s=0.02)) as renderer:
        renderer.draw(HERE)
        smeared = renderer.draw(there).astype(int)
        still = renderer.draw(there).astype(int)
    assert abs(smeared - still).max() > 50
    assert (smeared[500:] == still[500:]).all()


@pytest.mark.slow
def test_a_shadow_wanders() -> None:
    with scene(flaws=CameraFlaws(noise=0, shadow=0.6)) as renderer:
        dark = [renderer.draw(HERE, at_s)[600].argmin() for at_s in (0.0, 1.0)]
        assert renderer.draw(HERE, 0.0)[600].min() < 0.5 * renderer.draw(HERE, 0.0)[600].max()
    assert dark[1] > dark[0] + 100


def test_a_fisheye_is_drawn_as_it_sees() -> None:
    matrix = np.array([[640.0, 0, 640], [0, 640, 360], [0, 0, 1]])
    bends = np.array([-0.02, 0.004, 0, 0])
    fisheye = Lens(width_px=1280, height_px=720, matrix=matrix, model="equidistant", distortion=bends)
    camera = Camera.looking(fisheye, np.array([-1.0, 0.0, 1.2]), np.zeros(3))
    with scene(camera, CameraFlaws(noise=0)) as renderer:
        found = TagFinder().search(renderer.draw(HERE), thorough=True)
    assert {0, 1, 3} <= set(found)
    for tag_id in (0, 1, 3):
        seen = tag_pose(camera, found[tag_id].corners_px, 0.0)
        assert seen is not None
        assert (
            np.hypot(seen.pose.x_m - FLOOR_TAGS[tag_id].pose.x_m, seen.pose.y_m - FLOOR_TAGS[tag_id].pose.y_m)
            < 0.003
        )


def test_a_lens_that_sees_too_much_is_refused() -> None:
    matrix = np.array([[200.0, 0, 640], [0, 200, 360], [0, 0, 1]])
    wide = Lens(width_px=1280, height_px=720, matrix=matrix, model="equidistant", distortion=np.zeros(4))
    with pytest.raises(InputError, match="narrower"), scene(Camera.looking(wide, np.ones(3), np.zeros(3))):
        pass
