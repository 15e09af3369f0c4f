from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import pytest

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.vision.detection.calibration_board import N_CORNERS, SQUARE_M, BoardFinder
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.sheet import PAPERS_MM, Sheet

PX_PER_MM = 4.0


def pages(sheet: Sheet) -> list[Picture]:
    """Pages as a PDF reader shows them."""
    with pypdfium2.PdfDocument(sheet.pdf()) as document:
        scale = PX_PER_MM * 25.4 / 72
        drawn = [page.render(scale=scale, grayscale=True).to_numpy() for page in document]
        return [np.array(page).reshape(page.shape[:2]) for page in drawn]


def edges_mm(tag: SeenTag) -> np.ndarray:
    """The four edges of a tag; the reader rounds pages to whole pixels, up to 0.1 %."""
    steps_px = tag.corners_px - np.roll(tag.corners_px, 1, axis=0)
    return np.asarray(np.hypot(*steps_px.T) / PX_PER_MM)


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


def test_around_each_tag_a_module_is_white() -> None:
    first, second, *_ = pages(Sheet())
    for page in (first, second):
        for tag in TagFinder().search(page, thorough=True).values():
            module_px = tag.edge_px / 8
            low, high = tag.corners_px.min(axis=0), tag.corners_px.max(axis=0)
            top, bottom = (round(at) for at in (low[1] - 0.9 * module_px, high[1] + 0.9 * module_px))
            left, right = (round(at) for at in (low[0] - 0.9 * module_px, high[0] + 0.9 * module_px))
            around = page[max(top, 0) : bottom, max(left, 0) : right].copy()
            inner = round(0.8 * module_px)
            around[inner:-inner, inner:-inner] = 255
            assert around.min() == 255


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


def test_the_same_sheet_is_the_same_file() -> None:
    assert Sheet().pdf() == Sheet().pdf()


def test_it_knows_the_edges_of_its_floor_tags() -> None:
    assert Sheet(floor_tags=2).floor_edges_mm == pytest.approx({0: 110, 1: 160, 2: 160})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"paper": "a3"}, "paper: got a3; allowed: a4, letter"),
        ({"robot_tag": 2}, "robot_tag: got 2; allowed: 4 to 586"),
        ({"robot_tag": 587}, "robot_tag: got 587"),
        ({"floor_tags": -1}, "floor_tags: got -1; allowed: 0..20"),
        ({"robot_edge_mm": 10.0}, "robot_edge_mm: got 10; allowed: 20 to 200 mm"),
        ({"floor_edge_mm": 200.0}, r"floor_edge_mm: got 200; allowed: 20 to \d+ mm on a4"),
        ({"home_edge_mm": float("nan")}, "home_edge_mm: got nan"),
    ],
)
def test_what_cannot_be_printed_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Sheet(**options)


def test_the_command_writes_the_file_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sheet.pdf"
    asked = ["see", "print", "--output", str(path), "--paper", "letter", "--robot-tag", "12"]
    assert exit_code(asked) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert path.read_bytes() == Sheet(paper="letter", robot_tag=12).pdf()
    assert exit_code(asked) == 2
    assert "exists; allowed: a new file" in capsys.readouterr().err
    assert exit_code(["see", "print", "--output", str(tmp_path / "none" / "sheet.pdf")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert exit_code(["see", "print", "--output", str(tmp_path / "x.pdf"), "--robot-tag", "1"]) == 2
    assert "--robot-tag: got 1" in capsys.readouterr().err
