"""Poses on a plane, and the one of a tag whose height is known."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.tags import UNIT_CORNERS


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """Position and heading on a level plane.

    Attributes:
        x_m: in the frame it is given in.
        y_m: in the frame it is given in.
        yaw_rad: counter-clockwise seen from above, within ±pi.
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def after(self, motion: "PlanarPose") -> "PlanarPose":
        """This pose after a motion in its own frame."""
        x_m, y_m = self.of_points(np.array([[motion.x_m, motion.y_m]]))[0]
        return PlanarPose(float(x_m), float(y_m), wrapped_rad(self.yaw_rad + motion.yaw_rad))

    def inverse(self) -> "PlanarPose":
        """The motion that leads back."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return PlanarPose(
            -cos * self.x_m - sin * self.y_m, sin * self.x_m - cos * self.y_m, wrapped_rad(-self.yaw_rad)
        )

    def of_points(self, points: FloatArray) -> FloatArray:
        """Points (N, 2) given in the frame of this pose, in the frame that the pose is given in."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.asarray(points @ [[cos, sin], [-sin, cos]] + [self.x_m, self.y_m])


@dataclass(frozen=True, slots=True)
class PlacedTag:
    """A printed tag with a pose: on the floor, or on the robot's trunk.

    Attributes:
        tag_id: number of the tag.
        edge_m: edge of its black square.
        pose: of its middle, in the frame of the floor or of the robot's base seen from above.
        height_m: height above the floor or above the origin of the base.
    """

    tag_id: int
    edge_m: float
    pose: PlanarPose
    height_m: float = 0.0

    @property
    def corners(self) -> FloatArray:
        """Corners in the frame of the pose, (4, 2) in m."""
        return self.pose.of_points(self.edge_m * UNIT_CORNERS)

    @property
    def corners_body(self) -> FloatArray:
        """Its corners with their height, (4, 3) in m."""
        return np.column_stack([self.corners, np.full(4, self.height_m)])


@dataclass(frozen=True, slots=True)
class PlanarFit:
    """Pose, and size, by which points come nearest to where they are seen.

    Attributes:
        pose: of the frame in which the points were given.
        scale: by which they are seen larger.
        residual_m: RMS distance from where they are seen.
    """

    pose: PlanarPose
    scale: float
    residual_m: float


def fitted_pose(points: FloatArray, seen: FloatArray) -> PlanarFit:
    """Pose at which points (N, 2) are seen at other points (N, 2), both in m, by least squares.

    Rotation, scale and shift are those of Umeyama (1991) in the plane.
    """
    middle, seen_middle = points.mean(axis=0), seen.mean(axis=0)
    own, other = (points - middle) @ [1, 1j], (seen - seen_middle) @ [1, 1j]
    factor = complex(np.vdot(own, other) / np.vdot(own, own))
    residual_m = float(np.sqrt(np.mean(np.abs(other - factor * own) ** 2)))
    yaw_rad = math.atan2(factor.imag, factor.real)
    x_m, y_m = seen_middle - PlanarPose(0.0, 0.0, yaw_rad).of_points(middle[np.newaxis])[0]
    return PlanarFit(PlanarPose(float(x_m), float(y_m), yaw_rad), abs(factor), residual_m)


def tag_pose(camera: Camera, corners_px: FloatArray, height_m: float) -> PlanarFit | None:
    """Pose of a level tag at a known height, or None if its rays miss the plane.

    Intersecting rays with the plane avoids the flip ambiguity of a free tag pose. The corners (4, 2) are in
    the order of `UNIT_CORNERS`. The pose is that of the middle of the tag, x to the right and y up as
    printed. The scale is the observed edge in m; if it differs from the printed edge, the height or the
    print is wrong.
    """
    corners = camera.floor_points(corners_px, height_m)
    return fitted_pose(UNIT_CORNERS, corners) if np.isfinite(corners).all() else None
