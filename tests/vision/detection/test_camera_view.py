import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.camera_view import sees_tags, visible_circle
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import TagFinder
from tests.vision.scenes import CAMERA, ROBOT_TAG, WEBCAM, scene, standing, tag_on

ROBOT = load_robot("ant")
HEIGHT_M = ROBOT.standing_height_m + tag_on(ROBOT).height_m


def test_a_camera_above_the_floor_sees_a_circle_below_it() -> None:
    down = Camera.looking(WEBCAM, np.array([0.3, -0.2, 2.0]), np.array([0.3, -0.2, 0.0]))
    middle, radius_m = visible_circle(down, 0.1, 0.1)
    assert middle == pytest.approx((0.3, -0.2), abs=0.11)
    # The picture is 720 px high; a tag has to be seen whole.
    assert radius_m == pytest.approx(1.9 * 360 / 955 - 0.07, abs=0.1)


def test_tags_are_found_where_they_are_said_to_be_and_not_found_outside() -> None:
    middle, radius_m = visible_circle(CAMERA, HEIGHT_M, 0.1)
    assert radius_m > 0.5
    around = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = np.array(middle) + radius_m * np.column_stack([np.cos(around), np.sin(around)])
    outside = np.array([[-1.8, 0.0], [0.0, 2.5], [0.0, -2.5]])
    with scene() as renderer:
        finder = TagFinder()
        for points, expected in ((ring, True), (outside, False)):
            for x_m, y_m in points:
                picture = renderer.draw(standing(ROBOT, PlanarPose(float(x_m), float(y_m), 0.3)))
                assert (ROBOT_TAG in finder.search(picture, thorough=True)) == expected, (x_m, y_m)
            assert sees_tags(CAMERA, points, HEIGHT_M, 0.1).all() == expected


def test_a_camera_that_sees_no_floor_gives_no_arena() -> None:
    up = Camera.looking(WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.9]))
    with pytest.raises(InputError, match="nowhere on the floor"):
        visible_circle(up, 0.1, 0.1)
    with pytest.raises(InputError, match="larger tag"):
        visible_circle(CAMERA, HEIGHT_M, 0.01)
