"""Options of a camera, the printed sheet, and a lens calibrated from Python."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.vision.camera_lens import CameraLens
from hexctl.vision.camera_options import CameraOptions, parse_size
from hexctl.vision.detection.calibration_board import N_CORNERS, SQUARE_M, BoardFinder
from hexctl.vision.detection.lens import load_lens
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.robot_camera import RobotCamera
from hexctl.vision.sheet import PAPERS_MM, Sheet, save_sheet
from tests.vision.detection.test_lens_calibration import LENSES, pictures, ray_error_px


def test_a_size_is_two_numbers() -> None:
    assert parse_size("1280x720") == (1280, 720)
    for text in ("1280", "x", "1280x", "-1x2", "1.5x2"):
        with pytest.raises(ValueError, match="WIDTHxHEIGHT"):
            parse_size(text)


def board_files(folder: Path, count: int) -> list[Path]:
    """Files of pictures of the board, in a folder."""
    import cv2

    files = [folder / f"board{number}.png" for number in range(count)]
    for file, picture in zip(files, pictures("480p"), strict=False):
        cv2.imwrite(str(file), picture)
    return files


@pytest.mark.slow
def test_pictures_become_the_file_of_a_lens(tmp_path: Path) -> None:
    import cv2

    calibrated = CameraLens(pictures=board_files(tmp_path, 20), output=str(tmp_path / "lens.yaml")).run()
    assert calibrated.missing == ()
    assert load_lens(tmp_path / "lens.yaml") == calibrated.lens
    assert ray_error_px(LENSES["480p"], calibrated.lens) < 0.5
    files = board_files(tmp_path, 3)
    cv2.imwrite(str(tmp_path / "turned.png"), cv2.rotate(pictures("480p")[0], cv2.ROTATE_90_CLOCKWISE))
    for given, named in (([*files, files[0]], "pictures"), ([*files, tmp_path / "turned.png"], "turned.png")):
        with pytest.raises(InputError, match=named):
            CameraLens(pictures=given, output=tmp_path / "other.yaml").run()
    assert not (tmp_path / "other.yaml").exists()


PX_PER_MM = 4.0


def pages(sheet: Sheet) -> list[Picture]:
    """Pages as a PDF reader shows them."""
    import pypdfium2

    with pypdfium2.PdfDocument(sheet.pdf()) as document:
        scale = PX_PER_MM * 25.4 / 72
        drawn = [page.render(scale=scale, grayscale=True).to_numpy() for page in document]
        return [np.array(page).reshape(page.shape[:2]) for page in drawn]


def edges_mm(tag: SeenTag) -> np.ndarray:
    """The four edges of a tag; the reader rounds pages to whole pixels, up to 0.1 %."""
    steps_px = tag.corners_px - np.roll(tag.corners_px, 1, axis=0)
    return np.asarray(np.hypot(*steps_px.T) / PX_PER_MM)


@pytest.mark.slow
@pytest.mark.parametrize("paper", PAPERS_MM)
def test_each_tag_is_on_its_page_upright_and_in_its_size(paper: Any) -> None:
    first, *further, board = pages(Sheet(paper=paper))
    assert first.shape == pytest.approx([side * PX_PER_MM for side in PAPERS_MM[paper][::-1]], abs=1)
    found = TagFinder().search(first, thorough=True)
    assert set(found) == {0, 10}
    assert edges_mm(found[10]) == pytest.approx(100, abs=0.3)
    assert edges_mm(found[0]) == pytest.approx(110, abs=0.3)
    for tag_id, page in enumerate(further, start=1):
        found |= (alone := TagFinder().search(page, thorough=True))
        assert set(alone) == {tag_id}
        assert edges_mm(alone[tag_id]) == pytest.approx(160, abs=0.3)
    for tag in found.values():
        lower_left, lower_right, _, upper_left = tag.corners_px
        assert lower_right - lower_left == pytest.approx([edges_mm(tag)[0] * PX_PER_MM, 0], abs=1)
        assert upper_left[1] < lower_left[1]
    assert len(further) == 3
    seen = BoardFinder().find(board)
    assert seen is not None
    assert len(seen.corner_ids) == N_CORNERS
    steps_mm = np.diff(seen.corners_px[:6, 0]) / PX_PER_MM
    assert steps_mm == pytest.approx(1000 * SQUARE_M, abs=0.1)


def test_the_bar_is_100_mm_long() -> None:
    for page in pages(Sheet())[1:]:
        low = page[round(-30 * PX_PER_MM) : round(-6 * PX_PER_MM)]
        # The longest row of ink is the bar.
        lengths = [np.ptp(np.flatnonzero(row < 128)) if (row < 128).mean() > 0.4 else 0 for row in low]
        assert max(lengths) / PX_PER_MM == pytest.approx(100, abs=0.6)


def test_a_large_tag_has_a_page_of_its_own() -> None:
    first, second, *further = pages(Sheet(robot_edge_mm=150, floor_tags=0))
    assert set(TagFinder().search(first)) == {10}
    assert set(TagFinder().search(second)) == {0}
    assert len(further) == 1
    assert Sheet().pdf() == Sheet().pdf()


def test_the_command_writes_the_file_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sheet.pdf"
    asked = ["see", "print", "--output", str(path), "--paper", "letter", "--robot-tag", "12"]
    assert exit_code(asked) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert path.read_bytes() == Sheet(paper="letter", robot_tag=12).pdf()
    assert exit_code(asked) == 2
    assert exit_code(["see", "print", "--output", str(tmp_path / "none" / "sheet.pdf")]) == 2
    assert exit_code(["see", "print", "--output", str(tmp_path / "x.pdf"), "--robot-tag", "1"]) == 2
    assert "--robot-tag" in capsys.readouterr().err


def test_a_sheet_with_a_name_that_no_disk_takes_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / (300 * "x"), tmp_path / (300 * "x") / "sheet.pdf"):
        with pytest.raises(InputError, match="output"):
            save_sheet(Sheet(), path)


@pytest.mark.parametrize(
    ("make", "options", "named"),
    [
        *[
            (RobotCamera, {"camera": 0, "page": page}, "page")
            for page in ("0.0.0.0:8019", "robot.local:8019")
        ],
        *[(RobotCamera, {"camera": 0, "page": page}, "page") for page in ("8019:", "70000", -1)],
        (RobotCamera, {"camera": 63, "output": "there.yaml"}, "exists"),
        (RobotCamera, {"camera": 63, "poses": "gone/file"}, "poses"),
        (RobotCamera, {"camera": 63, "place": "gone/file"}, "place"),
        (RobotCamera, {"camera": 63, "robot_tag": 2}, "robot_tag"),
        (RobotCamera, {"camera": 63, "latency_ms": 2001.0}, "latency_ms"),
        (CameraOptions, {}, "camera"),
        (CameraOptions, {"camera": 0, "place": 5}, "place"),
        (CameraLens, {}, "pictures"),
        (CameraLens, {"pictures": ["a.png"], "camera": 0}, "pictures"),
        (CameraLens, {"pictures": ["a.png"], "size_px": (640, 480)}, "size_px"),
        (CameraLens, {"camera": 0, "output": "none/lens.yaml"}, "output"),
        (CameraLens, {"camera": 0, "output": "there.yaml"}, "there.yaml"),
        (Sheet, {"paper": "a3"}, "paper"),
        (Sheet, {"robot_tag": 2}, "robot_tag"),
        (Sheet, {"robot_tag": 587}, "robot_tag"),
        (Sheet, {"floor_edge_mm": 200.0}, "floor_edge_mm"),
        (Sheet, {"home_edge_mm": float("nan")}, "home_edge_mm"),
    ],
)
def test_what_cannot_be_is_refused_by_name(
    make: Callable[..., object],
    options: dict[str, Any],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").touch()
    with pytest.raises(InputError, match=named):
        make(**options)
