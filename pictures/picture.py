"""Screenshots as arrays, and measures on them."""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hexctl.palette import GREY, hex_color

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Color = tuple[int, int, int]

#: Lines and texts of a figure that is read on white and in the dark.
INK = hex_color(GREY)

#: How far each of red, green and blue may be off for a colour to be another's: smoothing, shading.
NEAR = 40

#: A screen with fewer colours has nothing on it.
BLANK_COLORS = 24


#: Settings of matplotlib for such a figure.
READABLE = {
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 12.0,
    "legend.frameon": False,
    "lines.linewidth": 2.5,
}


def save_svg(figure: "Figure", path: Path) -> Path:
    """Write a figure with a transparent background, the same bytes each time."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.hashsalt": path.name}):
        figure.savefig(path, transparent=True, metadata={"Date": None, "Creator": None})
    return path


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture: (height, width, 3), red, green, blue."""

    pixels: NDArray[np.uint8]

    @classmethod
    def from_png(cls, data: bytes) -> Self:
        """Picture from the bytes of a PNG file."""
        with Image.open(BytesIO(data)) as image:
            return cls(np.asarray(image.convert("RGB")))

    @property
    def blank(self) -> bool:
        """Whether the picture has fewer than BLANK_COLORS colours."""
        return len(np.unique(self._packed())) < BLANK_COLORS

    @property
    def filled(self) -> float:
        """Share of the pixels that differ from the most frequent colour."""
        _, counts = np.unique(self._packed(), return_counts=True)
        return 1.0 - float(counts.max()) / float(counts.sum())

    def share(self, color: Color, near: int = NEAR) -> float:
        """Share of the pixels near a colour."""
        return float(np.mean(self._has(color, near)))

    def middle(self, color: Color, near: int = NEAR) -> NDArray[np.float64]:
        """Centroid (x, y) in pixels of the pixels near a colour."""
        rows, columns = np.nonzero(self._has(color, near))
        return np.array([columns.mean(), rows.mean()])

    def difference(self, other: "Picture") -> float:
        """Share of the pixels that differ visibly; 1 for another size."""
        if self.pixels.shape != other.pixels.shape:
            return 1.0
        apart = np.abs(self.pixels.astype(np.int16) - other.pixels.astype(np.int16)).max(axis=2)
        return float(np.mean(apart > NEAR / 2))

    def cut(self, left: int, top: int, width: int, height: int) -> "Picture":
        """A rectangle of the picture."""
        return Picture(self.pixels[top : top + height, left : left + width])

    def save(self, path: Path) -> None:
        """Write it as a small PNG file."""
        Image.fromarray(self.pixels).save(path, optimize=True)

    def _packed(self) -> NDArray[np.uint32]:
        """One number per pixel."""
        packed: NDArray[np.uint32] = self.pixels.astype(np.uint32) @ np.array(
            [1 << 16, 1 << 8, 1], dtype=np.uint32
        )
        return packed

    def _has(self, color: Color, near: int) -> NDArray[np.bool_]:
        apart = np.abs(self.pixels.astype(np.int16) - np.array(color, dtype=np.int16))
        has: NDArray[np.bool_] = apart.max(axis=2) <= near
        return has
