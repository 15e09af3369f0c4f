"""The vocabulary of every part: arrays, legs and joints, joint targets and robot state.

Six legs of three joints each, in leg-major order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

N_LEGS = 6
JOINTS_PER_LEG = 3
N_JOINTS = N_LEGS * JOINTS_PER_LEG

#: Joints of one leg, from the body outward.
JOINT_KINDS = ("coxa", "femur", "tibia")

#: All 18 joints in the order of every joint array: leg 1 coxa, femur, tibia, leg 2 ...
JOINT_NAMES = tuple(f"leg{leg}_{kind}" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS)


def leg_slice(leg: int) -> slice:
    """Return where the three joints of leg 1..6 lie in an array of 18."""
    return slice(JOINTS_PER_LEG * (leg - 1), JOINTS_PER_LEG * leg)


FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class JointTargets:
    """Where the 18 joints shall go.

    Attributes:
        positions_rad: joint angles, shape (18,), leg-major order.
        stamp_s: when the command was made, on the clock of the servos that it is for.
    """

    positions_rad: FloatArray
    stamp_s: float


@dataclass(frozen=True, slots=True)
class RobotState:
    """What a robot knows of itself at one moment.

    Attributes:
        joint_positions_rad: shape (18,), leg-major order.
        stamp_s: when it was measured, on the clock of the servos.
        measured: True for positions from sensors, False where the last targets are echoed.
        base_position_world: body frame origin in the world, (3,) in m, or None where unknown.
        base_quaternion_world: body frame orientation (w, x, y, z), (4,), or None where unknown.
        foot_contacts: which feet touch the floor, (6,), or None where unknown.
        age_s: how old the measurement was when it was read.
        healthy: False when the robot reports a fault of its own.
        fault: what is wrong, in few words, where the robot says so.
        stopped: why the robot's own guard is stopped, or None.
        battery_v: voltage of the battery, or None where unknown.
        battery_share: what is left of it, 0 to 1, or None where unknown.
    """

    joint_positions_rad: FloatArray
    stamp_s: float
    measured: bool
    base_position_world: FloatArray | None = None
    base_quaternion_world: FloatArray | None = None
    foot_contacts: BoolArray | None = None
    age_s: float = 0.0
    healthy: bool = True
    fault: str | None = None
    stopped: str | None = None
    battery_v: float | None = None
    battery_share: float | None = None
