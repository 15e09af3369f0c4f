"""A webcam over the floor: how far off a robot is seen, place by place."""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z, wrapped_rad
from hexctl.simulators.camera.rendering import RobotPosture, SceneRenderer, tag_on
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.floor import LearnedFloor, averaged_corners, learn_floor
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.observer import Observer
from hexctl.vision.place_learning import LEARNING_PICTURES
from hexctl.vision.robot_link import LegState

#: Half of the floor: ahead of the camera, and to its side, in m.
HALF_FLOOR_M = (1.0, 1.5)

#: Tags on the floor as `hexctl see print` makes them, the home tag in the middle.
FLOOR_TAGS = {
    number: PlacedTag(number, edge_m, PlanarPose(*place))
    for number, edge_m, place in (
        (0, 0.11, (0.0, 0.0, 0.0)),
        (1, 0.16, (0.1, 1.1, 0.5)),
        (2, 0.16, (0.0, -1.0, 2.0)),
        (3, 0.16, (0.9, 0.2, -1.0)),
    )
}

#: Period of the pictures.
PERIOD_S = 1 / 30

#: Away from the floor, so that no tag is covered.
AWAY = PlanarPose(50.0, 0.0, 0.0)


class NoisyFinder(TagFinder):
    """A finder whose corners have noise on top of that of the pictures.

    Args:
        noise_px: standard deviation of each coordinate.
        seed: of the noise.
    """

    def __init__(self, noise_px: float, seed: int = 0) -> None:
        super().__init__()
        self._noise_px, self._random = noise_px, np.random.default_rng(seed)

    def search(self, gray: Picture, *, thorough: bool = False) -> dict[int, SeenTag]:
        """Search."""
        return self._noisy(super().search(gray, thorough=thorough))

    def near(self, gray: Picture, expected_px: Mapping[int, FloatArray]) -> dict[int, SeenTag]:
        """Look near."""
        return self._noisy(super().near(gray, expected_px))

    def _noisy(self, found: Mapping[int, SeenTag]) -> dict[int, SeenTag]:
        return {
            tag_id: SeenTag(
                tag_id,
                seen_tag.corners_px + self._random.normal(0.0, self._noise_px, (4, 2)),
                seen_tag.margin,
            )
            for tag_id, seen_tag in found.items()
        }


@dataclass(frozen=True, slots=True, eq=False)
class FloorErrors:
    """How far off a robot was seen, at each of N places on the floor of the home tag.

    Attributes:
        places: true x and y in m, (N, 2).
        off_m: seen minus true, (N, 2); NaN where it was not seen.
        off_rad: of the heading, (N,).
        frame_s: processor time of each picture, (N,).
        floor: as it was learned.
    """

    places: FloatArray
    off_m: FloatArray
    off_rad: FloatArray
    frame_s: FloatArray
    floor: LearnedFloor

    @property
    def seen(self) -> FloatArray:
        """Whether the robot was seen, (N,) of 0 and 1."""
        return np.isfinite(self.off_rad).astype(float)

    @property
    def position_rms_m(self) -> float:
        """RMS distance from the true place, where it was seen; NaN where it was not seen at all."""
        return _rms(np.hypot(*self.off_m.T))

    @property
    def yaw_rms_rad(self) -> float:
        """RMS error of the heading, where it was seen; NaN where it was not seen at all."""
        return _rms(self.off_rad)


def floor_errors(
    camera: Camera, believed: Lens, step_m: float, *, noise_px: float = 0.0, pictures: int = 1, seed: int = 0
) -> FloorErrors:
    """Stand `ant` on a grid of places, turned at random, and look where it is.

    Args:
        camera: that takes the pictures.
        believed: its lens, as it was calibrated.
        step_m: of the grid.
        noise_px: of each corner, on top of that of the pictures.
        pictures: at each place; what counts is what one says alone, or the filter after several.
        seed: of headings and noise.
    """
    robot = load_robot("ant")
    tag = tag_on(robot)
    random, finder = np.random.default_rng(seed), NoisyFinder(noise_px, seed)
    reach_x, reach_y = (np.arange(-half_m, half_m + 1e-9, step_m) for half_m in HALF_FLOOR_M)
    places = np.array([(x, y) for x in reach_x for y in reach_y])
    off, frame_s = np.full((len(places), 3), np.nan), np.zeros(len(places))
    with SceneRenderer(robot, camera, FLOOR_TAGS, tag, seed=seed) as renderer:
        empty = [renderer.draw(_standing(robot, AWAY)) for _ in range(LEARNING_PICTURES)]
        found = finder.search(empty[0], thorough=True)
        near = {number: one.corners_px for number, one in found.items()}
        views = [finder.near(gray, near) for gray in empty]
        edges_m = {number: one.edge_m for number, one in FLOOR_TAGS.items()}
        floor = learn_floor(believed, averaged_corners(views), edges_m)
        for row, (x_m, y_m) in enumerate(places):
            true = PlanarPose(float(x_m), float(y_m), float(random.uniform(-np.pi, np.pi)))
            drawn = [renderer.draw(_standing(robot, true)) for _ in range(pictures + 1)]
            pose, frame_s[row] = _looked(robot, floor, tag, finder, drawn)
            if pose is not None:
                off[row] = pose.x_m - true.x_m, pose.y_m - true.y_m, wrapped_rad(pose.yaw_rad - true.yaw_rad)
    return FloorErrors(places, off[:, :2], off[:, 2], frame_s, floor)


def _rms(values: FloatArray) -> float:
    """RMS of the values (N,) that are not NaN; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if known.size else float("nan")


def _standing(robot: Robot, pose: PlanarPose) -> RobotPosture:
    position = np.array([pose.x_m, pose.y_m, robot.standing_height_m])
    return RobotPosture(position, about_z(pose.yaw_rad), robot.stance_angles_rad)


def _looked(
    robot: Robot, floor: LearnedFloor, tag: PlacedTag, finder: TagFinder, pictures: list[Picture]
) -> tuple[PlanarPose | None, float]:
    """Where the robot is by some pictures, and the processor time of each; the first only finds the tag."""
    corners = {number: one.corners for number, one in floor.tags.items()}
    observer = Observer(robot, floor.camera, corners, tag, finder=finder)
    began_s, seen, pose = 0.0, None, None
    for number, picture in enumerate(pictures):
        at_s = number * PERIOD_S
        began_s = time.process_time() if number == 1 else began_s
        observer.listen(LegState(at_s, robot.stance_angles_rad, None, None))
        seen = observer.look(picture, at_s).robot
        pose = observer.estimate(at_s).pose
    took_s = (time.process_time() - began_s) / (len(pictures) - 1)
    if len(pictures) == 2:
        pose = None if seen is None else seen.pose_floor
    return pose, took_s
