"""How noisy the corners of a tag are in the pictures of a camera, learned from what does not fit a square."""

import numpy as np

from hexctl.types import FloatArray

#: Standard deviation of a corner's coordinate, in px, that is believed at first, and never less: noise, blur,
#: and what is left of the lens's distortion.
CORNER_PX = 0.25

#: What is believed at first counts as so many pictures; so many pictures are remembered.
FIRST_PICTURES, MOST_PICTURES = 1.0, 20.0

#: A square that is fitted by place, turn and size leaves so many of the eight coordinates free.
_FREE = 4


class CornerNoise:
    """Standard deviation of a corner by the pictures so far; the last ones count most."""

    def __init__(self) -> None:
        self._variance_px2, self._pictures = CORNER_PX**2, FIRST_PICTURES

    @property
    def sigma_px(self) -> float:
        """Of each coordinate of a corner, `CORNER_PX` or more."""
        return max(CORNER_PX, float(np.sqrt(self._variance_px2)))

    def learn(self, misses_px: FloatArray) -> None:
        """Take in by how much the corners (4, 2) of one picture miss the square that fits them best."""
        self._pictures = min(self._pictures + 1, MOST_PICTURES)
        told_px2 = float(np.square(misses_px).sum()) / _FREE
        self._variance_px2 += (told_px2 - self._variance_px2) / self._pictures
