import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hexctl.vision.detection.camera import Camera, place_camera, reprojection_px
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, WEBCAM


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
