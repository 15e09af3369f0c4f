"""What answers about one servo make of a servo map. Angles are a joint's, in degrees, as the map has them."""

from dataclasses import replace

import numpy as np

from hexctl.errors import InputError
from hexctl.robot.servomap import ServoMap
from hexctl.types import FloatArray

#: A reference angle keeps this far from both ends of a joint's range, so that it can be trimmed both ways.
ROOM_DEG = 20.0

#: Two limits nearer than this leave no servo to speak of.
LEAST_TRAVEL_US = 50.0


def flipped(servo_map: ServoMap, joint: int, at_deg: float) -> ServoMap:
    """Return the map with a joint's sign turned over; the pulse at an angle still means that angle.

    The joint is believed to stand at that angle, so nothing has to move for the new sign.
    """
    sign = servo_map.signs[joint]
    offset = servo_map.offsets_deg[joint] + 2 * sign * at_deg
    return replace(
        servo_map,
        signs=_with(servo_map.signs, joint, -sign),
        offsets_deg=_with(servo_map.offsets_deg, joint, offset),
    )


def referenced(servo_map: ServoMap, joint: int, believed_deg: float, true_deg: float) -> ServoMap:
    """Return the map with a joint's offset such that the pulse of the believed angle means the true one."""
    shift = servo_map.signs[joint] * (believed_deg - true_deg)
    offset = round(float(servo_map.offsets_deg[joint] + shift), 3)
    return replace(servo_map, offsets_deg=_with(servo_map.offsets_deg, joint, offset))


def limited(servo_map: ServoMap, joint: int, pulses_us: tuple[float, float]) -> ServoMap:
    """Return the map with a joint's pulse limits, given in any order, in whole microseconds.

    Raises InputError for two that are nearly one.
    """
    least, most = (float(round(pulse)) for pulse in sorted(pulses_us))
    if most - least < LEAST_TRAVEL_US:
        raise InputError(
            f"limits: got {least:g} and {most:g} us; allowed: {LEAST_TRAVEL_US:g} us apart or more"
        )
    return replace(
        servo_map,
        min_us=_with(servo_map.min_us, joint, least),
        max_us=_with(servo_map.max_us, joint, most),
    )


def taken_over(servo_map: ServoMap, joint: int, source: ServoMap) -> ServoMap:
    """Return the map with one joint's sign, offset and limits as another map has them."""
    return replace(
        servo_map,
        signs=_with(servo_map.signs, joint, source.signs[joint]),
        offsets_deg=_with(servo_map.offsets_deg, joint, source.offsets_deg[joint]),
        min_us=_with(servo_map.min_us, joint, source.min_us[joint]),
        max_us=_with(servo_map.max_us, joint, source.max_us[joint]),
    )


def reference_deg(lower_deg: float, upper_deg: float) -> float:
    """Return the angle at which a joint is easily judged: 0, a right angle, or the middle of its range."""
    for angle in (0.0, -90.0, 90.0):
        if lower_deg + ROOM_DEG <= angle <= upper_deg - ROOM_DEG:
            return angle
    return round((lower_deg + upper_deg) / 2)


def _with(values: FloatArray, joint: int, value: float) -> FloatArray:
    changed = np.array(values, dtype=float)
    changed[joint] = value
    return changed
