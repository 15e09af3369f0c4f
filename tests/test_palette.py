"""One palette for the viewer and the reports."""

import numpy as np
import pytest

from hexctl.palette import (
    BACKGROUND,
    BASELINE_COLORS,
    INVALID_COLOR,
    LEGEND_M,
    LINE_COLOR,
    SCALE,
    Color,
    deviation_color,
)

WHITE: Color = (255, 255, 255)


def luminance(color: Color) -> float:
    """Relative luminance after WCAG 2."""
    share = np.array(color) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one: Color, other: Color) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_every_colour_is_readable_on_white_and_on_dark() -> None:
    for color in (*(color for _, color in SCALE), INVALID_COLOR, *BASELINE_COLORS):
        assert contrast(color, WHITE) >= 3, color
        assert contrast(color, BACKGROUND) >= 3, color
    assert min(contrast(LINE_COLOR, WHITE), contrast(LINE_COLOR, BACKGROUND)) >= 2.5


def test_luminance_falls_with_the_deviation() -> None:
    luminances = [luminance(deviation_color(off_m, valid=True)) for off_m in LEGEND_M]
    assert luminances == sorted(luminances, reverse=True)


def test_straight_is_green_and_far_off_is_red() -> None:
    red, green, blue = deviation_color(0.0, valid=True)
    assert green > max(red, blue)
    red, green, blue = deviation_color(-9.0, valid=True)
    assert red > max(green, blue)
    assert deviation_color(-0.3, valid=True) == deviation_color(0.3, valid=True)


@pytest.mark.parametrize("unknown", [None, float("nan"), float("inf")])
def test_what_does_not_count_is_grey(unknown: float | None) -> None:
    assert deviation_color(unknown, valid=True) == INVALID_COLOR
    assert deviation_color(0.1, valid=False) == INVALID_COLOR
