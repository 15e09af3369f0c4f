"""Scenes that tests look at: a robot with a tag, tags on the floor, and a webcam 2.3 m away at 45 deg."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.see.camera import Camera
from hexctl.see.lens import Lens
from hexctl.see.planar_pose import PlanarPose
from hexctl.see.rendering import CameraFlaws, PlacedTag, RobotPosture, SceneRenderer
from hexctl.see.tags import UNIT_CORNERS
from hexctl.types import FloatArray

ROBOT_TAG = 10

#: A webcam whose lens bends lines at the edge by 20 px.
WEBCAM = Lens(
    width_px=1280,
    height_px=720,
    matrix=np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]]),
    distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
)
CAMERA = Camera.looking(WEBCAM, np.array([-1.63, 0.0, 1.63]), np.zeros(3))

FLOOR_TAGS = {
    number: PlacedTag(number, 0.12, PlanarPose(*place))
    for number, place in enumerate([(0.0, 0.9, 0.3), (0.2, -0.95, 1.0), (0.9, 0.1, 2.0), (-0.6, 0.0, 0.0)])
}
FLOOR_CORNERS = {number: tag.pose.of_points(UNIT_CORNERS * tag.edge_m) for number, tag in FLOOR_TAGS.items()}


def tag_on(robot: Robot, edge_m: float = 0.1) -> PlacedTag:
    """Tag in the middle of a robot's trunk."""
    return PlacedTag(ROBOT_TAG, edge_m, PlanarPose(0, 0, 0), robot.body.size_m[2] / 2 + 0.001)


def standing(robot: Robot, pose: PlanarPose, joints_rad: FloatArray | None = None) -> RobotPosture:
    """Robot that stands level at a place."""
    half = pose.yaw_rad / 2
    return RobotPosture(
        np.array([pose.x_m, pose.y_m, robot.standing_height_m]),
        np.array([np.cos(half), 0.0, 0.0, np.sin(half)]),
        robot.stance_angles_rad if joints_rad is None else joints_rad,
    )


@contextmanager
def scene(
    camera: Camera = CAMERA, flaws: CameraFlaws | None = None, robot: str = "ant", **options: Any
) -> Iterator[SceneRenderer]:
    """The usual scene, seen by a camera."""
    model = load_robot(robot)
    with SceneRenderer(model, camera, FLOOR_TAGS, tag_on(model), flaws, **options) as renderer:
        yield renderer
