"""Pictures of the calibration board through a known lens."""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np

from hexctl.types import FloatArray
from hexctl.vision.detection.calibration_board import SQUARE_M, SQUARES, black_squares
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.tags import Picture

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
