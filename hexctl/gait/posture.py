"""Posture of the body over its feet while it walks."""

from dataclasses import dataclass
from typing import Any

from hexctl.errors import InputError, argument, check_type
from hexctl.options import Range
from hexctl.types import N_LEGS

_STANCE_SHIFT = argument("stance_shift")
_TUCKED_LEGS = argument("tucked_legs")

#: Limits of raise and shift, as fractions of the robot's size.
POSTURE = Range(low=-0.2, high=0.2, unit="of the robot's size")


@dataclass(frozen=True, slots=True, kw_only=True)
class Posture:
    """Posture of the body over its feet while it walks; by default as in the paper.

    Attributes:
        body_raise: above the stance, as a fraction of the robot's size E; legs held in their stance pose
            leave the floor with it.
        shift: of the body over its feet, forward and left, as fractions of E.
        tucked_legs: legs held up in the air, which neither step nor carry.
    """

    body_raise: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    tucked_legs: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        POSTURE.check(argument("body_raise"), self.body_raise)
        check_type(self.shift, (tuple, list), _STANCE_SHIFT, "two numbers, forward and left")
        if len(self.shift) != 2:
            raise InputError(f"{_STANCE_SHIFT}: got {len(self.shift)} numbers; allowed: 2, forward and left")
        for value in self.shift:
            POSTURE.check(_STANCE_SHIFT, value)
        check_type(self.tucked_legs, (tuple, list), _TUCKED_LEGS, "legs, such as (5,)")
        for leg in self.tucked_legs:
            check_type(leg, int, _TUCKED_LEGS, f"legs, each 1..{N_LEGS}")
        tucked = tuple(sorted(set(self.tucked_legs)))
        if not set(tucked) <= set(range(1, N_LEGS + 1)):
            raise InputError(f"{_TUCKED_LEGS}: got {list(tucked)}; allowed: legs, each 1..{N_LEGS}")
        object.__setattr__(self, "tucked_legs", tucked)
        object.__setattr__(self, "shift", (float(self.shift[0]), float(self.shift[1])))

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "body_raise": self.body_raise,
            "shift": list(self.shift),
            "tucked_legs": list(self.tucked_legs),
        }


#: The posture of the paper: that of the robot's stance.
STANCE = Posture()
