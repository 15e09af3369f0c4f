"""What a reason to stop is called in messages."""

import pytest

from hexctl.control.stop_reason import MEANINGS, reason_in_words


@pytest.mark.parametrize("reason", sorted(MEANINGS))
def test_the_reason_comes_first_and_its_meaning_behind_it(reason: str) -> None:
    words = reason_in_words(reason)
    assert words.startswith(f"{reason} (")
    assert MEANINGS[reason] in words


def test_details_behind_a_colon_are_kept() -> None:
    assert reason_in_words("hot: leg2 femur 72 C") == "hot: leg2 femur 72 C (a servo is too hot)"


@pytest.mark.parametrize("reason", ["by hand", "fault: low battery", "fault", ""])
def test_what_says_it_by_itself_stays_as_it_is(reason: str) -> None:
    assert reason_in_words(reason) == reason
