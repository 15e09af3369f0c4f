"""The factorial encoding: a bijection between gait codes 1..n! and the phase slots of the legs.

Paper, section 2. A gait gives leg i a phase slot g_i, 1..6. The code is the lexicographic rank of the slots,
counted from 1. With the Lehmer digits c_i, the number of free slots below g_i,

    code = 1 + sum over the walking legs i = 1..n of c_i * (n - i)!

A failed leg k keeps slot k, and the rank counts the arrangements of the n other legs: 120 for one failed leg,
24 for two, 6 for three.
"""

import math
import operator
from collections.abc import Iterable, Sequence

from hexctl.errors import InputError, argument, check_type
from hexctl.types import N_LEGS

_GAIT = argument("gait")
Slots = tuple[int, ...]


def code_count(failed_legs: Iterable[int] = ()) -> int:
    """Number of gait codes, n! for n walking legs."""
    return math.factorial(len(_free_legs(failed_legs)))


def slots_from_code(code: int, failed_legs: Iterable[int] = ()) -> Slots:
    """Slots of legs 1..6 of a gait code; raises InputError for a code outside 1..n!."""
    free = _free_legs(failed_legs)
    count = math.factorial(len(free))
    check_type(code, int, _GAIT, f"a whole number, 1..{count}")
    if not 1 <= code <= count:
        raise InputError(f"{_GAIT}: got {code}; allowed: 1..{count} with {_failed_text(free)}")
    slots = list(range(1, N_LEGS + 1))
    pool = list(free)
    rank = code - 1
    for place, leg in enumerate(free):
        digit, rank = divmod(rank, math.factorial(len(free) - 1 - place))
        slots[leg - 1] = pool.pop(digit)
    return tuple(slots)


def code_from_slots(slots: Sequence[int], failed_legs: Iterable[int] = ()) -> int:
    """Gait code of the slots of legs 1..6, a failed leg in its own; raises InputError."""
    check_permutation(slots)
    free = _free_legs(failed_legs)
    for leg in range(1, N_LEGS + 1):
        if leg not in free and slots[leg - 1] != leg:
            raise InputError(f"{_GAIT}: failed leg {leg} has slot {slots[leg - 1]}; allowed: its own, {leg}")
    pool = list(free)
    rank = 0
    for place, leg in enumerate(free):
        digit = pool.index(slots[leg - 1])
        pool.pop(digit)
        rank += digit * math.factorial(len(free) - 1 - place)
    return rank + 1


def as_slots(slots: Iterable[int]) -> Slots:
    """Slots as a tuple of plain whole numbers; raises WrongTypeError for text and other content."""
    allowed = f"{N_LEGS} whole numbers, each 1..{N_LEGS}"
    if isinstance(slots, str):
        check_type(slots, tuple, _GAIT, allowed)
    check_type(slots, Iterable, _GAIT, allowed)
    values = tuple(slots)
    for value in values:
        check_type(value, int, _GAIT, allowed)
    return tuple(map(operator.index, values))


def check_permutation(slots: Sequence[int]) -> None:
    """Raise InputError unless the slots are a permutation of 1..6."""
    if sorted(as_slots(slots)) != list(range(1, N_LEGS + 1)):
        got = ",".join(str(slot) for slot in slots)
        raise InputError(f"{_GAIT}: got {got}; allowed: a permutation of 1,2,3,4,5,6")


def _free_legs(failed_legs: Iterable[int]) -> tuple[int, ...]:
    check_type(failed_legs, Iterable, "failed legs", f"legs, each 1..{N_LEGS}, such as (5,)")
    failed = set(failed_legs)
    if not failed <= set(range(1, N_LEGS + 1)):
        raise InputError(f"failed legs: got {sorted(failed)}; allowed: 1..{N_LEGS}")
    return tuple(leg for leg in range(1, N_LEGS + 1) if leg not in failed)


def _failed_text(free: tuple[int, ...]) -> str:
    failed = [str(leg) for leg in range(1, N_LEGS + 1) if leg not in free]
    return f"failed leg {', '.join(failed)}" if failed else "no failed leg"
