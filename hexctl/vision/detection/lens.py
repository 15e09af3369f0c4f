"""The lens of a camera: which ray each pixel sees.

Its file is the camera calibration of ROS (`camera_info`), which `camera_calibration`, `usb_cam` and others
write and read; those of OpenCV are read too.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from hexctl.errors import InputError, argument
from hexctl.files import atomic_write
from hexctl.robot.configs import validate
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.lens_files import complete, read_calibration

#: Models of distortion by ROS's names: five, or 8, 12 or 14 numbers of Brown and Conrady, and four of a
#: fisheye (Kannala and Brandt 2006), in OpenCV's order.
DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]

#: Rays farther than this from the axis are of no lens here.
MOST_ANGLE_DEG = 85.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lens(ArrayFields):
    """A camera without its pose. In its frame z looks out, x to the right and y down, as in OpenCV.

    Attributes:
        width_px: picture width.
        height_px: picture height.
        matrix: (3, 3), focal lengths and principal point in px; the middle of the first pixel is (0, 0).
        model: distortion model.
        distortion: coefficients of the model in OpenCV's order.
        calibrated: False for an assumed lens.
    """

    width_px: int
    height_px: int
    matrix: FloatArray
    model: DistortionModel = "plumb_bob"
    distortion: FloatArray
    calibrated: bool = True

    @classmethod
    def assumed(cls, width_px: int, height_px: int, fov_deg: float) -> "Lens":
        """Lens without distortion that sees an angle from the left to the right edge.

        Raises InputError for an angle outside of 10 to 150 deg.
        """
        if not 10 <= fov_deg <= 150:
            raise InputError(f"{argument('fov_deg')}: got {fov_deg:g}; allowed: 10 to 150 deg")
        focal_px = width_px / 2 / math.tan(math.radians(fov_deg) / 2)
        matrix = np.array(
            [[focal_px, 0.0, (width_px - 1) / 2], [0.0, focal_px, (height_px - 1) / 2], [0.0, 0.0, 1.0]]
        )
        return cls(
            width_px=width_px, height_px=height_px, matrix=matrix, distortion=np.zeros(5), calibrated=False
        )

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        return self.width_px, self.height_px

    def scaled(self, width_px: int, height_px: int) -> "Lens":
        """The same lens for another picture size of the same aspect ratio.

        Raises InputError for another aspect ratio: the camera crops its pictures in an unknown way.
        """
        if (width_px, height_px) == self.size_px:
            return self
        scale = width_px / self.width_px
        if abs(height_px - scale * self.height_px) > 1:
            raise InputError(
                f"the lens was calibrated with {self.width_px}x{self.height_px} px and the pictures have "
                f"{width_px}x{height_px}; allowed: pictures of the same shape"
            )
        # The first pixel's middle is half a pixel from the corner, at any size.
        shift = np.array([[scale, 0.0, (scale - 1) / 2], [0.0, scale, (scale - 1) / 2], [0.0, 0.0, 1.0]])
        return replace(self, width_px=width_px, height_px=height_px, matrix=shift @ self.matrix)

    def rays(self, points_px: FloatArray) -> FloatArray:
        """Directions (N, 3) that pixels see, in the camera's frame with z = 1, or NaN (`MOST_ANGLE_DEG`)."""
        points = np.asarray(points_px, dtype=float).reshape(-1, 1, 2)
        if self.model == "equidistant":
            even = cv2.fisheye.undistortPoints(points, self.matrix, self.distortion)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
            even = cv2.undistortPoints(points, self.matrix, self.distortion, criteria=criteria)
        flat = np.asarray(even, dtype=float).reshape(-1, 2)
        beyond = np.hypot(*flat.T) > math.tan(math.radians(MOST_ANGLE_DEG))
        flat[beyond] = math.nan
        return np.column_stack([flat, np.ones(len(flat))])

    def pixels(self, points_camera: FloatArray) -> FloatArray:
        """Project points (N, 3) in m in the camera's frame to pixels (N, 2); NaN behind the camera."""
        points = np.asarray(points_camera, dtype=float).reshape(-1, 3)
        visible = points[:, 2] > 0
        seen = np.full((len(points), 2), math.nan)
        if visible.any():
            chosen = np.ascontiguousarray(points[visible]).reshape(-1, 1, 3)
            none = np.zeros(3)
            project = cv2.fisheye.projectPoints if self.model == "equidistant" else cv2.projectPoints
            projected = project(chosen, none, none, self.matrix, self.distortion)[0]
            seen[visible] = np.asarray(projected).reshape(-1, 2)
        return seen


class _Matrix(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    data: list[float]


class _LensFile(BaseModel):
    """The needed fields of a ROS camera calibration."""

    model_config = ConfigDict(allow_inf_nan=False)

    image_width: Annotated[int, Field(ge=16, le=20000)]
    image_height: Annotated[int, Field(ge=16, le=20000)]
    camera_matrix: _Matrix
    distortion_model: DistortionModel = "plumb_bob"
    distortion_coefficients: _Matrix


def load_lens(path: str | Path) -> Lens:
    """Lens of a camera calibration of ROS or OpenCV. Raises InputError for anything else."""
    path = Path(path)
    content = validate(_LensFile, read_calibration(path), path)
    matrix, coefficients = content.camera_matrix.data, content.distortion_coefficients.data
    if len(matrix) != 9 or min(matrix[0], matrix[4]) <= 0 or matrix[3] != 0 or matrix[6:] != [0, 0, 1]:
        raise InputError(
            f"{path}: camera_matrix.data: got {matrix}; allowed: 9 numbers row by row, focal lengths above "
            "0, the last row 0, 0, 1 (MATLAB's is transposed)"
        )
    coefficients = complete(content.distortion_model, coefficients, path)
    return Lens(
        width_px=content.image_width,
        height_px=content.image_height,
        matrix=np.array(matrix).reshape(3, 3),
        model=content.distortion_model,
        distortion=np.array(coefficients),
    )


def save_lens(lens: Lens, path: Path) -> None:
    """Write a lens as a camera calibration in ROS's format. Raises OSError."""
    no_rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    projection = np.column_stack([lens.matrix, np.zeros(3)])
    content = {
        "image_width": lens.width_px,
        "image_height": lens.height_px,
        "camera_name": "camera",
        "camera_matrix": _matrix(3, 3, lens.matrix),
        "distortion_model": lens.model,
        "distortion_coefficients": _matrix(1, len(lens.distortion), lens.distortion),
        "rectification_matrix": {"rows": 3, "cols": 3, "data": no_rotation},
        "projection_matrix": _matrix(3, 4, projection),
    }
    atomic_write(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _matrix(rows: int, cols: int, values: FloatArray) -> dict[str, object]:
    return {"rows": rows, "cols": cols, "data": [float(value) for value in np.ravel(values)]}
