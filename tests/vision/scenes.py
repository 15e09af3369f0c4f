"""Scenes that tests look at: a robot with a tag, tags on the floor, and a webcam 2.3 m away at 45 deg."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z
from hexctl.simulators.camera.rendering import (
    CAMERA,
    FLOOR_TAGS,
    ROBOT_TAG,
    WEBCAM,
    RobotPosture,
    SceneRenderer,
    tag_on,
)
from hexctl.types import FloatArray
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.video.videos import VideoWriter

__all__ = ["CAMERA", "FLOOR_TAGS", "ROBOT_TAG", "WEBCAM", "tag_on"]
FLOOR_CORNERS = {number: tag.corners for number, tag in FLOOR_TAGS.items()}


def plain(brightness: int) -> np.ndarray:
    """Picture of one brightness."""
    return np.full((48, 64, 3), brightness, dtype=np.uint8)


def standing(robot: Robot, pose: PlanarPose, joints_rad: FloatArray | None = None) -> RobotPosture:
    """Robot that stands level at a place."""
    return RobotPosture(
        np.array([pose.x_m, pose.y_m, robot.standing_height_m]),
        about_z(pose.yaw_rad),
        robot.stance_angles_rad if joints_rad is None else joints_rad,
    )


@contextmanager
def scene(tags: Mapping[int, PlacedTag] = FLOOR_TAGS) -> Iterator[SceneRenderer]:
    """The usual scene, unless other tags lie on the floor."""
    model = load_robot("ant")
    with SceneRenderer(model, CAMERA, tags, tag_on(model)) as renderer:
        yield renderer


#: Rate and length of a film.
FILM_FPS, FILM_PICTURES = 10.0, 50


def filmed_pose(number: int) -> PlanarPose:
    """Where the robot is in a picture of a film: it stands for a second, then goes along an arc."""
    walked = max(0, number - 10) / FILM_FPS
    return PlanarPose(0.1 * walked, 0.05 * walked, 0.1 * walked)


def film_walk(folder: Path) -> None:
    """Make a video of a walk of `ant` (walk.mp4), and the calibration of its lens (lens.yaml)."""
    import cv2

    save_lens(WEBCAM, folder / "lens.yaml")
    with scene() as renderer, VideoWriter(folder / "walk.mp4", FILM_FPS) as writer:
        for number in range(FILM_PICTURES):
            color = renderer.draw_color(standing(load_robot("ant"), filmed_pose(number)))
            writer.write(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR)), number / FILM_FPS)
