"""Calibrations as other tools write them."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from hexctl.errors import InputError
from hexctl.types import FloatArray
from hexctl.vision.detection.lens import Lens, load_lens, save_lens

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


def loaded(folder: Path, text: str, name: str = "lens.yaml") -> Lens:
    (folder / name).write_text(text)
    return load_lens(folder / name)


def projected(coefficients: list[float]) -> FloatArray:
    none = np.zeros(3)
    points = cv2.projectPoints(POINTS, none, none, MATRIX, np.array(coefficients))[0]
    return np.asarray(points, dtype=float).reshape(-1, 2)


@pytest.mark.parametrize("count", [5, 8, 12, 14])
def test_the_rational_model_has_as_many_numbers_as_opencv_takes(tmp_path: Path, count: int) -> None:
    lens = loaded(tmp_path, yaml.safe_dump(ros(FOURTEEN[:count], distortion_model="rational_polynomial")))
    assert lens.model == "rational_polynomial"
    assert np.allclose(lens.pixels(POINTS), projected(FOURTEEN[:count]))
    assert np.allclose(lens.pixels(2 * lens.rays(np.array([[500.0, 100.0]]))), [[500, 100]], atol=1e-3)
    save_lens(lens, tmp_path / "again.yaml")
    assert load_lens(tmp_path / "again.yaml") == lens


@pytest.mark.parametrize("count", [0, 4, 5])
def test_plumb_bob_has_five_numbers_or_fewer(tmp_path: Path, count: int) -> None:
    lens = loaded(tmp_path, yaml.safe_dump(ros(FOURTEEN[:count], distortion_model="plumb_bob")))
    assert (lens.model, len(lens.distortion)) == ("plumb_bob", 5)
    assert np.allclose(lens.pixels(POINTS), projected(FOURTEEN[:count] or [0.0] * 4))


@pytest.mark.parametrize(
    ("name", "count", "model"),
    [
        ("plumb_bob", 5, "plumb_bob"),
        ("Brown Conrady", 5, "plumb_bob"),
        ("pinhole", 8, "rational_polynomial"),
        ("rational_polynomial", 14, "rational_polynomial"),
        ("fisheye", 4, "equidistant"),
        ("KANNALA_BRANDT4", 4, "equidistant"),
    ],
)
def test_the_model_may_be_the_camera_model(tmp_path: Path, name: str, count: int, model: str) -> None:
    lens = loaded(tmp_path, yaml.safe_dump(ros(FOURTEEN[:count], camera_model=name)))
    assert lens.model == model


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


def test_four_coefficients_without_a_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="distortion_model: plumb_bob, or distortion_model: equidistant"):
        loaded(tmp_path, yaml.safe_dump(ros(FOURTEEN[:4])))
    named = ros(FOURTEEN[:4], distortion_model="equidistant")
    assert loaded(tmp_path, yaml.safe_dump(named)).model == "equidistant"


@pytest.mark.parametrize(("name", "model"), [("radtan", "plumb_bob"), ("equidistant", "equidistant")])
def test_a_camchain_is_read(tmp_path: Path, name: str, model: str) -> None:
    camera = {
        "camera_model": "pinhole",
        "distortion_model": name,
        "distortion_coeffs": FOURTEEN[:4],
        "intrinsics": [701.2, 699.8, 331.4, 242.9],
        "resolution": [640, 480],
    }
    lens = loaded(tmp_path, yaml.safe_dump({"cam0": camera}))
    assert (lens.model, lens.size_px) == (model, (640, 480))
    assert np.allclose(lens.matrix, MATRIX)
    with pytest.raises(InputError, match="one camera"):
        loaded(tmp_path, yaml.safe_dump({"cam0": camera, "cam1": camera}))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<!DOCTYPE a><opencv_storage/>", "DOCTYPE"),
        ("<opencv_storage>", "is not XML"),
        (yaml.safe_dump(ros(FOURTEEN[:7])), "4, 5 for plumb_bob"),
        (yaml.safe_dump(ros(FOURTEEN[:6], distortion_model="rational_polynomial")), "5, 8, 12, 14"),
        (yaml.safe_dump(ros(FOURTEEN[:5], camera_model="omni")), "distortion_model"),
        (json.dumps({"cam0": {"intrinsics": [1, 2]}}), "4 numbers"),
        ("image_size: 5", "2 numbers"),
        ("{}", "image_width"),
    ],
)
def test_others_are_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        loaded(tmp_path, text)
