"""Poses of a video, one row for each picture, as CSV."""

import csv
import math
from pathlib import Path
from typing import Self

from hexctl.errors import InputError, argument
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation

#: Names of the columns. `seen_` is what this picture alone says, the others what is believed after it.
COLUMNS = (
    "at_s", "sight", "x_m", "y_m", "yaw_rad", "age_s", "seen_x_m", "seen_y_m", "seen_yaw_rad", "quality"
)  # fmt: skip


class PoseTable:
    """Writes rows as they come; what is not known is empty."""

    def __init__(self, path: Path) -> None:
        """Begin a new file. Raises InputError where that is not possible."""
        try:
            self._file = path.open("x", buffering=1, encoding="utf-8", newline="")
        except OSError as error:
            raise InputError(f"{argument('poses')}: {path} cannot be written: {error.strerror}") from error
        self._rows = csv.writer(self._file)
        self._rows.writerow(COLUMNS)

    def write(self, at_s: float, estimate: PoseEstimate, observation: Observation) -> None:
        """Write a row for a picture that came at a time."""
        robot = observation.robot
        age = f"{estimate.age_s:.3f}" if math.isfinite(estimate.age_s) else ""
        row = [f"{at_s:.4f}", estimate.sight, *_numbers(estimate.pose), age]
        row += _numbers(None if robot is None else robot.pose_floor)
        row.append("" if robot is None else f"{robot.quality:.3f}")
        self._rows.writerow(row)

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _numbers(pose: PlanarPose | None) -> list[str]:
    return ["", "", ""] if pose is None else [f"{one:.5f}" for one in (pose.x_m, pose.y_m, pose.yaw_rad)]
