"""Options of a check of a robot."""

from typing import Any

import pytest

from hexctl.control.assessment.check_options import CheckOptions
from hexctl.errors import InputError


@pytest.mark.parametrize(
    ("options", "option"),
    [
        ({"world": "flat"}, "world"),
        ({"duration_s": 5.0}, "duration_s"),
        ({"pace_hz": 11.0}, "pace_hz"),
        ({"turn_rate_rad_s": 7.0}, "turn_rate_rad_s"),
    ],
)
def test_what_a_check_does_not_take_is_refused(options: dict[str, Any], option: str) -> None:
    with pytest.raises(InputError, match=f"^{option}: got "):
        CheckOptions(**options)


def test_world_and_duration_are_those_of_the_measurement() -> None:
    options = CheckOptions(physics=True, world="slope", duration_s=5.0)
    assert (options.world, options.duration_s) == ("slope", 5.0)
