"""Walk options that several commands share."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hexctl.control.trial_plan import TURN_DEG_S, Feet
from hexctl.gait.gait import PACE_HZ, STEP
from hexctl.options import RARE, Typed


@dataclass(frozen=True, kw_only=True)
class WalkOptions:
    """How a robot steps and turns; None takes the robot's value."""

    PANEL: ClassVar = "Walk"

    turn_rate_rad_s: Annotated[float | None, TURN_DEG_S, Typed(flag="turn")] = None
    """Turn rate in degrees per second, {}, counter-clockwise. Without --heading the robot turns in place.
    (default: 0)

    In Python in rad/s.
    """

    pace_hz: Annotated[float | None, PACE_HZ] = None
    """Gait cycles per second, {}. (default: the robot's)"""

    amplitude: Annotated[float | None, STEP, RARE] = None
    """Length of the stroke of a foot as a fraction of the robot's size, {}. (default: the robot's)"""

    height: Annotated[float | None, STEP, RARE] = None
    """Height of a step as a fraction of the robot's size, {}. (default: the robot's)"""


@dataclass(frozen=True, kw_only=True)
class GroundOptions:
    """How a robot walks over uneven ground."""

    PANEL: ClassVar = "Walk"

    level: Annotated[bool, RARE] = False
    """Keep the body level on slopes, with the roll and pitch that the robot measures."""

    feet: Feet = "planned"
    """How feet meet the ground: planned, as the gait has them, or adaptive, for uneven ground: they lift
    higher, by default at least 0.04 of the robot's size, and search the ground below until they touch it.

    The search needs foot contacts.
    """
