"""The speeds that a gait can be commanded to, by direction, with and without each leg."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.control.assessment.static_stability import most_stable_slots, static_margins_m
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion, half_amplitude_turn_rate_rad_s, ideal_speed_m_s
from hexctl.ik.legs import legs_that_reach
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray

#: Directions of travel, counter-clockwise from forward.
DIRECTIONS_RAD = tuple(math.radians(degrees) for degrees in range(0, 360, 45))

#: Tried shares of the maximum stroke, and checked points of a cycle.
SHARES = np.linspace(0.05, 1.0, 20)
POINTS = 120


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpeedEnvelope(ArrayFields):
    """Maximum speeds of an intact robot in row 0 and without leg k in row k; 0 if none is possible.

    Attributes:
        directions_rad: of travel in the body frame, (D,).
        speeds_m_s: within reach, joint ranges and strokes up to 1.2 amplitudes, but not joint speeds, (7, D).
        turn_rates_rad_s: of a turn in place, with the same limits, (7,).
        margins_m: smallest static margin of the most stable gait, (7, D).
    """

    directions_rad: FloatArray
    speeds_m_s: FloatArray
    turn_rates_rad_s: FloatArray
    margins_m: FloatArray

    def to_dict(self) -> dict[str, Any]:
        """JSON values, directions and rates in degrees; the key of a row is `intact` or the missing leg."""
        names = ["intact", *(str(leg) for leg in range(1, N_LEGS + 1))]

        def by_leg(rows: FloatArray, places: int) -> dict[str, Any]:
            return dict(zip(names, rows.round(places).tolist(), strict=True))

        return {
            "directions_deg": np.degrees(self.directions_rad).round(1).tolist(),
            "speeds_m_s": by_leg(self.speeds_m_s, 4),
            "turn_rates_deg_s": by_leg(np.degrees(self.turn_rates_rad_s), 2),
            "static_margins_m": by_leg(self.margins_m, 4),
        }


def speed_envelope(
    robot: Robot, gait: Gait, directions_rad: Sequence[float] = DIRECTIONS_RAD
) -> SpeedEnvelope:
    """Envelope of a gait for velocity commands; planned motions are limited only by the reach of the legs."""
    speeds_m_s, turn_rates_rad_s = speed_limits(robot, gait, directions_rad)
    failures = [None, *(Failure(leg=leg, kind="missing") for leg in range(1, N_LEGS + 1))]
    margins_m = np.array([[_margin_m(robot, one, heading) for heading in directions_rad] for one in failures])
    return SpeedEnvelope(
        directions_rad=np.array(directions_rad),
        speeds_m_s=speeds_m_s,
        turn_rates_rad_s=turn_rates_rad_s,
        margins_m=margins_m,
    )


def speed_limits(
    robot: Robot,
    gait: Gait,
    directions_rad: Sequence[float] = DIRECTIONS_RAD,
    *,
    points: int = POINTS,
) -> tuple[FloatArray, FloatArray]:
    """Maximum speeds in m/s, (7, D), and turn rates in rad/s, (7,), as in `SpeedEnvelope`."""
    way = [_possible(robot, gait, Motion(heading_rad=one), points) for one in directions_rad]
    turn_rate_rad_s = 2 * half_amplitude_turn_rate_rad_s(robot, gait)
    turn = _possible(robot, gait, Motion(travel=0.0, turn_rate_rad_s=turn_rate_rad_s), points)
    speed_m_s = ideal_speed_m_s(robot, gait, Motion())
    speeds_m_s = OVERDRIVE * speed_m_s * np.array([_greatest(one) for one in way]).T
    return speeds_m_s, OVERDRIVE * turn_rate_rad_s * _greatest(turn)


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


def _margin_m(robot: Robot, failure: Failure | None, heading_rad: float) -> float:
    slots = most_stable_slots(robot, heading_rad=heading_rad, failure=failure)
    return float(static_margins_m(robot, [slots], heading_rad=heading_rad, failure=failure)[0, 0])
