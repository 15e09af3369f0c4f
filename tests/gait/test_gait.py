"""Gaits and motions refuse what cannot be walked, and know their code."""

import math

import pytest

from hexctl.errors import InputError
from hexctl.gait.gait import Gait, Motion, half_amplitude_turn_rate_rad_s
from hexctl.gait.named import NAMED_SLOTS
from tests.robots import shipped

GOOD = {"slots": (1, 4, 2, 6, 3, 5), "pace_hz": 0.9, "amplitude": 0.11, "height": 0.02}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"slots": (1, 2, 3)}, "slots.*six numbers, each 1..6"),
        ({"slots": (0, 1, 2, 3, 4, 5)}, "slots.*each 1..6"),
        ({"slots": (1, 2, 3, 4, 5, 7)}, "slots.*each 1..6"),
        ({"pace_hz": 0}, "pace: got 0; allowed: above 0 up to 10 Hz"),
        ({"pace_hz": -0.5}, "pace: got -0.5"),
        ({"pace_hz": math.nan}, "pace: got nan"),
        ({"pace_hz": math.inf}, "pace: got inf"),
        ({"pace_hz": 11}, "pace: got 11"),
        ({"amplitude": 0}, "amplitude: got 0; allowed: above 0 up to 1 of the robot's size"),
        ({"amplitude": 1.1}, "amplitude: got 1.1"),
        ({"amplitude": math.nan}, "amplitude: got nan"),
        ({"height": -0.1}, "height: got -0.1"),
        ({"height": math.inf}, "height: got inf"),
    ],
)
def test_a_gait_refuses_what_cannot_be_walked(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Gait(**{**GOOD, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"heading_rad": math.nan}, "heading nan"),
        ({"turn_rate_rad_s": math.inf}, "turn inf"),
        ({"travel": -0.1}, "travel: got -0.1; allowed: 0..1"),
        ({"travel": 1.5}, "travel: got 1.5"),
        ({"travel": math.nan}, "travel: got nan"),
    ],
)
def test_a_motion_refuses_what_is_no_direction(change: dict[str, float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Motion(**change)


def test_a_gait_knows_its_code_where_it_has_one() -> None:
    def gait(slots: tuple[int, ...]) -> Gait:
        return Gait(slots=slots, pace_hz=0.9, amplitude=0.11, height=0.02)

    assert gait((1, 2, 3, 4, 5, 6)).code() == 1
    assert gait((5, 1, 2, 4, 3, 6)).code() == 483
    assert gait(NAMED_SLOTS["tripod"]).code() is None, "legs share slots"
    assert gait((1, 2, 3, 4, 6, 5)).code((1,)) == 2
    assert gait((2, 1, 3, 4, 5, 6)).code((1,)) is None, "the failed leg is not in its own slot"


def test_turning_with_half_the_amplitude_is_the_papers_demo() -> None:
    """The demo turns with strokes of A/2 at radius 0.204: 221 degrees in 12 s less the ramp and slip."""
    ant = shipped()
    rate = half_amplitude_turn_rate_rad_s(
        ant, Gait(slots=NAMED_SLOTS["demo"], pace_hz=0.9, amplitude=0.11, height=0.02)
    )
    assert rate == pytest.approx(1.5 * 0.9 * 0.055 / 0.204)
