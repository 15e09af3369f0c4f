"""Inverse kinematics of one leg the slow way: cross two circles in the leg's plane, take the upper knee."""

import math

from hexctl.robot.model import Robot

Point = tuple[float, float]


def leg_angles(robot: Robot, leg: int, foot_body: tuple[float, float, float]) -> tuple[float, float, float]:
    """Coxa, femur and tibia angle of leg 1..6 for a foot in the body frame that it can reach."""
    mount = [float(value) for value in robot.mount_positions_body[leg - 1]]
    x, y, up = (foot - start for foot, start in zip(foot_body, mount, strict=True))
    coxa = math.remainder(math.atan2(y, x) - float(robot.mount_yaws_rad[leg - 1]), math.tau)
    hip, femur, tibia = (complex(*vector) for vector in robot.link_vectors_m.tolist())
    foot = complex(math.hypot(x, y), up)
    knee = _upper_crossing(hip, abs(femur), foot, abs(tibia))
    return coxa, _angle(knee - hip, femur), _angle(foot - knee, tibia * (knee - hip) / femur)


def _upper_crossing(centre: complex, radius: float, other: complex, other_radius: float) -> complex:
    """Intersection of two circles, on the left of the line from the first centre to the second."""
    distance = abs(other - centre)
    along = (distance**2 + radius**2 - other_radius**2) / (2 * distance)
    aside = math.sqrt(max(0.0, radius**2 - along**2))
    return centre + (other - centre) / distance * complex(along, aside)


def _angle(to: complex, start: complex) -> float:
    """Turn from one direction of the plane to another, counter-clockwise."""
    turn = to / start
    return math.atan2(turn.imag, turn.real)
