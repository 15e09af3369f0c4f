"""The speeds that a gait can be commanded to, by direction, with and without each leg."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hexctl.control.planning.static_stability import most_stable_slots, static_margins_m
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion, half_amplitude_turn_rate_rad_s, ideal_speed_m_s
from hexctl.ik.legs import legs_that_reach
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray

#: Directions of travel, counter-clockwise from forward.
DIRECTIONS_RAD = tuple(math.radians(degrees) for degrees in range(0, 360, 45))

#: Tried shares of the maximum stroke.
SHARES = np.linspace(0.05, 1.0, 20)

#: Checked points of a cycle, and those of a drive: a third, because a robot waits.
POINTS, DRIVE_POINTS = 120, 40


@dataclass(frozen=True, slots=True, eq=False)
class VelocityLimits(ArrayFields):
    """Maximum velocities of a gait, with all legs in row 0 and without leg k in row k; 0 if none is possible.

    They are within reach, joint ranges and strokes up to 1.2 amplitudes, but not joint speeds.

    Attributes:
        speeds_m_s: of travel along `DIRECTIONS_RAD`, (7, 8).
        turn_rates_rad_s: of a turn in place, (7,).
    """

    speeds_m_s: FloatArray
    turn_rates_rad_s: FloatArray

    @classmethod
    def of(cls, robot: Robot, gait: Gait, points: int = DRIVE_POINTS) -> "VelocityLimits":
        """Limits of a gait, cached by its strides, checked at some points of its cycle."""
        plain = replace(gait, slots=(1,) * N_LEGS, phases=None)  # the order of the legs does not matter
        return _limits(robot, plain, points)

    def limited(self, velocity: FloatArray, failed_legs: Sequence[int] = ()) -> FloatArray:
        """Velocity, (3,), within the limits, its direction kept: forward and left in m/s, turn in rad/s.

        The shares of travel and turn in their maxima add up to 1 at most.
        """
        rows = list(failed_legs) or [0]
        speed_m_s = math.hypot(velocity[0], velocity[1])
        most_m_s = self._speed_m_s(math.atan2(velocity[1], velocity[0]), rows)
        most_rad_s = float(self.turn_rates_rad_s[rows].min())
        if min(most_m_s, most_rad_s) <= 0:
            return np.zeros(3)
        share = speed_m_s / most_m_s + abs(velocity[2]) / most_rad_s
        return np.asarray(velocity / max(1.0, share))

    def _speed_m_s(self, heading_rad: float, rows: Sequence[int]) -> float:
        speeds = self.speeds_m_s[rows].min(axis=0)
        return float(np.interp(heading_rad % math.tau, [*DIRECTIONS_RAD, math.tau], [*speeds, speeds[0]]))


@lru_cache(maxsize=64)
def _limits(robot: Robot, gait: Gait, points: int) -> VelocityLimits:
    way = [_possible(robot, gait, Motion(heading_rad=one), points) for one in DIRECTIONS_RAD]
    turn_rate_rad_s = 2 * half_amplitude_turn_rate_rad_s(robot, gait)
    turn = _possible(robot, gait, Motion(travel=0.0, turn_rate_rad_s=turn_rate_rad_s), points)
    speed_m_s = ideal_speed_m_s(robot, gait, Motion())
    speeds_m_s = OVERDRIVE * speed_m_s * np.array([_greatest(one) for one in way]).T
    return VelocityLimits(speeds_m_s, OVERDRIVE * turn_rate_rad_s * _greatest(turn))


def _possible(robot: Robot, gait: Gait, motion: Motion, points: int) -> BoolArray:
    """Whether each leg can make its stroke at each of the `SHARES`, (shares, 6)."""
    time_s = RAMP_DURATION_S + np.arange(points) / (points * gait.pace_hz)
    feet = []
    for share in (OVERDRIVE * SHARES).tolist():
        longer = replace(gait, amplitude=min(1.0, share * gait.amplitude))
        turning = replace(motion, turn_rate_rad_s=share * motion.turn_rate_rad_s)
        feet.append(gait_feet_body(robot, longer, turning, time_s))
    return np.asarray(legs_that_reach(robot, np.array(feet)).all(axis=1))


def _greatest(possible: BoolArray) -> FloatArray:
    """Maximum possible share with all six legs, and without each of them, (7,)."""
    rows = [possible.all(axis=-1)]
    rows += [np.delete(possible, leg, axis=-1).all(axis=-1) for leg in range(N_LEGS)]
    # A share counts if every smaller one is possible too.
    return np.array([SHARES[np.cumprod(row).astype(bool)].max(initial=0.0) for row in rows])


def speed_envelope(robot: Robot, gait: Gait) -> dict[str, Any]:
    """Velocity limits and static margins of a gait as JSON values, intact and without each leg."""
    limits = VelocityLimits.of(robot, gait, POINTS)
    failures = [None, *(Failure(leg=leg, kind="missing") for leg in range(1, N_LEGS + 1))]
    margins_m = np.array([[_margin_m(robot, one, heading) for heading in DIRECTIONS_RAD] for one in failures])

    def by_leg(rows: FloatArray, places: int) -> dict[str, Any]:
        names = ("intact", *map(str, range(1, N_LEGS + 1)))
        return dict(zip(names, rows.round(places).tolist(), strict=True))

    return {
        "directions_deg": np.degrees(DIRECTIONS_RAD).round(1).tolist(),
        "speeds_m_s": by_leg(limits.speeds_m_s, 4),
        "turn_rates_deg_s": by_leg(np.degrees(limits.turn_rates_rad_s), 2),
        "static_margins_m": by_leg(margins_m, 4),
    }


def _margin_m(robot: Robot, failure: Failure | None, heading_rad: float) -> float:
    """Smallest static margin of the most stable gait."""
    slots = most_stable_slots(robot, heading_rad=heading_rad, failure=failure)
    return float(static_margins_m(robot, [slots], heading_rad=heading_rad, failure=failure)[0, 0])
