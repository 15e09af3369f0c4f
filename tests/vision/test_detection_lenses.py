"""Lenses: their equations, their files and those of other tools, and calibration with a printed board."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.types import FloatArray
from hexctl.vision.detection.calibration_board import SQUARE_M, SQUARES, black_squares
from hexctl.vision.detection.lens import Lens, load_lens, save_lens
from hexctl.vision.detection.lens_calibration import LensCalibration
from hexctl.vision.detection.tags import Picture, TagFinder

LENSES = {
    "none": Lens.assumed(1280, 720, 67.0),
    "webcam": Lens(
        width_px=960, height_px=540, matrix=np.array([[720.0, 0, 489], [0, 716, 262], [0, 0, 1]]),
        distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
    ),
    "480p": Lens(
        width_px=640, height_px=480, matrix=np.array([[560.0, 0, 325], [0, 558, 236], [0, 0, 1]]),
        distortion=np.array([0.08, -0.15, 1e-3, -5e-4, 0.02]),
    ),
    "rational": Lens(
        width_px=1280, height_px=720, matrix=np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]]),
        model="rational_polynomial", distortion=np.array([0.3, -0.1, 1e-4, 2e-4, 0.01, 0.6, -0.02, 0.005]),
    ),
    "fisheye": Lens(
        width_px=960, height_px=540, matrix=np.array([[390.0, 0, 480], [0, 390, 270], [0, 0, 1]]),
        model="equidistant", distortion=np.array([-0.02, 0.004, -0.001, 0.0002]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LENSES)
@given(across=st.floats(0, 1), down=st.floats(0, 1))
def test_a_ray_is_seen_at_the_pixel_that_sees_it(name: str, across: float, down: float) -> None:
    lens = LENSES[name]
    pixel = [across * (lens.width_px - 1), down * (lens.height_px - 1)]
    assert np.allclose(lens.pixels(2.5 * lens.rays(np.array([pixel]))), [pixel], atol=1e-3)


def test_the_middle_of_the_picture_is_half_a_pixel_before_its_half_width() -> None:
    assert np.allclose(LENSES["none"].rays(np.array([[639.5, 359.5]])), [[0, 0, 1]])
    left, right = LENSES["none"].rays(np.array([[-0.5, 0], [1279.5, 0]]))
    assert np.degrees(np.arctan(right[0]) - np.arctan(left[0])) == pytest.approx(67)


def test_a_point_behind_the_camera_is_not_seen() -> None:
    assert np.isnan(LENSES["webcam"].pixels(np.array([[0.1, 0.2, -1.0]]))).all()


def test_half_the_pixels_see_the_same_and_other_shapes_are_refused() -> None:
    lens = LENSES["webcam"]
    half = lens.scaled(480, 270)
    corner = np.array([[-0.5, -0.5], [99.5, 49.5]])
    assert np.allclose(half.rays(corner), lens.rays(2 * corner + 0.5), atol=1e-9)
    with pytest.raises(InputError, match="640x480"):
        lens.scaled(640, 480)
    for fov_deg in (0.0, 9.9, 151.0, float("nan")):
        with pytest.raises(InputError):
            Lens.assumed(640, 480, fov_deg)


# Files.

MATRIX = np.array([[701.2, 0.0, 331.4], [0.0, 699.8, 242.9], [0.0, 0.0, 1.0]])
FOURTEEN = [0.1, -0.2, 1e-3, -2e-3, 0.05, 0.02, -0.03, 0.01, 1e-3, 2e-3, -1e-3, 1e-4, 0.01, -0.02]
POINTS = np.random.default_rng(3).uniform([-0.4, -0.3, 1.5], [0.4, 0.3, 3], (20, 3))


def ros(coefficients: list[float], **keys: object) -> dict[str, object]:
    return {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": {"rows": 3, "cols": 3, "data": MATRIX.ravel().tolist()},
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
        **keys,
    }


def loaded(folder: Path, text: str) -> Lens:
    (folder / "lens.yaml").write_text(text)
    return load_lens(folder / "lens.yaml")


def projected(coefficients: list[float]) -> FloatArray:
    none = np.zeros(3)
    points = cv2.projectPoints(POINTS, none, none, MATRIX, np.array(coefficients))[0]
    return np.asarray(points, dtype=float).reshape(-1, 2)


@pytest.mark.parametrize(
    ("key", "name", "count", "model"),
    [
        *(("distortion_model", "plumb_bob", count, "plumb_bob") for count in (0, 4, 5)),
        *(
            ("distortion_model", "rational_polynomial", count, "rational_polynomial")
            for count in (5, 8, 12, 14)
        ),
        ("distortion_model", "equidistant", 4, "equidistant"),
        ("camera_model", "plumb_bob", 5, "plumb_bob"),
        ("camera_model", "Brown Conrady", 5, "plumb_bob"),
        ("camera_model", "pinhole", 8, "rational_polynomial"),
        ("camera_model", "rational_polynomial", 14, "rational_polynomial"),
        ("camera_model", "fisheye", 4, "equidistant"),
        ("camera_model", "KANNALA_BRANDT4", 4, "equidistant"),
    ],
)
def test_a_model_has_as_many_numbers_as_opencv_takes(
    tmp_path: Path, key: str, name: str, count: int, model: str
) -> None:
    lens = loaded(tmp_path, yaml.safe_dump(ros(FOURTEEN[:count], **{key: name})))
    assert lens.model == model
    if model != "equidistant":
        assert np.allclose(lens.pixels(POINTS), projected(FOURTEEN[:count] or [0.0] * 4))
    save_lens(lens, tmp_path / "again.yaml")
    assert load_lens(tmp_path / "again.yaml") == lens


@pytest.mark.parametrize("suffix", ["yaml", "xml", "json"])
@pytest.mark.parametrize(
    ("count", "model"), [(5, "plumb_bob"), (8, "rational_polynomial"), (14, "rational_polynomial")]
)
def test_a_file_storage_of_opencv_is_read(tmp_path: Path, suffix: str, count: int, model: str) -> None:
    path = tmp_path / f"camera.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "Fri 13 Mar 2026 10:00:00 AM CET")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array([FOURTEEN[:count]]).T)
    storage.write("avg_reprojection_error", 0.21)
    storage.release()
    lens = load_lens(path)
    assert (lens.size_px, lens.model) == ((640, 480), model)
    assert np.allclose(lens.matrix, MATRIX)
    assert np.allclose(lens.distortion[:count], FOURTEEN[:count])


def test_a_file_storage_of_a_fisheye_and_one_with_short_names(tmp_path: Path) -> None:
    matrix = f"!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {MATRIX.ravel().tolist()}"
    four = "!!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n   data: [ 0.1, 1.e-02, 0., -1e-05 ]"
    text = f"%YAML:1.0\n---\nimage_size: [ 640, 480 ]\nfisheye_model: 1\nK: {matrix}\nD: {four}\n"
    assert loaded(tmp_path, text).model == "equidistant"
    plain = loaded(tmp_path, text.replace("fisheye_model: 1", "fisheye_model: 0"))
    assert (plain.model, plain.size_px) == ("plumb_bob", (640, 480))
    assert plain.distortion.tolist() == [0.1, 0.01, 0.0, -1e-5, 0.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<!DOCTYPE a><opencv_storage/>", "DOCTYPE"),
        ("<opencv_storage>", "is not XML"),
        (yaml.safe_dump(ros(FOURTEEN[:4])), "distortion_model: plumb_bob, or distortion_model: equidistant"),
        (yaml.safe_dump(ros(FOURTEEN[:7])), "4, 5 for plumb_bob"),
        (yaml.safe_dump(ros(FOURTEEN[:6], distortion_model="rational_polynomial")), "5, 8, 12, 14"),
        (yaml.safe_dump(ros(FOURTEEN[:5], camera_model="omni")), "distortion_model"),
        ("image_size: 5", "2 numbers"),
        ("{}", "image_width"),
        (yaml.safe_dump(ros(FOURTEEN[:5], image_width=0)), "image_width"),
        *(
            (yaml.safe_dump(ros(FOURTEEN[:5], camera_matrix={"data": [value] * 9})), "camera_matrix")
            for value in (0.0, float("nan"))
        ),
        (yaml.safe_dump(ros([0.0] * 3)), "distortion_coefficients"),
    ],
)
def test_what_is_no_calibration_is_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        loaded(tmp_path, text)


# Calibration.

#: Resolution of the board that is drawn, and its white edge in m.
_PX_PER_M, _EDGE_M = 4000, 0.02


@cache
def _board() -> Picture:
    size_px = [round((count * SQUARE_M + 2 * _EDGE_M) * _PX_PER_M) for count in SQUARES[::-1]]
    picture = np.full(size_px, 230, dtype=np.uint8)
    for square in black_squares():
        left, top, edge = (value + (_EDGE_M if place < 2 else 0) for place, value in enumerate(square))
        rows, columns = (slice(round(at * _PX_PER_M), round((at + edge) * _PX_PER_M)) for at in (top, left))
        picture[rows, columns] = 25
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 1.5))


class BoardPictures:
    """Draws the board as a lens sees it, a little blurred and with noise."""

    def __init__(self, lens: Lens, *, noise: float = 3.0, blur_px: float = 0.6, seed: int = 0) -> None:
        self.lens, self._noise, self._blur_px = lens, noise, blur_px
        self._random = np.random.default_rng(seed)
        rows, columns = np.mgrid[: lens.height_px, : lens.width_px].astype(float)
        self._shape = rows.shape
        self._rays = lens.rays(np.column_stack([columns.ravel(), rows.ravel()])).astype(np.float32)

    def draw(self, rotation: FloatArray, middle_m: FloatArray) -> Picture:
        """Picture of the board, turned, with its middle at a place in the camera's frame."""
        normal = rotation[:, 2].astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (normal @ middle_m) / (self._rays @ normal)
            length[~(length > 0)] = np.nan
            on_board = (self._rays * length[:, np.newaxis] - middle_m.astype(np.float32)) @ rotation[
                :, :2
            ].astype(np.float32)
        half_m = np.array(SQUARES) * SQUARE_M / 2 + _EDGE_M
        where = np.nan_to_num((on_board + half_m) * _PX_PER_M - 0.5, nan=-1e4).astype(np.float32)
        across, down = (where[:, index].reshape(self._shape) for index in (0, 1))
        drawn = cv2.remap(_board(), across, down, cv2.INTER_LINEAR, borderValue=(150,)).astype(np.float32)
        picture = cv2.GaussianBlur(drawn, (0, 0), self._blur_px)
        noisy = picture + self._noise * self._random.standard_normal(picture.shape)
        return np.asarray(np.clip(np.round(noisy), 0, 255), dtype=np.uint8)

    def around(self, count: int, *, reach: float = 0.75, tilt_deg: float = 35.0) -> Iterator[Picture]:
        """Pictures with the board all over the picture, near and far, tilted to all sides."""
        corners = np.array([[0.0, 0.0], [self.lens.width_px - 1, self.lens.height_px - 1]])
        middle = corners.mean(axis=0)
        for number in range(count):
            spot = 2 * np.array([(0.5 + number * 0.618) % 1, (0.5 + number * 0.755) % 1]) - 1
            ray = self.lens.rays((middle + reach * spot * middle)[np.newaxis])[0]
            away_m = self._random.uniform(0.26, 0.5) * self.lens.matrix[0, 0] / self.lens.width_px / 0.6
            tilt = np.radians(tilt_deg) * self._random.uniform(-1, 1, 2)
            turn = cv2.Rodrigues(np.array([*tilt, self._random.uniform(-0.4, 0.4)]))[0]
            facing = cv2.Rodrigues(np.cross([0.0, 0.0, 1.0], ray / np.linalg.norm(ray)))[0]
            yield self.draw(facing @ turn, away_m * ray / np.linalg.norm(ray))


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
