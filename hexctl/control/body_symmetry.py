"""Turns and mirrorings of a body that put every leg where there was one: the symmetries of a robot."""

import math
from dataclasses import dataclass, replace

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray, by_leg

#: Two positions or angles this near are the same, in m and rad.
SAME = 1e-4

#: Trunks' centres of mass this near are the same, in m. The worlds of a prior shift them by up to 15 mm each
#: way, and a sample has to be plausible, not exact.
SAME_COM_M = 4e-3

#: Moments of inertia are the same up to this share.
SAME_INERTIA = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class BodySymmetry:
    """A turn or a mirroring of the body that puts every leg where there was one.

    Attributes:
        legs: leg `legs[k - 1]` is where leg k comes to lie.
        mirrored: whether left and right change places; deviations then change their sign.
        turn_deg: by how much the body is turned, after the mirroring.
    """

    legs: tuple[int, ...]
    mirrored: bool
    turn_deg: float

    @property
    def keeps_heading(self) -> bool:
        """Whether the forward direction is kept."""
        return abs(math.radians(math.remainder(self.turn_deg, 360.0))) < SAME

    @property
    def legs_before(self) -> tuple[int, ...]:
        """The leg that comes to lie at each leg, (6,)."""
        return tuple(self.legs.index(leg) + 1 for leg in range(1, N_LEGS + 1))

    def heading_deg(self, heading_deg: float) -> float:
        """Where a direction of travel comes to lie, -180 up to 180."""
        return math.remainder(self.turn_deg + (-heading_deg if self.mirrored else heading_deg), 360.0)

    def heading_before_deg(self, heading_deg: float) -> float:
        """The direction of travel that comes to lie at one, -180 up to 180."""
        turned_deg = heading_deg - self.turn_deg
        return math.remainder(-turned_deg if self.mirrored else turned_deg, 360.0)

    def points(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) of the body frame, moved."""
        turn_rad, flip = math.radians(self.turn_deg), -1.0 if self.mirrored else 1.0
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        x, y = points[..., 0], flip * points[..., 1]
        return np.stack([cos * x - sin * y, sin * x + cos * y, points[..., 2]], axis=-1)

    def joints(self, angles_rad: FloatArray) -> FloatArray:
        """Angles of all joints, (..., 18), of the moved robot; a mirror changes the sign of the coxae."""
        moved = by_leg(angles_rad)[..., np.array(self.legs_before) - 1, :]
        if self.mirrored:
            moved[..., 0] = -moved[..., 0]
        return moved.reshape(angles_rad.shape)


#: The body as it is.
IDENTITY = BodySymmetry(legs=tuple(range(1, N_LEGS + 1)), mirrored=False, turn_deg=0.0)


def body_symmetries(robot: Robot) -> tuple[BodySymmetry, ...]:
    """Every symmetry of a robot's geometry, the identity first."""
    moves = (_moving_first_to(robot, goal, mirrored) for mirrored in (False, True) for goal in range(N_LEGS))
    return tuple(move for move in moves if move is not None)


def _moving_first_to(robot: Robot, goal: int, mirrored: bool) -> BodySymmetry | None:
    yaws_rad = robot.mount_yaws_rad
    turn_deg = round(math.degrees(yaws_rad[goal] - (-1 if mirrored else 1) * yaws_rad[0]), 6)
    move = BodySymmetry(legs=IDENTITY.legs, mirrored=mirrored, turn_deg=turn_deg)
    near = _apart(robot, move) < SAME
    if not _trunk_allows(robot, move) or not near.any(axis=1).all():
        return None
    return replace(move, legs=tuple((near.argmax(axis=1) + 1).tolist()))


def _trunk_allows(robot: Robot, move: BodySymmetry) -> bool:
    """Whether the trunk is the same after a move: its shape, its inertia and its centre of mass."""
    body, com_m = robot.body, np.array(robot.body.com_m)
    half, quarter = (
        abs(math.remainder(math.radians(move.turn_deg), angle)) < SAME for angle in (math.pi, math.pi / 2)
    )
    x, y, _ = body.inertia_kg_m2 or (1.0, 1.0, 1.0)
    uneven = abs(x - y) > SAME_INERTIA * max(x, y)
    if np.linalg.norm(move.points(com_m) - com_m) > SAME_COM_M or (uneven and not half):
        return False
    square = body.size_m[0] == body.size_m[1]
    return body.shape == "cylinder" or half or (square and quarter)


def _apart(robot: Robot, move: BodySymmetry) -> FloatArray:
    """By how much each moved leg differs from each leg, in mount, foot, limits and yaw, (moved, legs)."""
    names = ("joint_lower_rad", "joint_upper_rad", "joint_max_speed_rad_s", "joint_max_torque_nm")
    limits = np.stack([by_leg(getattr(robot, name)) for name in names], axis=1)
    flipped = limits.copy()
    if move.mirrored:  # the coxae's angles change sign
        flipped[:, :2, 0] = -limits[:, 1::-1, 0]
    points = (robot.mount_positions_body, robot.stance_feet_body)
    legs = np.hstack([*points, limits.reshape(N_LEGS, -1)])
    moved = np.hstack([*map(move.points, points), flipped.reshape(N_LEGS, -1)])
    yaws_rad = robot.mount_yaws_rad
    moved_rad = math.radians(move.turn_deg) + (-1 if move.mirrored else 1) * yaws_rad
    turns_rad = np.angle(np.exp(1j * (moved_rad[:, np.newaxis] - yaws_rad)))
    return np.asarray(np.maximum(np.abs(moved[:, np.newaxis] - legs).max(axis=-1), np.abs(turns_rad)))
