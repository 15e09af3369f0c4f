"""A gait (slots, pace, amplitude, height) and a motion (heading and turn), both plain values."""

import math
from dataclasses import dataclass

from hexctl.errors import InputError
from hexctl.gait.encoding import Slots, check_permutation, code_from_slots
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS

#: Share of a stance stroke's speed: a foot crosses the amplitude in two thirds of a cycle.
STROKES_PER_CYCLE = 1.5

MAX_PACE_HZ = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait:
    """Which leg steps when, how often, how far and how high.

    Attributes:
        slots: phase slot of legs 1..6, each 1..6; `tripod` shares slots, an encoded gait is a permutation.
        pace_hz: gait cycles per second.
        amplitude: step amplitude A as a fraction of the robot's size E.
        height: step height H as a fraction of the robot's size E.
    """

    slots: Slots
    pace_hz: float
    amplitude: float
    height: float

    def __post_init__(self) -> None:
        if len(self.slots) != N_LEGS or not all(1 <= slot <= N_LEGS for slot in self.slots):
            raise InputError(f"slots: got {self.slots}; allowed: six numbers, each 1..6")
        _require_between("pace", self.pace_hz, 0, MAX_PACE_HZ, "Hz")
        _require_between("amplitude", self.amplitude, 0, 1, "of the robot's size")
        _require_between("height", self.height, 0, 1, "of the robot's size")

    def code(self, failed_legs: tuple[int, ...] = ()) -> int | None:
        """Return the gait code, or None for slots that have none (shared slots, a failed leg elsewhere)."""
        try:
            check_permutation(self.slots)
            return code_from_slots(self.slots, failed_legs)
        except InputError:
            return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Where the body goes, as seen from the body: travel along a heading, turn, or both blended.

    Attributes:
        heading_rad: direction of travel in the body frame, counter-clockwise from forward.
        travel: 1 to travel with the full amplitude, 0 to stay on the spot.
        turn_rate_rad_s: commanded yaw rate, counter-clockwise positive.
    """

    heading_rad: float = 0.0
    travel: float = 1.0
    turn_rate_rad_s: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.heading_rad) and math.isfinite(self.turn_rate_rad_s)):
            raise InputError(
                f"motion: got heading {self.heading_rad} and turn {self.turn_rate_rad_s} rad/s; "
                "allowed: finite numbers"
            )
        if not 0 <= self.travel <= 1:
            raise InputError(f"travel: got {self.travel}; allowed: 0..1")


def ideal_speed_m_s(robot: Robot, gait: Gait, motion: Motion) -> float:
    """Return the travel speed without slip, 1.5 * A * pace."""
    return STROKES_PER_CYCLE * gait.amplitude * robot.size_m * gait.pace_hz * motion.travel


def turn_amplitude_m(robot: Robot, gait: Gait, turn_rate_rad_s: float) -> float:
    """Return the stroke, at the farthest foot, that turns the body at a rate without slip."""
    return turn_rate_rad_s * robot.stance_radius_m / (STROKES_PER_CYCLE * gait.pace_hz)


def half_amplitude_turn_rate_rad_s(robot: Robot, gait: Gait) -> float:
    """Return the rate of a turn in place with half the step amplitude, as the paper's demo turns."""
    return STROKES_PER_CYCLE * gait.pace_hz * 0.5 * gait.amplitude * robot.size_m / robot.stance_radius_m


def _require_between(what: str, value: float, low: float, high: float, unit: str) -> None:
    if not (math.isfinite(value) and low < value <= high):
        raise InputError(f"{what}: got {value:g}; allowed: above {low:g} up to {high:g} {unit}")
