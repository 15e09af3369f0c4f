"""Options of `hexctl see`: their ranges are those of the library."""

import pytest
import typer

from hexctl.cli.see import see_command, see_options, see_twin_command
from hexctl.vision.camera_options import LATENCIES_MS
from hexctl.vision.detection.tags import TAG_IDS
from hexctl.vision.place import BARS_MM
from hexctl.vision.twin import twin_camera


def test_ranges_are_those_of_the_library() -> None:
    assert (see_options.TAG.low, see_options.TAG.high) == (TAG_IDS[0], TAG_IDS[-1])
    assert (see_options.LATENCY_MS.low, see_options.LATENCY_MS.high) == LATENCIES_MS
    assert (see_options.FPS.low, see_options.FPS.high) == twin_camera.FPS
    assert (see_command.BAR_MM.low, see_command.BAR_MM.high) == BARS_MM
    assert (see_twin_command.NOISE.low, see_twin_command.NOISE.high) == twin_camera.NOISES
    assert (see_twin_command.BLUR_PX.low, see_twin_command.BLUR_PX.high) == twin_camera.BLURS_PX


def test_a_size_is_two_numbers() -> None:
    assert see_options.size_of("1280x720") == (1280, 720)
    for text in ("1280", "x", "1280x", "-1x2", "1.5x2"):
        with pytest.raises(typer.BadParameter, match="allowed: WIDTHxHEIGHT in px"):
            see_options.size_of(text)
