import numpy as np

from hexctl.vision.detection.calibration_board import (
    N_CORNERS,
    SQUARE_M,
    BoardFinder,
    black_squares,
    charuco_board,
)
from hexctl.vision.detection.tags import TagFinder

PX_PER_M = 4000


def printed_board() -> np.ndarray:
    """Picture of the board, drawn from its squares, with a white edge of 100 px."""
    columns, rows = (round(count * SQUARE_M * PX_PER_M) for count in (7, 9))
    picture = np.full((rows + 200, columns + 200), 235, dtype=np.uint8)
    for left, top, edge in black_squares():
        first_row, first_column = (round(100 + at * PX_PER_M) for at in (top, left))
        last_row, last_column = (round(100 + (at + edge) * PX_PER_M) for at in (top, left))
        picture[first_row:last_row, first_column:last_column] = 20
    return picture


def test_the_squares_are_those_of_opencvs_picture() -> None:
    drawn = printed_board()[100:-100, 100:-100]
    expected = charuco_board().generateImage(drawn.shape[::-1], marginSize=0)
    assert ((drawn < 128) != (expected < 128)).mean() < 0.01


def test_all_corners_of_a_print_are_found_where_they_are() -> None:
    seen = BoardFinder().find(printed_board())
    assert seen is not None
    assert seen.corner_ids.tolist() == list(range(N_CORNERS))
    assert np.allclose(seen.corners_px, 100 - 0.5 + seen.corners_m[:, :2] * PX_PER_M, atol=0.3)


def test_a_picture_without_a_board_has_none() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    assert BoardFinder().find(noise) is None


def test_its_markers_are_not_taken_for_tags() -> None:
    assert TagFinder().search(printed_board(), thorough=True) == {}
