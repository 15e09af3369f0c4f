"""The symmetries of a robot: which legs may be taken for which, and what becomes of a gait's code."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.space import GaitSpace
from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, N_LEGS, FloatArray

#: Two places or angles this near are the same, in m and rad.
SAME = 1e-4


@dataclass(frozen=True)
class Symmetry:
    """A turn or a mirroring of the body that puts every leg where there was one.

    Attributes:
        legs: leg `legs[k - 1]` is where leg k comes to lie.
        mirrored: True when left and right change places; deviations then change their sign.
        turn_rad: by how much the body is turned, after the mirroring.
    """

    legs: tuple[int, ...]
    mirrored: bool
    turn_rad: float = 0.0

    @property
    def keeps_heading(self) -> bool:
        """Return whether what points forward still does."""
        return abs(math.remainder(self.turn_rad, 2 * math.pi)) < SAME

    def keeps_phase(self, leg: int) -> bool:
        """Return whether a gait also keeps its start phase when this leg failed.

        A failed leg pins its own slot. Where it becomes another leg all slots shift, and the walk begins at
        another point of the cycle: nearly the same walk, but not exactly.
        """
        return self.legs[leg - 1] == leg

    def codes(self, leg: int) -> NDArray[np.int64]:
        """Return, for codes 1..120 with this leg failed, the codes of the moved gaits, (120,)."""
        before, moved_leg = GaitSpace((leg,)), self.legs[leg - 1]
        slots = np.empty_like(before.slots)
        slots[:, np.array(self.legs) - 1] = before.slots
        shift = moved_leg - slots[:, [moved_leg - 1]]
        after = GaitSpace((moved_leg,))
        return np.array([after.code_of(row) for row in ((slots + shift - 1) % N_LEGS + 1).tolist()])

    def joints(self, angles_rad: FloatArray) -> FloatArray:
        """Return angles of all joints, (..., 18), as the moved robot has them; a mirror turns coxae over."""
        before = angles_rad.reshape(*angles_rad.shape[:-1], N_LEGS, JOINTS_PER_LEG)
        moved = np.empty_like(before)
        moved[..., np.array(self.legs) - 1, :] = before
        if self.mirrored:
            moved[..., 0] = -moved[..., 0]
        return moved.reshape(angles_rad.shape)


class Symmetries:
    """All symmetries of a robot, the identity first."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @cached_property
    def all(self) -> tuple[Symmetry, ...]:
        """Return every symmetry of the robot's geometry; its servos and links are alike anyway."""
        found = [
            symmetry
            for mirrored in (False, True)
            for goal in range(N_LEGS)
            if (symmetry := self._moving_first_to(goal, mirrored)) is not None
        ]
        return tuple(found)

    def _moving_first_to(self, goal: int, mirrored: bool) -> Symmetry | None:
        """Return the symmetry that moves leg 1 to a leg, if there is one."""
        robot = self._robot
        flip = -1.0 if mirrored else 1.0
        turn_rad = float(robot.mount_yaws_rad[goal] - flip * robot.mount_yaws_rad[0])
        if not self._trunk_allows(turn_rad):
            return None
        legs = []
        for leg in range(N_LEGS):
            at = self._leg_at(turn_rad, flip, leg)
            if at is None:
                return None
            legs.append(at + 1)
        return Symmetry(tuple(legs), mirrored, turn_rad)

    def _trunk_allows(self, turn_rad: float) -> bool:
        """Return whether the trunk looks the same after a turn; every trunk does after a mirroring."""
        body = self._robot.body
        if body.shape == "cylinder":
            return True
        quarter = math.pi / 2 if body.size_m[0] == body.size_m[1] else math.pi
        return abs(math.remainder(turn_rad, quarter)) < SAME

    def _leg_at(self, turn_rad: float, flip: float, leg: int) -> int | None:
        """Return which leg is where a leg comes to lie, joints that reach as far included."""
        robot = self._robot
        place = _moved(robot.mount_positions_body[leg], turn_rad, flip)
        foot = _moved(robot.stance_feet_body[leg], turn_rad, flip)
        yaw_rad = turn_rad + flip * robot.mount_yaws_rad[leg]
        for other in range(N_LEGS):
            off = [
                np.abs(robot.mount_positions_body[other] - place).max(),
                np.abs(robot.stance_feet_body[other] - foot).max(),
                abs(math.remainder(robot.mount_yaws_rad[other] - yaw_rad, 2 * math.pi)),
                np.abs(_limits(robot, other) - _flipped(_limits(robot, leg), flip)).max(),
            ]
            if max(off) < SAME:
                return other
        return None


def _moved(point: FloatArray, turn_rad: float, flip: float) -> FloatArray:
    """Return a point of the body frame after mirroring left and right, if asked, and then a turn."""
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    x, y, z = point[0], flip * point[1], point[2]
    return np.array([cos * x - sin * y, sin * x + cos * y, z])


def _limits(robot: Robot, leg: int) -> FloatArray:
    """Return the limits of a leg's joints: angles, speed and torque, (4, 3)."""
    joints = slice(JOINTS_PER_LEG * leg, JOINTS_PER_LEG * (leg + 1))
    return np.array(
        [
            robot.joint_lower_rad[joints],
            robot.joint_upper_rad[joints],
            robot.joint_max_speed_rad_s[joints],
            robot.joint_max_torque_nm[joints],
        ]
    )


def _flipped(limits: FloatArray, flip: float) -> FloatArray:
    """Return the limits of a leg seen in a mirror: the coxa's angles change sides."""
    if flip > 0:
        return limits
    mirrored = limits.copy()
    mirrored[0, 0], mirrored[1, 0] = -limits[1, 0], -limits[0, 0]
    return mirrored
