"""Options of `hexctl see`: their ranges are those of the library."""

import pytest
import typer

from hexctl.cli.see import look, options, twin
from hexctl.see.options import LATENCIES_MS
from hexctl.see.place import BARS_MM
from hexctl.see.twin import twin_camera
from hexctl.see.vision.tags import TAG_IDS


def test_ranges_are_those_of_the_library() -> None:
    assert (options.TAG.low, options.TAG.high) == (TAG_IDS[0], TAG_IDS[-1])
    assert (options.LATENCY_MS.low, options.LATENCY_MS.high) == LATENCIES_MS
    assert (options.FPS.low, options.FPS.high) == twin_camera.FPS
    assert (look.BAR_MM.low, look.BAR_MM.high) == BARS_MM
    assert (twin.NOISE.low, twin.NOISE.high) == twin_camera.NOISES
    assert (twin.BLUR_PX.low, twin.BLUR_PX.high) == twin_camera.BLURS_PX


def test_a_size_is_two_numbers() -> None:
    assert options.size_of("1280x720") == (1280, 720)
    for text in ("1280", "x", "1280x", "-1x2", "1.5x2"):
        with pytest.raises(typer.BadParameter, match="allowed: WIDTHxHEIGHT in px"):
            options.size_of(text)
