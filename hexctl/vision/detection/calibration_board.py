"""The board by which a lens is calibrated: a chessboard with a marker in each white square (ChArUco).

Its markers are of another family than the tags on robot and floor, so that neither is taken for the other.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.tags import Picture

#: Squares from left to right and from top to bottom; fits on A4 and on Letter.
SQUARES = (7, 9)

SQUARE_M = 0.025

MARKER_M = 0.019

#: Modules along the edge of a marker's black square.
MARKER_MODULES = 6

#: Corners between four squares, of which a picture may show a part.
N_CORNERS = (SQUARES[0] - 1) * (SQUARES[1] - 1)


@dataclass(frozen=True, slots=True, eq=False)
class SeenBoard(ArrayFields):
    """The corners of the board that a picture shows.

    Attributes:
        corner_ids: (N,), row by row from the top left.
        corners_px: (N, 2); the middle of the first pixel is (0, 0).
        corners_m: (N, 3) on the board, z = 0.
    """

    corner_ids: NDArray[np.int32]
    corners_px: FloatArray
    corners_m: FloatArray


def charuco_board() -> Any:
    """The board as OpenCV describes it."""
    import cv2

    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard(SQUARES, SQUARE_M, MARKER_M, markers)


def black_squares() -> list[tuple[float, float, float]]:
    """Black squares of the board, as (left, top, edge) in m from its top left corner."""
    import cv2

    board = charuco_board()
    marked = {tuple(np.floor(corners[0, :2] / SQUARE_M).astype(int)) for corners in board.getObjPoints()}
    columns, rows = SQUARES
    squares = [
        (column * SQUARE_M, row * SQUARE_M, SQUARE_M)
        for row in range(rows)
        for column in range(columns)
        if (column, row) not in marked
    ]
    module_m = MARKER_M / MARKER_MODULES
    for number, corners in zip(board.getIds().ravel(), board.getObjPoints(), strict=True):
        modules = cv2.aruco.generateImageMarker(board.getDictionary(), int(number), MARKER_MODULES) < 128
        left, top = (float(value) for value in corners[0, :2])
        squares += [
            (left + column * module_m, top + row * module_m, module_m)
            for row, column in np.argwhere(modules).tolist()
        ]
    return squares


class BoardFinder:
    """Finds the board in pictures. Not for several threads."""

    def __init__(self) -> None:
        import cv2

        self._board = charuco_board()
        detection = cv2.aruco.DetectorParameters()
        detection.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._detector = cv2.aruco.CharucoDetector(self._board, cv2.aruco.CharucoParameters(), detection)

    def find(self, gray: Picture) -> SeenBoard | None:
        """The board in a grey picture (H, W), or None where fewer than four corners are seen."""
        corners_px, corner_ids, _, _ = self._detector.detectBoard(gray)
        if corner_ids is None or len(corner_ids) < 4:
            return None
        ids = np.ravel(corner_ids).astype(np.int32)
        corners_m = np.asarray(self._board.getChessboardCorners(), dtype=float)[ids]
        return SeenBoard(ids, np.asarray(corners_px, dtype=float).reshape(-1, 2), corners_m)
