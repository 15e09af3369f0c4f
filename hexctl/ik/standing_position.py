"""Positions that stand while the legs walk: of a frozen camera or tracker, or of legs that only slip."""

import cmath

from hexctl.types import FloatArray

#: A position that stays within `STANDS_M` while the legs walk `WALKED_M` away stands.
WALKED_M, STANDS_M = 0.5, 0.03


class LegsPath:
    """Where a body is by its legs only, from its start: it drifts, but not within a step or two.

    Attributes:
        position_m: forward + i left.
        turned_rad: counter-clockwise, unwrapped.
    """

    def __init__(self) -> None:
        self.position_m, self.turned_rad = 0j, 0.0

    def move(self, motion: FloatArray) -> None:
        """Add a motion (3,) in the body's frame: forward and left in m, counter-clockwise in rad."""
        forward_m, left_m, turn_rad = motion.tolist()
        self.position_m += cmath.rect(1.0, self.turned_rad) * complex(forward_m, left_m)
        self.turned_rad += turn_rad


class StandingPosition:
    """Whether measured positions stand while the legs walk; single ones may be missing."""

    def __init__(self) -> None:
        self._since: tuple[complex, complex] | None = None

    def stands(self, x_m: float, y_m: float, legs: LegsPath) -> bool:
        """Whether the positions up to this one stand, for a body that its legs have brought here."""
        position_m = complex(x_m, y_m)
        if self._since is None or abs(position_m - self._since[0]) > STANDS_M:
            self._since = position_m, legs.position_m
        return abs(legs.position_m - self._since[1]) > WALKED_M
