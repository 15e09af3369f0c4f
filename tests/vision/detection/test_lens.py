from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.vision.detection.lens import Lens, load_lens, save_lens

MATRIX = np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]])
LENSES = {
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


@pytest.mark.parametrize("name", LENSES)
@given(column=st.floats(0, 1279), row=st.floats(0, 719))
def test_a_ray_is_seen_at_the_pixel_that_sees_it(name: str, column: float, row: float) -> None:
    lens = LENSES[name]
    rays = lens.rays(np.array([[column, row]]))
    assert np.allclose(lens.pixels(2.5 * rays), [[column, row]], atol=1e-3)


def test_the_middle_of_the_picture_is_half_a_pixel_before_its_half_width() -> None:
    assert np.allclose(LENSES["none"].rays(np.array([[639.5, 359.5]])), [[0, 0, 1]])
    left, right = LENSES["none"].rays(np.array([[-0.5, 0], [1279.5, 0]]))
    assert np.degrees(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(67)


def test_a_point_behind_the_camera_is_not_seen() -> None:
    assert np.isnan(LENSES["plumb_bob"].pixels(np.array([[0.1, 0.2, -1.0]]))).all()


@pytest.mark.parametrize("name", ["plumb_bob", "rational_polynomial", "equidistant"])
def test_a_file_brings_the_lens_back(tmp_path: Path, name: str) -> None:
    save_lens(LENSES[name], tmp_path / "lens.yaml")
    assert load_lens(tmp_path / "lens.yaml") == LENSES[name]


def test_half_the_pixels_see_the_same() -> None:
    lens = LENSES["plumb_bob"]
    half = lens.scaled(640, 360)
    corner = np.array([[-0.5, -0.5], [99.5, 49.5]])
    assert np.allclose(half.rays(corner), lens.rays(2 * corner + 0.5), atol=1e-9)
    with pytest.raises(InputError, match="640x480"):
        lens.scaled(640, 480)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"image_width": 0}, "image_width"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [1.0] * 8}}, "9 numbers"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [0.0] * 9}}, "above 0"),
        ({"distortion_model": "ftheta"}, "distortion_model"),
        ({"distortion_coefficients": {"rows": 1, "cols": 3, "data": [0.0] * 3}}, "5 for plumb_bob"),
        ({"camera_matrix": {"rows": 3, "cols": 3, "data": [float("nan")] * 9}}, "finite"),
    ],
)
def test_a_damaged_file_is_refused_by_key(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    path = tmp_path / "lens.yaml"
    save_lens(LENSES["plumb_bob"], path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes))
    with pytest.raises(InputError, match=said):
        load_lens(path)


@pytest.mark.parametrize("fov_deg", [0.0, 9.9, 151.0, float("nan")])
def test_an_impossible_field_of_view_is_refused(fov_deg: float) -> None:
    with pytest.raises(InputError, match="10 to 150"):
        Lens.assumed(640, 480, fov_deg)


def test_pixels_are_those_of_opencv() -> None:
    lens = LENSES["plumb_bob"]
    points = np.random.default_rng(0).uniform([-1, -0.5, 1.5], [1, 0.5, 4], (20, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, lens.distortion)[0]
    assert np.allclose(lens.pixels(points), expected.reshape(-1, 2))
