"""What a rendered camera looks at unless told otherwise: tags, from 2.3 m away, at 45 deg."""

import numpy as np

from hexctl.robot.model import Robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.twin.rendering import PlacedTag
from hexctl.vision.twin.twin_options import LOOK_AT_M, POSITION_M

#: Number of the robot's tag, and length of its edge.
ROBOT_TAG, ROBOT_EDGE_M = 10, 0.1

#: A webcam whose lens bends lines at the edge by 20 px.
WEBCAM = Lens(
    width_px=1280,
    height_px=720,
    matrix=np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]]),
    distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
)

#: Field of view of a webcam with pictures of another shape, whose lens bends nothing.
FOV_DEG = 67.0

CAMERA = Camera.looking(WEBCAM, np.array(POSITION_M), np.array(LOOK_AT_M))

#: Tags on the floor by number, as large as `hexctl see print` makes them.
FLOOR_TAGS = {
    number: PlacedTag(number, edge_m, PlanarPose(*place))
    for number, (edge_m, *place) in enumerate(
        [(0.11, 0.0, 0.9, 0.3), (0.16, 0.2, -0.95, 1.0), (0.16, 0.9, 0.1, 2.0), (0.16, -0.6, 0.0, 0.0)]
    )
}


def tag_on(robot: Robot, edge_m: float = ROBOT_EDGE_M) -> PlacedTag:
    """Tag in the middle of a robot's trunk, on top of it."""
    return PlacedTag(ROBOT_TAG, edge_m, PlanarPose(0, 0, 0), robot.body.size_m[2] / 2 + 0.001)
