import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera, place_camera, reprojection_px, sees_tags, visible_circle
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import TagFinder
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, ROBOT_TAG, WEBCAM, scene, standing, tag_on

ROBOT = load_robot("ant")
HEIGHT_M = ROBOT.standing_height_m + tag_on(ROBOT).height_m


@given(x_m=st.floats(-1, 1.5), y_m=st.floats(-1, 1), height_m=st.floats(0, 0.4))
def test_a_point_lies_where_the_ray_of_its_pixel_meets_its_height(
    x_m: float, y_m: float, height_m: float
) -> None:
    seen = CAMERA.pixels(np.array([[x_m, y_m, height_m]]))
    assert np.allclose(CAMERA.floor_points(seen, height_m), [[x_m, y_m]], atol=1e-5)


def test_rays_above_the_horizon_meet_no_floor() -> None:
    level = Camera.looking(WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0]))
    assert np.isnan(level.floor_points(np.array([[640.0, 100.0]]))).all()
    assert np.isfinite(level.floor_points(np.array([[640.0, 600.0]]))).all()


def test_a_camera_over_the_floor_looks_straight_down() -> None:
    down = Camera.looking(WEBCAM, np.array([0.2, 0.1, 2.0]), np.array([0.2, 0.1, 0.0]))
    assert np.isclose(down.tilt_rad, np.pi / 2)
    middle, upper = down.pixels(np.array([[0.2, 0.1, 0.0], [0.2, 0.2, 0.0]]))
    assert upper[1] < middle[1]  # the floor's y is up in the picture


def test_the_tags_on_the_floor_tell_where_the_camera_is() -> None:
    seen = {
        tag_id: CAMERA.pixels(np.column_stack([corners, np.zeros(4)]))
        for tag_id, corners in FLOOR_CORNERS.items()
    }
    found = place_camera(WEBCAM, seen | {99: np.zeros((4, 2))}, FLOOR_CORNERS)
    assert found is not None
    assert np.allclose(found.position_floor, CAMERA.position_floor, atol=1e-4)
    assert np.allclose(found.rotation, CAMERA.rotation, atol=1e-4)
    assert max(reprojection_px(found, seen, FLOOR_CORNERS).values()) < 0.01


def test_a_camera_that_was_shifted_sees_all_tags_elsewhere() -> None:
    seen = {
        tag_id: CAMERA.pixels(np.column_stack([corners, np.zeros(4)]))
        for tag_id, corners in FLOOR_CORNERS.items()
    }
    moved = Camera(WEBCAM, CAMERA.rotation, CAMERA.position_floor + np.array([0.0, 0.05, 0.0]))
    assert min(reprojection_px(moved, seen, FLOOR_CORNERS).values()) > 5


def test_without_a_tag_of_the_floor_the_camera_is_nowhere() -> None:
    assert place_camera(WEBCAM, {5: np.zeros((4, 2))}, FLOOR_CORNERS) is None
    assert place_camera(WEBCAM, {}, FLOOR_CORNERS) is None


@pytest.mark.slow
def test_a_camera_above_the_floor_sees_a_circle_below_it() -> None:
    down = Camera.looking(WEBCAM, np.array([0.3, -0.2, 2.0]), np.array([0.3, -0.2, 0.0]))
    middle, radius_m = visible_circle(down, 0.1, 0.1)
    assert middle == pytest.approx((0.3, -0.2), abs=0.11)
    # The picture is 720 px high; a tag has to be seen whole.
    assert radius_m == pytest.approx(1.9 * 360 / 955 - 0.07, abs=0.1)


@pytest.mark.slow
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
