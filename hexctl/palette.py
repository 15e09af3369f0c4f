"""Colours that mean the same in the viewer and in the reports: green is straight, crimson is far off.

Lines and marks have a contrast of at least 3 to 1 (WCAG 2) on white and on `BACKGROUND`. Adjacent ones are
safe for colour blindness, mostly from Okabe and Ito (2008). The scale keeps its order in grey print.
"""

import math

import numpy as np

Color = tuple[int, int, int]

#: Final deviation of a walk in m, and its colour: blended over its logarithm, constant beyond the ends.
SCALE: tuple[tuple[float, Color], ...] = (
    (0.01, (0, 160, 110)),
    (0.025, (0, 150, 150)),
    (0.1, (0, 138, 180)),
    (0.3, (100, 105, 215)),
    (1.0, (170, 70, 180)),
    (3.0, (200, 50, 110)),
)

#: Deviations in a legend, in m.
LEGEND_M = tuple(mark for mark, _ in SCALE)

#: The grey of everything that does not count, for `BACKGROUND` and for white. Lighter shades use opacity.
GREY: Color = (120, 120, 124)

#: An invalid trial, the line of travel, the path of the body, and the best so far.
INVALID_COLOR: Color = GREY
LINE_COLOR: Color = (80, 140, 240)
PATH_COLOR: Color = (204, 130, 0)
BEST_COLOR: Color = (210, 95, 0)

#: Paths and horizontal lines of the baseline by gait, and of any other one.
BASELINE_COLORS: dict[str, Color] = {
    "auto": (130, 140, 230),
    "demo": GREY,
    "tripod": (150, 30, 255),
}
OTHER_BASELINE_COLOR: Color = (0, 158, 115)

#: One for each leg, from leg 1 on, and the alarm level of the evidence.
LEG_COLORS: tuple[Color, ...] = (
    (0, 120, 180),
    (210, 90, 0),
    (0, 165, 120),
    (150, 30, 255),
    (150, 120, 255),
    (135, 105, 135),
)
ALARM_COLOR: Color = (225, 0, 75)

#: Commanded and measured angle of each joint, one hue per joint, and the stability margin.
JOINT_COLORS: dict[str, tuple[Color, Color]] = {
    "coxa": ((60, 80, 250), (130, 140, 230)),
    "femur": ((180, 90, 30), (230, 100, 20)),
    "tibia": ((20, 130, 90), (10, 170, 100)),
}
MARGIN_COLOR: Color = (0, 158, 115)

#: Verdicts on a claim, by their first words; any other one is an empty square.
VERDICT_COLORS: dict[str, Color] = {
    "holds": (0, 110, 170),
    "does not hold": (213, 94, 0),
    "no evidence": GREY,
}

#: Optimizers of a study, and any other one: the five colours of Okabe and Ito dark enough for
#: white, and the wine red of Tol's muted set.
OPTIMIZER_COLORS: dict[str, Color] = {
    "pso": (0, 114, 178),
    "psosp": (0, 114, 178),
    "dps": (0, 158, 115),
    "debest": (213, 94, 0),
    "derand": (204, 121, 167),
    "random": (0, 0, 0),
    "exhaustive": (0, 0, 0),
    "bayes": (136, 34, 85),
    "bayes-early": (136, 34, 85),
}
OTHER_OPTIMIZER_COLORS: tuple[Color, ...] = ((0, 114, 178), (213, 94, 0), (0, 158, 115))

#: Lengths of dashes and gaps of their lines, in line widths, which differ within a colour. Others are solid.
OPTIMIZER_DASHES: dict[str, tuple[float, ...]] = {
    "psosp": (3.7, 1.6),
    "random": (3.7, 1.6),
    "exhaustive": (3.7, 1.2, 1.0, 1.2, 1.0, 1.2),
    "bayes-early": (3.7, 1.6),
}
OTHER_OPTIMIZER_DASHES = (5.0, 1.2, 2.0, 1.2)

#: Reference bars of results, and the best of all gaits.
BAR_COLOR: Color = (192, 57, 43)
BEST_OF_ALL_COLOR: Color = GREY

#: Background of every scene of the viewer, and of its texts and rules. Text panels have the background of
#: the theme: dark grey, or a medium grey in the light theme.
BACKGROUND: Color = (24, 28, 36)
TEXT_COLOR: Color = (255, 255, 255)
AXIS_COLOR: Color = (46, 53, 65)

#: A robot's trunk and links by joint kind, and the floor: in recordings, robot descriptions and pictures.
BODY_COLOR: Color = (58, 110, 165)
LINK_COLORS: dict[str, Color] = {"coxa": (126, 144, 164), "femur": (186, 198, 212), "tibia": (226, 232, 240)}
#: Links of a failed leg, and of one that only the walk considers failed.
FAILED_COLORS: dict[str, Color] = {"coxa": (190, 44, 30), "femur": (226, 66, 42), "tibia": (246, 98, 66)}
NOTICED_COLORS: dict[str, Color] = {"coxa": (204, 138, 0), "femur": (255, 176, 0), "tibia": (255, 204, 90)}
GROUND_COLOR: Color = (52, 60, 70)

#: Target bands: half width in m, colour on the dark background, and name; the widest is drawn first.
TARGET_BANDS: tuple[tuple[float, Color, str], ...] = (
    (0.10, (38, 58, 62), "±10 cm"),
    (0.025, (50, 92, 88), "±2.5 cm"),
)


def deviation_color(deviation_m: float | None, *, valid: bool) -> Color:
    """Colour of a trial by its final deviation to either side; grey if invalid or unknown."""
    if not valid or deviation_m is None or not math.isfinite(deviation_m):
        return INVALID_COLOR
    place = np.log(max(abs(deviation_m), LEGEND_M[0]))
    red, green, blue = (
        round(np.interp(place, np.log(LEGEND_M), [color[channel] for _, color in SCALE]))
        for channel in range(3)
    )
    return red, green, blue


def baseline_color(gait: str) -> Color:
    """Colour of a gait of the baseline, by its name."""
    return BASELINE_COLORS.get(gait, OTHER_BASELINE_COLOR)


def scale_stops() -> list[tuple[float, str]]:
    """Stops of the scale for a colour map: place 0..1 on the logarithm of the deviation, and colour."""
    low, high = math.log(LEGEND_M[0]), math.log(LEGEND_M[-1])
    return [((math.log(mark) - low) / (high - low), hex_color(color)) for mark, color in SCALE]


def hex_color(color: Color) -> str:
    """Colour as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*color)
