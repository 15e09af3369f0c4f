"""Lenses: their equations, their files, and their calibration with a printed board."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.vision.detection.lens import Lens, load_lens, save_lens
from hexctl.vision.detection.lens_calibration import LensCalibration
from hexctl.vision.detection.tags import Picture, TagFinder
from tests.vision.boards import BoardPictures

MATRIX = np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]])

MODELS = {
    "none": Lens.assumed(1280, 720, 67.0),
    "plumb_bob": Lens(
        width_px=1280, height_px=720, matrix=MATRIX, distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01])
    ),
    "rational_polynomial": Lens(
        width_px=1280, height_px=720, matrix=MATRIX, model="rational_polynomial",
        distortion=np.array([0.3, -0.1, 1e-4, 2e-4, 0.01, 0.6, -0.02, 0.005]),
    ),
    "equidistant": Lens(
        width_px=1280, height_px=720, matrix=np.array([[520.0, 0, 640], [0, 520, 360], [0, 0, 1]]),
        model="equidistant", distortion=np.array([-0.02, 0.004, -0.001, 0.0002]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
@given(column=st.floats(0, 1279), row=st.floats(0, 719))
def test_a_ray_is_seen_at_the_pixel_that_sees_it(name: str, column: float, row: float) -> None:
    lens = MODELS[name]
    rays = lens.rays(np.array([[column, row]]))
    assert np.allclose(lens.pixels(2.5 * rays), [[column, row]], atol=1e-3)


def test_the_middle_of_the_picture_is_half_a_pixel_before_its_half_width() -> None:
    assert np.allclose(MODELS["none"].rays(np.array([[639.5, 359.5]])), [[0, 0, 1]])
    left, right = MODELS["none"].rays(np.array([[-0.5, 0], [1279.5, 0]]))
    assert np.degrees(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(67)


def test_a_point_behind_the_camera_is_not_seen() -> None:
    assert np.isnan(MODELS["plumb_bob"].pixels(np.array([[0.1, 0.2, -1.0]]))).all()


@pytest.mark.parametrize("name", ["plumb_bob", "rational_polynomial", "equidistant"])
def test_a_file_brings_the_lens_back(tmp_path: Path, name: str) -> None:
    save_lens(MODELS[name], tmp_path / "lens.yaml")
    assert load_lens(tmp_path / "lens.yaml") == MODELS[name]


def test_half_the_pixels_see_the_same_and_other_shapes_are_refused() -> None:
    lens = MODELS["plumb_bob"]
    half = lens.scaled(640, 360)
    corner = np.array([[-0.5, -0.5], [99.5, 49.5]])
    assert np.allclose(half.rays(corner), lens.rays(2 * corner + 0.5), atol=1e-9)
    with pytest.raises(InputError, match="640x480"):
        lens.scaled(640, 480)
    for fov_deg in (0.0, 9.9, 151.0, float("nan")):
        with pytest.raises(InputError):
            Lens.assumed(640, 480, fov_deg)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"image_width": 0}, "image_width"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [0.0] * 9}}, "camera_matrix"),
        ({"distortion_coefficients": {"rows": 1, "cols": 3, "data": [0.0] * 3}}, "distortion_coefficients"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [float("nan")] * 9}}, "camera_matrix"),
    ],
)
def test_a_damaged_file_is_refused_by_key(tmp_path: Path, changes: dict[str, object], named: str) -> None:
    path = tmp_path / "lens.yaml"
    save_lens(MODELS["plumb_bob"], path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes))
    with pytest.raises(InputError, match=named):
        load_lens(path)


LENSES = {
    "webcam": Lens(
        width_px=960, height_px=540, matrix=np.array([[720.0, 0, 489], [0, 716, 262], [0, 0, 1]]),
        distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
    ),
    "480p": Lens(
        width_px=640, height_px=480, matrix=np.array([[560.0, 0, 325], [0, 558, 236], [0, 0, 1]]),
        distortion=np.array([0.08, -0.15, 1e-3, -5e-4, 0.02]),
    ),
    "fisheye": Lens(
        width_px=960, height_px=540, matrix=np.array([[390.0, 0, 480], [0, 390, 270], [0, 0, 1]]),
        model="equidistant", distortion=np.array([-0.02, 0.004, -0.001, 0.0002]),
    ),
}  # fmt: skip


@cache
def pictures(name: str, count: int = 20) -> tuple[Picture, ...]:
    return tuple(BoardPictures(LENSES[name]).around(count))


def ray_error_px(lens: Lens, found: Lens) -> float:
    """RMS over the picture of how far another lens sees the same rays, once it is turned to them."""
    from scipy.spatial.transform import Rotation

    columns, rows = np.meshgrid(np.linspace(0, lens.width_px - 1, 21), np.linspace(0, lens.height_px - 1, 15))
    points_px = np.column_stack([columns.ravel(), rows.ravel()])
    rays, others = (
        each / np.linalg.norm(each, axis=1, keepdims=True)
        for each in (lens.rays(points_px), found.rays(points_px))
    )
    turn = Rotation.align_vectors(others, rays)[0]
    apart_px = found.pixels(turn.apply(rays)) - points_px
    return float(np.sqrt(np.square(apart_px).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["webcam", "fisheye"])
def test_a_lens_is_recovered_within_half_a_pixel(name: str) -> None:
    calibration = LensCalibration(fisheye=name == "fisheye")
    for picture in pictures(name):
        calibration.add(picture)
    result = calibration.solve()
    assert ray_error_px(LENSES[name], result.lens) < 0.5
    assert result.lens.matrix[0, 0] == pytest.approx(LENSES[name].matrix[0, 0], rel=0.004)
    assert result.lens.calibrated
    assert result.rms_px < 0.3
    assert result.doubt_px < 0.6
    assert result.missing == ()
    assert result.coverage > 0.7
    assert TagFinder().search(pictures(name)[0], thorough=True) == {}, "its markers are no tags"


@pytest.mark.slow
def test_pictures_that_do_not_differ_do_not_count() -> None:
    calibration = LensCalibration()
    assert calibration.add(pictures("480p")[0]) is None
    assert calibration.add(pictures("480p")[0]) == "too alike"
    assert calibration.add(np.full((480, 640), 128, dtype=np.uint8)) == "no board"
    with pytest.raises(InputError, match="pictures"):
        calibration.solve()


@pytest.mark.slow
def test_a_fisheye_is_not_taken_for_a_usual_lens() -> None:
    calibration = LensCalibration()
    for picture in pictures("fisheye"):
        calibration.add(picture)
    with pytest.raises(InputError, match="fisheye"):
        calibration.solve()


@pytest.mark.slow
def test_a_picture_that_fits_to_no_flat_board_is_left_out() -> None:
    board = BoardPictures(LENSES["webcam"], seed=5)
    torn = board.draw(np.eye(3), np.array([0.02, 0.01, 0.4]))
    torn[270:] = np.roll(torn[270:], 6, axis=1)  # as of a camera that reads while the board moves
    calibration = LensCalibration()
    assert calibration.add(torn) is None
    for picture in pictures("webcam")[:12]:
        calibration.add(picture)
    result = calibration.solve()
    assert result.pictures == calibration.pictures - 1
    assert ray_error_px(LENSES["webcam"], result.lens) < 0.5
