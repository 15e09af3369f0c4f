"""Legs as a person types them."""

import pytest

from hexctl.robot.leg_numbers import leg_numbers


def test_legs_are_ascending() -> None:
    assert leg_numbers("5, 2") == (2, 5)
    assert leg_numbers("") == ()


@pytest.mark.parametrize("text", ["five", "2;5", "1.5"])
def test_what_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="allowed: "):
        leg_numbers(text)
