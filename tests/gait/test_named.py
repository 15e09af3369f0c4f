"""Named gaits walk in the order that their names promise, and a gait is read from its text."""

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.gait.encoding import Slots
from hexctl.gait.named import NAMED_SLOTS, parse_slots
from hexctl.gait.trajectory import lift_offset, phase_in_cycle


def _swing_order(slots: Slots) -> list[int]:
    """Return the legs in the order of their highest moments in one cycle, read off the trajectory."""
    cycles = np.arange(600) / 600
    lifts = lift_offset(phase_in_cycle(cycles[:, np.newaxis], np.array(slots)))
    tops = cycles[lifts.argmax(axis=0)]
    return [int(leg) + 1 for leg in np.argsort(tops, kind="stable")]


def _from(order: list[int], leg: int) -> list[int]:
    """Return a cyclic order as it reads from a leg on."""
    start = order.index(leg)
    return order[start:] + order[:start]


def test_the_wave_goes_up_the_left_side_and_then_up_the_right() -> None:
    assert _from(_swing_order(NAMED_SLOTS["wave"]), 3) == [3, 2, 1, 4, 5, 6]


def test_the_ripple_goes_up_both_sides_half_a_cycle_apart() -> None:
    order = _from(_swing_order(NAMED_SLOTS["ripple"]), 3)
    assert order == [3, 6, 2, 4, 1, 5]
    left, right = [leg for leg in order if leg in (1, 2, 3)], [leg for leg in order if leg in (4, 5, 6)]
    assert left == [3, 2, 1]
    assert _from(right, 4) == [4, 5, 6]


def test_the_tripod_lifts_two_groups_of_three_in_turn() -> None:
    cycles = np.arange(600) / 600
    up = lift_offset(phase_in_cycle(cycles[:, np.newaxis], np.array(NAMED_SLOTS["tripod"]))) > 0
    groups = {tuple(int(leg) + 1 for leg in np.flatnonzero(row)) for row in up}
    assert groups == {(), (1, 3, 5), (2, 4, 6)}


@pytest.mark.parametrize("name", ["demo", "wave", "ripple"])
def test_swings_of_an_encoded_gait_follow_in_descending_slot_order(name: str) -> None:
    slots = NAMED_SLOTS[name]
    descending = sorted(range(1, 7), key=lambda leg: -slots[leg - 1])
    assert _from(_swing_order(slots), descending[0]) == descending


def test_the_default_is_the_demo_of_the_paper() -> None:
    assert NAMED_SLOTS["demo"] == (1, 4, 2, 6, 3, 5)


@pytest.mark.parametrize(
    ("text", "failed", "slots"),
    [
        ("tripod", (), (1, 4, 1, 4, 1, 4)),
        (" demo ", (), (1, 4, 2, 6, 3, 5)),
        ("1", (), (1, 2, 3, 4, 5, 6)),
        ("720", (), (6, 5, 4, 3, 2, 1)),
        ("120", (5,), (6, 4, 3, 2, 5, 1)),
        ("5,1,2,4,3,6", (), (5, 1, 2, 4, 3, 6)),
        ("5, 1, 2, 4, 3, 6", (), (5, 1, 2, 4, 3, 6)),
    ],
)
def test_a_gait_is_read_from_a_name_a_code_or_slots(text: str, failed: tuple[int, ...], slots: Slots) -> None:
    assert parse_slots(text, failed) == slots


@pytest.mark.parametrize(
    ("text", "failed", "words"),
    [
        ("gallop", (), r"gait: got 'gallop'; allowed: demo, tripod, wave, ripple, a code 1\.\.720, or slots"),
        ("gallop", (5,), r"a code 1\.\.120"),
        ("", (), r"gait: got ''"),
        ("1.5", (), r"gait: got '1.5'"),
        ("0", (), r"gait code: got 0; allowed: 1\.\.720"),
        ("721", (), r"gait code: got 721; allowed: 1\.\.720"),
        ("121", (5,), r"gait code: got 121; allowed: 1\.\.120 with failed leg 5"),
        ("-3", (), r"gait code: got -3"),
        ("1,2,3,4,5", (), r"slots: got 1,2,3,4,5; allowed: a permutation"),
        ("1,2,3,4,5,5", (), r"slots: got 1,2,3,4,5,5; allowed: a permutation"),
        ("1,2,3,4,5,x", (), r"slots: got '1,2,3,4,5,x'; allowed: six whole numbers"),
        ("1,2,3,4,5,", (), r"six whole numbers"),
        ("tripod\n1", (), r"gait: got 'tripod\\n1'"),
    ],
)
def test_anything_else_is_refused_with_what_is_allowed(
    text: str, failed: tuple[int, ...], words: str
) -> None:
    with pytest.raises(InputError, match=words) as refused:
        parse_slots(text, failed)
    assert "\n" not in str(refused.value)
