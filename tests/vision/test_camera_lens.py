"""A lens calibrated from Python. The command is in tests/cli/test_see.py."""

from pathlib import Path
from typing import Any

import cv2
import pytest

from hexctl.errors import InputError, RobotFaultError
from hexctl.vision.camera_lens import CameraLens
from hexctl.vision.detection.lens import load_lens
from hexctl.vision.video import video_source
from tests.vision.detection.test_lens_calibration import LENSES, pictures, ray_error_px


def board_files(folder: Path, count: int) -> list[Path]:
    """Files of pictures of the board, in a folder."""
    files = [folder / f"board{number}.png" for number in range(count)]
    for file, picture in zip(files, pictures("480p"), strict=False):
        cv2.imwrite(str(file), picture)
    return files


@pytest.mark.slow
def test_pictures_become_the_file_of_a_lens(tmp_path: Path) -> None:
    calibrated = CameraLens(pictures=board_files(tmp_path, 20), output=str(tmp_path / "lens.yaml")).run()
    assert calibrated.missing == ()
    assert load_lens(tmp_path / "lens.yaml") == calibrated.lens
    assert ray_error_px(LENSES["480p"], calibrated.lens) < 0.5


def test_too_few_pictures_are_refused_and_write_nothing(tmp_path: Path) -> None:
    said: list[str] = []
    files = board_files(tmp_path, 3)
    with pytest.raises(InputError, match="got 3 pictures of the board that differ"):
        CameraLens(pictures=[*files, files[0]], output=tmp_path / "lens.yaml").run(on_event=said.append)
    assert said == [f"{files[0]} is left out: too alike"]
    assert not (tmp_path / "lens.yaml").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "got pictures and camera, or neither; allowed: pictures, or camera"),
        ({"pictures": ["a.png"], "camera": 0}, "got pictures and camera, or neither"),
        (
            {"pictures": ["a.png"], "size_px": (640, 480)},
            "size_px: got one with pictures; allowed: with camera",
        ),
        (
            {"camera": 0, "output": "none/lens.yaml"},
            "output: got none/lens.yaml; allowed: a folder",
        ),
    ],
)
def test_bad_options_are_refused(
    options: dict[str, Any], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said):
        CameraLens(**options)


def test_a_file_that_exists_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").touch()
    with pytest.raises(InputError, match=r"lens\.yaml exists"):
        CameraLens(camera=0, output=tmp_path / "lens.yaml")


def test_a_picture_of_another_size_is_told_by_its_name(tmp_path: Path) -> None:
    files = board_files(tmp_path, 2)
    cv2.imwrite(str(files[1]), cv2.rotate(next(iter(pictures("480p"))), cv2.ROTATE_90_CLOCKWISE))
    with pytest.raises(InputError, match=r"board1\.png: got a picture of 480x640 px after one of 640x480"):
        CameraLens(pictures=files, output=tmp_path / "lens.yaml").run()


def test_a_camera_is_asked_for_size_and_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, dict[str, Any]]] = []

    def opened(source: str, **options: Any) -> None:
        asked.append((source, options))
        raise RobotFaultError("no camera")

    monkeypatch.setattr(video_source, "open_video", opened)
    with pytest.raises(RobotFaultError, match="no camera"):
        CameraLens(camera=0, output=tmp_path / "lens.yaml", size_px=(1280, 720), fps=15).run()
    (source, options) = asked[0]
    assert (source, options["size_px"], options["fps"]) == ("0", (1280, 720), 15)
