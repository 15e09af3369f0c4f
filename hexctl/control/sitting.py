"""Sitting down: from where the joints are to the body on the floor."""

import numpy as np

from hexctl.errors import LimitError, ReachError
from hexctl.ik.legs import solve_legs_within_limits
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: How long sitting down takes.
SITTING_S = 2.0


def sitting_angles_rad(robot: Robot) -> FloatArray:
    """Return the joint angles, (18,), that bring the body as low as the legs can, the feet where they are."""
    lift_m = robot.standing_height_m - robot.body.size_m[2] / 2
    for share in np.linspace(1.0, 0.0, 21).tolist():
        feet_body = robot.stance_feet_body + np.array([0.0, 0.0, share * lift_m])
        try:
            return solve_legs_within_limits(robot, feet_body)
        except (ReachError, LimitError):
            continue
    return robot.stance_angles_rad
