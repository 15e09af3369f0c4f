"""The robot as pages draw it: the points of its legs, and how each is."""

from collections.abc import Collection
from typing import Any

from hexctl.ik.legs import link_points_body
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray, all_finite

#: Height of a foot above the lowest one from which it is shown as lifted, as a share of the step height.
IN_AIR = 0.25


def legs_outline(
    robot: Robot, joint_positions_rad: FloatArray, step_height_m: float, failed: Collection[int] = ()
) -> list[dict[str, Any]]:
    """Each leg from mount to foot as (forward, left, up) in stance radii, body frame; empty if unknown.

    Args:
        joint_positions_rad: (18,).
        failed: legs, 1..6, whose state is `failed`; else it is `air` for a lifted foot, or empty.
    """
    if not all_finite(joint_positions_rad):
        return []
    points_m = link_points_body(robot, joint_positions_rad)
    heights_m = points_m[:, -1, 2]
    in_air = heights_m > heights_m.min() + IN_AIR * step_height_m
    seen = (points_m / robot.stance_radius_m).round(3).tolist()
    states = ["failed" if leg + 1 in failed else "air" if in_air[leg] else "" for leg in range(N_LEGS)]
    return [{"points": each, "state": how} for each, how in zip(seen, states, strict=True)]
