import csv
import math
from pathlib import Path

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation
from hexctl.vision.pose_stream import COLUMNS, PoseTable


def test_what_is_not_known_is_empty(tmp_path: Path) -> None:
    lost = PoseEstimate(at_s=1.0, sight="lost", pose=None, covariance=None, age_s=math.inf, restarts=0)
    known = PoseEstimate(
        at_s=1.1,
        sight="bridging",
        pose=PlanarPose(1.0, -2.0, 0.5),
        covariance=np.eye(3),
        age_s=0.4,
        restarts=0,
    )
    with PoseTable(tmp_path / "poses.csv") as table:
        for at_s, estimate in ((1.0, lost), (1.1, known)):
            table.write(at_s, estimate, Observation(None, False, None))
    with (tmp_path / "poses.csv").open(encoding="utf-8") as file:
        first, second = csv.DictReader(file)
    assert tuple(first) == COLUMNS
    assert [value for key, value in first.items() if key not in ("at_s", "sight")] == [""] * 8
    assert (second["x_m"], second["y_m"], second["yaw_rad"]) == ("1.00000", "-2.00000", "0.50000")
    assert (second["sight"], second["age_s"], second["seen_x_m"]) == ("bridging", "0.400", "")


def test_a_row_is_in_the_file_at_once(tmp_path: Path) -> None:
    lost = PoseEstimate(at_s=1.0, sight="lost", pose=None, covariance=None, age_s=math.inf, restarts=0)
    with PoseTable(tmp_path / "poses.csv") as table:
        table.write(1.0, lost, Observation(None, False, None))
        assert len((tmp_path / "poses.csv").read_text(encoding="utf-8").splitlines()) == 2


def test_a_file_that_exists_or_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").touch()
    for path in (tmp_path / "poses.csv", tmp_path / "nowhere" / "poses.csv"):
        with pytest.raises(InputError, match="cannot be written"):
            PoseTable(path)
