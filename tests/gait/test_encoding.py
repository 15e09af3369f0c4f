"""Gait codes 1..n! against the slots of the legs: a bijection in lexicographic order."""

import itertools
import math

import pytest

from hexctl.errors import InputError
from hexctl.gait.encoding import Slots, code_count, code_from_slots, slots_from_code
from tests.gait.paper import numbered_gait, numbered_recovery

FAILED_SETS = [(), *((leg,) for leg in range(1, 7)), (2, 5), (1, 6), (1, 3, 5), (4, 5, 6)]


def _enumerated(failed: tuple[int, ...]) -> list[Slots]:
    """All slots in lexicographic order, by brute force over the permutations of six."""
    return [
        slots for slots in itertools.permutations(range(1, 7)) if all(slots[leg - 1] == leg for leg in failed)
    ]


@pytest.mark.parametrize("failed", FAILED_SETS)
def test_codes_count_all_arrangements_in_lexicographic_order(failed: tuple[int, ...]) -> None:
    expected = _enumerated(failed)
    assert code_count(failed) == len(expected) == math.factorial(6 - len(failed))
    assert [slots_from_code(code, failed) for code in range(1, len(expected) + 1)] == expected
    assert [code_from_slots(slots, failed) for slots in expected] == [*range(1, len(expected) + 1)]


def test_all_gaits_are_those_of_the_papers_factorial_number_system() -> None:
    """The 720 gaits of six legs, and the 120 of each failed leg, transcribed from the text alone."""
    assert [slots_from_code(number) for number in range(1, 721)] == [*map(numbered_gait, range(1, 721))]
    for failed in range(1, 7):
        recoveries = [numbered_recovery(number, failed) for number in range(1, 121)]
        assert [slots_from_code(number, (failed,)) for number in range(1, 121)] == recoveries
        assert len(set(recoveries)) == 120


@pytest.mark.parametrize(
    ("code", "failed", "most"),
    [(0, (), 720), (721, (), 720), (-1, (), 720), (0, (5,), 120), (121, (5,), 120), (7, (1, 3, 5), 6)],
)
def test_a_code_out_of_range_is_refused_with_the_range(code: int, failed: tuple[int, ...], most: int) -> None:
    with pytest.raises(InputError, match=rf"got {code}.*1\.\.{most}"):
        slots_from_code(code, failed)


@pytest.mark.parametrize(
    ("slots", "failed", "named"),
    [
        ((1, 1, 2, 3, 4, 5), (), "gait"),
        ((1, 2, 3, 4, 5), (), "gait"),
        ((1, 2, 3, 5, 4, 6), (5,), "failed leg 5 has slot 4"),
    ],
)
def test_slots_that_are_no_permutation_or_move_a_failed_leg_are_refused(
    slots: Slots, failed: tuple[int, ...], named: str
) -> None:
    with pytest.raises(InputError, match=named):
        code_from_slots(slots, failed)


@pytest.mark.parametrize("failed", [(0,), (7,), (3, 9)])
def test_a_leg_that_does_not_exist_cannot_fail(failed: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="failed legs"):
        slots_from_code(1, failed)
