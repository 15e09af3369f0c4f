"""Gait codes 1..n! against the slots of the legs: a bijection in lexicographic order."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    assert code_count(failed) == len(expected)
    assert [slots_from_code(code, failed) for code in range(1, len(expected) + 1)] == expected


@pytest.mark.parametrize(("failed", "count"), [((), 720), ((5,), 120), ((2, 5), 24), ((1, 3, 5), 6)])
def test_how_many_codes_there_are(failed: tuple[int, ...], count: int) -> None:
    assert code_count(failed) == count


@given(st.sets(st.integers(1, 6), max_size=5), st.data())
def test_a_code_comes_back_from_its_slots(failed: set[int], data: st.DataObject) -> None:
    code = data.draw(st.integers(1, code_count(failed)))
    assert code_from_slots(slots_from_code(code, failed), failed) == code


@given(st.permutations(range(1, 7)))
def test_slots_come_back_from_their_code(slots: list[int]) -> None:
    assert slots_from_code(code_from_slots(slots)) == tuple(slots)


@pytest.mark.parametrize("failed", FAILED_SETS)
def test_code_one_is_the_identity_and_a_failed_leg_keeps_its_slot(failed: tuple[int, ...]) -> None:
    assert slots_from_code(1, failed) == (1, 2, 3, 4, 5, 6)
    last = slots_from_code(code_count(failed), failed)
    assert all(last[leg - 1] == leg for leg in failed)
    walking = [last[leg - 1] for leg in range(1, 7) if leg not in failed]
    assert walking == sorted(walking, reverse=True)


def test_all_gaits_are_those_of_the_papers_factorial_number_system() -> None:
    """The 720 gaits of six legs, and the 120 of each failed leg, transcribed from the text alone."""
    assert [slots_from_code(number) for number in range(1, 721)] == [*map(numbered_gait, range(1, 721))]
    for failed in range(1, 7):
        recoveries = [numbered_recovery(number, failed) for number in range(1, 121)]
        assert [slots_from_code(number, (failed,)) for number in range(1, 121)] == recoveries
        assert len(set(recoveries)) == 120


def test_the_papers_example() -> None:
    # Lehmer digits 4, 0, 0, 1, 0: 4 * 120 + 0 + 0 + 1 * 2 + 0, counted from 1.
    assert code_from_slots((5, 1, 2, 4, 3, 6)) == 483
    assert slots_from_code(483) == (5, 1, 2, 4, 3, 6)


@pytest.mark.parametrize(
    ("code", "failed", "allowed"),
    [
        (0, (), "1..720 with no failed leg"),
        (721, (), "1..720"),
        (-1, (), "1..720"),
        (121, (5,), "1..120 with failed leg 5"),
        (0, (5,), "1..120"),
        (25, (2, 5), "1..24 with failed leg 2, 5"),
        (7, (1, 3, 5), "1..6"),
    ],
)
def test_a_code_out_of_range_is_refused_with_the_range(
    code: int, failed: tuple[int, ...], allowed: str
) -> None:
    with pytest.raises(InputError, match=f"got {code}") as refused:
        slots_from_code(code, failed)
    assert allowed in str(refused.value)


@pytest.mark.parametrize(
    "slots", [(1, 1, 2, 3, 4, 5), (1, 2, 3, 4, 5), (0, 1, 2, 3, 4, 5), (1, 2, 3, 4, 5, 6, 6), ()]
)
def test_slots_that_are_no_permutation_are_refused(slots: Slots) -> None:
    with pytest.raises(InputError, match=r"gait: got .*a permutation of 1,2,3,4,5,6"):
        code_from_slots(slots)


def test_a_failed_leg_in_another_slot_is_refused() -> None:
    with pytest.raises(InputError, match="failed leg 5 has slot 4; allowed: its own, 5"):
        code_from_slots((1, 2, 3, 5, 4, 6), (5,))


@pytest.mark.parametrize("failed", [(0,), (7,), (3, 9)])
def test_a_leg_that_does_not_exist_cannot_fail(failed: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"failed legs: got .*1\.\.6"):
        slots_from_code(1, failed)
