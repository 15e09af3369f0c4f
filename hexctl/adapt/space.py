"""The gaits of a robot with failed legs, as a search space of codes 1..n!, and a distance in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hexctl.errors import InputError, check_type
from hexctl.gait.encoding import Slots, code_count, code_from_slots, slots_from_code
from hexctl.types import N_LEGS, FloatArray


@dataclass(frozen=True)
class GaitSpace:
    """All gaits of the walking legs: 120 for one failed leg, 24 for two, 6 for three.

    Every gait has one code. Slots shifted by a constant differ only in the start phase; a failed leg pins its
    slot, so no two codes are shifts of one another.
    """

    failed_legs: tuple[int, ...]

    def __post_init__(self) -> None:
        check_type(self.failed_legs, (tuple, list), "failed legs", "one to three legs, such as (5,)")
        for leg in self.failed_legs:
            check_type(leg, int, "failed legs", "one to three legs, such as (5,)")
        object.__setattr__(self, "failed_legs", tuple(self.failed_legs))
        allowed = 1 <= len(self.failed_legs) <= 3 and sorted(set(self.failed_legs)) == list(self.failed_legs)
        if not allowed or not set(self.failed_legs) <= set(range(1, N_LEGS + 1)):
            raise InputError(f"failed legs: got {self.failed_legs}; allowed: one to three of 1..6, ascending")

    @cached_property
    def size(self) -> int:
        """Number of gaits."""
        return code_count(self.failed_legs)

    @cached_property
    def slots(self) -> "np.ndarray[tuple[int, ...], np.dtype[np.int64]]":
        """Slots of all gaits, (size, 6); row i belongs to code i + 1."""
        return np.array([slots_from_code(code, self.failed_legs) for code in range(1, self.size + 1)])

    def slots_of(self, code: int) -> Slots:
        """Slots of a code; raises InputError outside 1..size."""
        return slots_from_code(code, self.failed_legs)

    def code_of(self, slots: Sequence[int]) -> int:
        """Code of slots; raises InputError for slots that are not in this space."""
        return code_from_slots(slots, self.failed_legs)

    @cached_property
    def phase_distance(self) -> FloatArray:
        """Mean circular phase difference over all pairs of legs, in cycles 0..1/2, (size, size)."""
        upper = np.triu_indices(N_LEGS, k=1)
        lags = self.slots[:, upper[0]] - self.slots[:, upper[1]]  # (size, 15), in slots: whole numbers
        apart = (lags[:, np.newaxis] - lags) % N_LEGS
        return np.asarray(np.minimum(apart, N_LEGS - apart).mean(axis=-1) / N_LEGS)
