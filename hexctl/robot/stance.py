"""Joint angles of the nominal stance, in plain scalar trigonometry.

The robot file gives the stance as a foot position; the description has to refuse one that the leg cannot
take. The vectorised kinematics of `hexctl.ik` stand above this part and are tested against it.
"""

import math

from hexctl.errors import InputError

Vector2 = tuple[float, float]


def leg_reach_m(femur: Vector2, tibia: Vector2) -> tuple[float, float]:
    """Return the least and the greatest distance of a foot from its femur joint."""
    femur_length, tibia_length = math.hypot(*femur), math.hypot(*tibia)
    return abs(femur_length - tibia_length), femur_length + tibia_length


def stance_angles(coxa: Vector2, femur: Vector2, tibia: Vector2, foot: Vector2) -> tuple[float, float]:
    """Return femur and tibia angle (rad) that put the foot at (outward, up) of the coxa axis, knee up.

    The triangle femur joint, knee, foot by the law of cosines. Raises InputError when it does not close.
    """
    outward, up = foot[0] - coxa[0], foot[1] - coxa[1]
    distance = math.hypot(outward, up)
    least, most = leg_reach_m(femur, tibia)
    if not least < distance < most:
        raise InputError(
            f"the foot is {distance:.4f} m from the femur joint; allowed: {least:.4f} to {most:.4f} m"
        )
    femur_length, tibia_length = math.hypot(*femur), math.hypot(*tibia)
    at_hip = math.acos((femur_length**2 + distance**2 - tibia_length**2) / (2 * femur_length * distance))
    at_knee = math.acos((femur_length**2 + tibia_length**2 - distance**2) / (2 * femur_length * tibia_length))
    femur_slope = math.atan2(up, outward) + at_hip
    tibia_slope = femur_slope + at_knee - math.pi
    femur_rad = femur_slope - math.atan2(femur[1], femur[0])
    tibia_rad = tibia_slope - math.atan2(tibia[1], tibia[0]) - femur_rad
    return math.remainder(femur_rad, math.tau), math.remainder(tibia_rad, math.tau)
