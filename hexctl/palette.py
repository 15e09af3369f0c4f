"""The colour of a deviation: bright is straight. Told apart by every kind of eye (after viridis)."""

import numpy as np

Color = tuple[int, int, int]

#: Deviation in m, and its colour; in between they blend, beyond the last it stays.
SCALE: tuple[tuple[float, Color], ...] = (
    (0.0, (253, 231, 37)),
    (0.1, (160, 218, 57)),
    (0.25, (53, 183, 121)),
    (0.5, (38, 140, 142)),
    (1.0, (82, 112, 190)),
    (1.5, (136, 84, 178)),
)

#: The marks of the legend, in m.
LEGEND_M = tuple(mark for mark, _ in SCALE)

INVALID_COLOR: Color = (120, 120, 124)
BEST_COLOR: Color = (255, 255, 255)
TEXT_COLOR: Color = (170, 180, 194)
LINE_COLOR: Color = (120, 170, 255)
AXIS_COLOR: Color = (46, 53, 65)

#: Target bands: half width in m, colour, and name; the widest is drawn first.
TARGET_BANDS: tuple[tuple[float, Color, str], ...] = (
    (0.10, (38, 58, 62), "±10 cm"),
    (0.025, (50, 92, 88), "±2.5 cm"),
)


def deviation_color(deviation_m: float | None, *, valid: bool) -> Color:
    """Return the colour of a trial that ended so far off the line, on either side."""
    if not valid or deviation_m is None or not np.isfinite(deviation_m):
        return INVALID_COLOR
    off_m = abs(deviation_m)
    red, green, blue = (
        round(np.interp(off_m, LEGEND_M, [color[channel] for _, color in SCALE])) for channel in range(3)
    )
    return red, green, blue
