"""Pose of the body over its feet, as a command: roll, pitch, yaw, sway and height."""

from dataclasses import astuple, dataclass, fields
from typing import Annotated

import numpy as np

from hexctl.options import Range, check_fields
from hexctl.types import FloatArray

#: Accepted angles and distances; the legs reach less.
ANGLE = Range(low=-1.0, high=1.0, unit="rad")
DISTANCE = Range(low=-1.0, high=1.0, unit="m")


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyPose:
    """Pose of the body relative to where its gait carries it, over feet that stay in place.

    The axes are those of REP 103: x forward, y left, z up. The body turns about its origin by roll, then
    pitch, then yaw about the axes of the level body. Raises InputError beyond 1 rad or 1 m.

    Attributes:
        roll_rad: positive lifts the left side.
        pitch_rad: positive lowers the front.
        yaw_rad: counter-clockwise.
    """

    roll_rad: Annotated[float, ANGLE] = 0.0
    pitch_rad: Annotated[float, ANGLE] = 0.0
    yaw_rad: Annotated[float, ANGLE] = 0.0
    forward_m: Annotated[float, DISTANCE] = 0.0
    left_m: Annotated[float, DISTANCE] = 0.0
    up_m: Annotated[float, DISTANCE] = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        for field in fields(self):
            object.__setattr__(self, field.name, float(getattr(self, field.name)))

    @classmethod
    def of(cls, numbers: FloatArray) -> "BodyPose":
        """Pose of its numbers, (6,), in the order of the fields."""
        names = (field.name for field in fields(cls))
        return cls(**dict(zip(names, numbers.tolist(), strict=True)))

    @property
    def array(self) -> FloatArray:
        """Its numbers, (6,), in the order of the fields."""
        return np.array(astuple(self))


#: The body as its gait carries it.
LEVEL = BodyPose()


def feet_from_body(feet_m: FloatArray, poses: FloatArray) -> FloatArray:
    """Feet in the frames of posed bodies, leading shape + (6, 3) in m.

    With R of roll, pitch and yaw and the shift t of a pose, p becomes R^T (p - t): a rigid motion.

    Args:
        feet_m: in the frame of the level body.
        poses: numbers of `BodyPose`, leading shape + (6,).
    """
    cos, sin = np.cos(poses[..., :3]), np.sin(poses[..., :3])
    x, y, z = (feet_m[..., axis] - poses[..., 3 + axis, np.newaxis] for axis in range(3))
    (c_roll, c_pitch, c_yaw), (s_roll, s_pitch, s_yaw) = (
        [numbers[..., axis, np.newaxis] for axis in range(3)] for numbers in (cos, sin)
    )
    x, y = c_yaw * x + s_yaw * y, c_yaw * y - s_yaw * x
    x, z = c_pitch * x - s_pitch * z, c_pitch * z + s_pitch * x
    y, z = c_roll * y + s_roll * z, c_roll * z - s_roll * y
    return np.stack([x, y, z], axis=-1)
