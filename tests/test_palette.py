"""One palette for the viewer and the reports."""

from itertools import combinations

import numpy as np
import pytest

from hexctl import palette
from hexctl.palette import Color, deviation_color
from hexctl.types import FloatArray

WHITE: Color = (255, 255, 255)

#: What Rerun writes labels on, over a dark scene and over the floor in it: in the dark theme, and in the
#: light one, where it lays white of half opacity over the scene.
LABELS: tuple[Color, ...] = ((34, 36, 40), (124, 126, 130), (138, 142, 147))

#: The lines and marks of the viewer and of the reports, by what they show.
LINES: dict[str, tuple[Color, ...]] = {
    "deviation": tuple(color for _, color in palette.SCALE),
    "invalid": (palette.INVALID_COLOR,),
    "line of travel, way, best": (palette.LINE_COLOR, palette.PATH_COLOR, palette.BEST_COLOR),
    "baseline": (*palette.BASELINE_COLORS.values(), palette.OTHER_BASELINE_COLOR),
    "legs": (*palette.LEG_COLORS, palette.ALARM_COLOR),
    "commanded": tuple(commanded for commanded, _ in palette.JOINT_COLORS.values()),
    "measured": tuple(measured for _, measured in palette.JOINT_COLORS.values()),
    "margin": (palette.MARGIN_COLOR,),
    "verdicts": tuple(palette.VERDICT_COLORS.values()),
}

#: Those that stand beside one another in one view, and are told apart by their colour alone.
TOGETHER = {
    "legs": LINES["legs"],
    "commanded": LINES["commanded"],
    "measured": LINES["measured"],
    "verdicts": LINES["verdicts"],
    "curve": (*palette.BASELINE_COLORS.values(), palette.BEST_COLOR),
    "scene": (palette.LINE_COLOR, palette.PATH_COLOR),
    "conditions of a leg": tuple(
        links["femur"] for links in (palette.LINK_COLORS, palette.FAILED_COLORS, palette.NOTICED_COLORS)
    ),
}

#: What the three kinds of colour blindness make of linear red, green and blue (Machado et al. 2009).
BLINDNESS = {
    "none": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}

#: Linear red, green and blue as CIE X, Y and Z, relative to white (sRGB, D65).
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
XYZ_OF_WHITE = TO_XYZ.sum(axis=1)

#: Differences in CIE L*a*b* (1976) at which two lines of a legend are told apart with ease; 2.3 is just seen.
APART = 16.0


def linear(color: Color) -> FloatArray:
    """Linear red, green and blue, 0..1."""
    share = np.array(color) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def luminance(color: Color) -> float:
    """Relative luminance after WCAG 2."""
    return float(linear(color) @ [0.2126, 0.7152, 0.0722])


def lab(color: Color, seen: FloatArray) -> FloatArray:
    """CIE L*, a* and b* of a colour as it is seen."""
    xyz = TO_XYZ @ np.clip(seen @ linear(color), 0, 1) / XYZ_OF_WHITE
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def contrast(one: Color, other: Color) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("what", LINES)
def test_lines_are_seen_in_the_light_and_in_the_dark(what: str) -> None:
    for color in LINES[what]:
        assert contrast(color, WHITE) >= 3, color
        assert contrast(color, palette.BACKGROUND) >= 3, color


def test_lines_of_reports_are_seen_on_paper() -> None:
    bars = (palette.BAR_COLOR, palette.BEST_OF_ALL_COLOR)
    for color in (*palette.OPTIMIZER_COLORS.values(), *palette.OTHER_OPTIMIZER_COLORS, *bars):
        assert contrast(color, WHITE) >= 3, color


def test_labels_are_read_in_both_themes() -> None:
    assert min(contrast(palette.TEXT_COLOR, label) for label in LABELS) >= 3


def difference(one: Color, other: Color, kind: str) -> float:
    """Difference of two colours as they are seen."""
    return float(np.linalg.norm(lab(one, BLINDNESS[kind]) - lab(other, BLINDNESS[kind])))


@pytest.mark.parametrize("kind", BLINDNESS)
@pytest.mark.parametrize("view", TOGETHER)
def test_what_stands_together_is_told_apart_with_colour_blindness(view: str, kind: str) -> None:
    for one, other in combinations(TOGETHER[view], 2):
        assert difference(one, other, kind) >= APART, (one, other)


@pytest.mark.parametrize("kind", BLINDNESS)
def test_optimizers_are_told_apart_by_their_colours_or_by_the_dashes_of_one_colour(kind: str) -> None:
    for one, other in combinations(palette.OPTIMIZER_COLORS, 2):
        if palette.OPTIMIZER_COLORS[one] == palette.OPTIMIZER_COLORS[other]:
            assert palette.OPTIMIZER_DASHES.get(one) != palette.OPTIMIZER_DASHES.get(other), (one, other)
        else:
            assert (
                difference(palette.OPTIMIZER_COLORS[one], palette.OPTIMIZER_COLORS[other], kind) >= APART
            ), (one, other)
    assert palette.OTHER_OPTIMIZER_DASHES not in palette.OPTIMIZER_DASHES.values()
    for pair in combinations(palette.OTHER_OPTIMIZER_COLORS, 2):
        assert difference(*pair, kind) >= APART, pair


def test_a_gait_without_a_search_has_its_colour_by_name() -> None:
    assert [palette.baseline_color(name) for name in palette.BASELINE_COLORS] == list(
        palette.BASELINE_COLORS.values()
    )
    assert palette.baseline_color("1,2,3,4,5,6") == palette.OTHER_BASELINE_COLOR


def test_colours_of_deviations() -> None:
    luminances = [luminance(deviation_color(off_m, valid=True)) for off_m in palette.LEGEND_M]
    assert luminances == sorted(luminances, reverse=True)
    red, green, blue = deviation_color(0.0, valid=True)
    assert green > max(red, blue)
    red, green, blue = deviation_color(-9.0, valid=True)
    assert red > max(green, blue)
    assert deviation_color(-0.3, valid=True) == deviation_color(0.3, valid=True)


def test_what_does_not_count_is_grey() -> None:
    for unknown in (None, float("nan"), float("inf")):
        assert deviation_color(unknown, valid=True) == palette.INVALID_COLOR
    assert deviation_color(0.1, valid=False) == palette.INVALID_COLOR
