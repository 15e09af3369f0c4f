"""The gait space: every gait once, and distances that are metrics."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError
from hexctl.gait.encoding import Slots, code_from_slots
from hexctl.testing.optimizer_conformance import ONE_FAILED, THREE_FAILED, TWO_FAILED

FAILED_SETS = [failed for count in (1, 2, 3) for failed in itertools.combinations(range(1, 7), count)]
SPACES = [ONE_FAILED, TWO_FAILED, THREE_FAILED]
Slow = Callable[[Slots, Slots, tuple[int, ...]], float]
DISTANCES = ["code_distance", "phase_distance", "kendall_distance"]


def order_of_legs(slots: Slots) -> tuple[int, ...]:
    """The legs in the order of their slots, around from leg 1: what walks, without its start."""
    legs = sorted(range(1, 7), key=lambda leg: slots[leg - 1])
    start = legs.index(1)
    return tuple(legs[start:] + legs[:start])


@pytest.mark.parametrize("failed", FAILED_SETS)
def test_120_24_or_6_gaits_and_none_under_two_codes_not_even_shifted(failed: tuple[int, ...]) -> None:
    space = GaitSpace(failed)
    assert space.size == {1: 120, 2: 24, 3: 6}[len(failed)]
    gaits = {order_of_legs(space.slots_of(code)) for code in range(1, space.size + 1)}
    assert len(gaits) == space.size


@pytest.mark.parametrize("leg", range(1, 7))
def test_one_failed_leg_leaves_all_cyclic_orders_of_six(leg: int) -> None:
    space = GaitSpace((leg,))
    gaits = {order_of_legs(space.slots_of(code)) for code in range(1, 121)}
    assert gaits == {(1, *rest) for rest in itertools.permutations(range(2, 7))}


@pytest.mark.parametrize("failed", FAILED_SETS)
def test_codes_and_slots_go_both_ways(failed: tuple[int, ...]) -> None:
    space = GaitSpace(failed)
    assert space.slots.shape == (space.size, 6)
    for code in range(1, space.size + 1):
        slots = space.slots_of(code)
        assert space.code_of(slots) == code
        assert tuple(space.slots[code - 1]) == slots
        assert all(slots[leg - 1] == leg for leg in failed)


@pytest.mark.parametrize("failed", [(), (0,), (7,), (5, 2), (2, 2), (1, 2, 3, 4)])
def test_other_failed_legs_are_refused(failed: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"failed legs: got .*one to three of 1\.\.6, ascending"):
        GaitSpace(failed)


def test_codes_and_slots_of_other_spaces_are_refused() -> None:
    for code in (0, 25):
        with pytest.raises(InputError, match=f"got {code}; allowed: 1..24"):
            TWO_FAILED.slots_of(code)
    with pytest.raises(InputError, match="failed leg 5"):
        ONE_FAILED.code_of((1, 2, 3, 5, 4, 6))


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.size)
@pytest.mark.parametrize("name", DISTANCES)
def test_distances_are_metrics(space: GaitSpace, name: str) -> None:
    distance = getattr(space, name)
    assert distance.shape == (space.size, space.size)
    np.testing.assert_array_equal(distance, distance.T)
    np.testing.assert_array_equal(distance == 0, np.eye(space.size, dtype=bool))
    assert (distance >= 0).all()
    detour = (distance[:, :, np.newaxis] + distance).min(axis=1)  # over all codes in between
    assert (distance <= detour + 1e-12).all()


def slow_code(one: Slots, other: Slots, failed: tuple[int, ...]) -> float:
    return abs(code_from_slots(one, failed) - code_from_slots(other, failed))


def slow_phase(one: Slots, other: Slots, *_: object) -> float:
    apart = []
    for first, second in itertools.combinations(range(6), 2):
        lag = (one[first] - one[second]) / 6 - (other[first] - other[second]) / 6
        apart.append(abs(lag - round(lag)))
    return sum(apart) / len(apart)


def slow_kendall(one: Slots, other: Slots, *_: object) -> float:
    pairs = itertools.combinations(range(6), 2)
    return sum((one[a] - one[b]) * (other[a] - other[b]) < 0 for a, b in pairs)


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.size)
@pytest.mark.parametrize(
    ("name", "slow"), list(zip(DISTANCES, [slow_code, slow_phase, slow_kendall], strict=True))
)
def test_distances_against_the_slow_way(space: GaitSpace, name: str, slow: Slow) -> None:
    gaits = [space.slots_of(code) for code in range(1, space.size + 1)]
    expected = [[slow(one, other, space.failed_legs) for other in gaits] for one in gaits[:30]]
    np.testing.assert_allclose(getattr(space, name)[:30], expected, atol=1e-12)


def test_phase_distance_does_not_see_the_start_of_the_cycle() -> None:
    # The same 120 cyclic orders, each with another start: leg 5 pinned here, leg 2 there.
    there = GaitSpace((2,))
    place = {order_of_legs(there.slots_of(code)): code - 1 for code in range(1, 121)}
    same = [place[order_of_legs(ONE_FAILED.slots_of(code))] for code in range(1, 121)]
    assert same != list(range(120))
    np.testing.assert_array_equal(there.phase_distance[np.ix_(same, same)], ONE_FAILED.phase_distance)
