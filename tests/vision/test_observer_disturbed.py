"""A robot walks under a rendered camera whose pictures are disturbed: what is published makes no jump."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import about_z
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import MODULES, UNIT_CORNERS, Picture, tag_modules
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observer
from hexctl.vision.robot_link import LegState
from hexctl.vision.twin.rendering import CameraFlaws, RobotPosture, SceneRenderer
from hexctl.vision.twin.twin_camera import CAMERA, FLOOR_TAGS, ROBOT_TAG, WEBCAM, tag_on
from tests.driven import Driven, driven
from tests.vision.scenes import FLOOR_CORNERS

pytestmark = pytest.mark.slow


ROBOT = load_robot("ant")


HERE = Camera(WEBCAM.scaled(960, 540), CAMERA.rotation, CAMERA.position_floor)


TAG = tag_on(ROBOT)


TAG_HEIGHT_M = ROBOT.standing_height_m + TAG.height_m


#: Ticks of 20 ms for each picture, and by how many of them it comes late.
TICKS, LATE_TICKS = 4, 4


#: Greatest step of what is published beyond that of the robot, in m.
NO_JUMP_M = 0.02


#: What is done to a picture, by its number and the true pose in it; None is a picture that never comes.
Disturbance = Callable[[Picture, int, PlanarPose], Picture | None]


@dataclass(frozen=True, eq=False)
class Filmed:
    """A walk, and the pictures of it, one each `TICKS` ticks."""

    walk: Driven
    pictures: list[Picture]

    def pose(self, tick: int) -> PlanarPose:
        """Where the robot truly is."""
        return PlanarPose(*self.walk.poses[tick].tolist())


class Seen(NamedTuple):
    """What was published at a tick, and whether the tag was found in the picture that came, if any."""

    estimate: PoseEstimate
    found: bool | None


@pytest.fixture(scope="module")
def filmed() -> Filmed:
    """It stands for a second, walks ahead for 3 s and turns for 2 s, in an arc."""
    walk = driven("ant", ((1, 0, 0, 0), (3, 1, 0, 0), (2, 0.6, 0, 0.5)))
    pictures = []
    with SceneRenderer(ROBOT, HERE, FLOOR_TAGS, tag_on(ROBOT), CameraFlaws()) as renderer:
        for tick in range(0, len(walk.times_s), TICKS):
            x_m, y_m, yaw_rad = walk.poses[tick].tolist()
            position = np.array([x_m, y_m, walk.height_m[tick]])
            pictures.append(renderer.draw(RobotPosture(position, about_z(yaw_rad), walk.joints_rad[tick])))
    return Filmed(walk, pictures)


def followed(filmed: Filmed, disturb: Disturbance, *, camera: Camera = HERE) -> list[Seen]:
    """What is published tick by tick, of pictures that come late."""
    observer = Observer(ROBOT, camera, FLOOR_CORNERS, TAG, latency_s=0.02 * LATE_TICKS)
    seen = []
    for tick, at_s in enumerate(filmed.walk.times_s.tolist()):
        observer.listen(LegState(at_s, filmed.walk.joints_rad[tick], None, None))
        taken, found = tick - LATE_TICKS, None
        if taken >= 0 and taken % TICKS == 0:
            picture = disturb(filmed.pictures[taken // TICKS], taken // TICKS, filmed.pose(taken))
            found = None if picture is None else observer.look(picture, at_s).robot is not None
        seen.append(Seen(observer.estimate(at_s), found))
    return seen


def errors_m(filmed: Filmed, seen: list[Seen]) -> FloatArray:
    """Published minus true position, tick by tick, (T, 2); NaN where there is none."""
    true = filmed.walk.poses[:, :2]
    published = [
        (math.nan, math.nan) if pose is None else (pose.x_m, pose.y_m)
        for pose in (one.estimate.pose for one in seen)
    ]
    return np.asarray(np.array(published) - true)


def jump_m(filmed: Filmed, seen: list[Seen]) -> float:
    """Greatest step of what is published beyond that of the robot."""
    return float(np.nanmax(np.hypot(*np.diff(errors_m(filmed, seen), axis=0).T)))


def off_m(filmed: Filmed, seen: list[Seen]) -> float:
    """Greatest distance from the truth, from the second second on."""
    return float(np.nanmax(np.hypot(*errors_m(filmed, seen)[50:].T)))


def share_found(seen: list[Seen]) -> float:
    """Share of the pictures that came in which the robot was found."""
    return float(np.mean([one.found for one in seen if one.found is not None]))


def sights(seen: list[Seen]) -> set[str]:
    """What the poses rested on after the first second."""
    return {one.estimate.sight for one in seen[50:]}


def usual(picture: Picture, _number: int, _pose: PlanarPose) -> Picture:
    """Nothing is wrong."""
    return picture


def tag_px(pose: PlanarPose) -> FloatArray:
    """Corners of the robot's tag in the picture, (4, 2)."""
    corners = pose.of_points(0.1 * UNIT_CORNERS)
    return HERE.pixels(np.column_stack([corners, np.full(4, TAG_HEIGHT_M)]))


def unseen(number: int) -> bool:
    """Whether a picture is one of the second and a half in which the tag is disturbed."""
    return 2.0 <= number * TICKS * 0.02 < 3.5


def glare(picture: Picture, number: int, pose: PlanarPose) -> Picture:
    """A lamp is mirrored on a part of the tag: white beyond what a camera can tell, with a halo."""
    if not unseen(number):
        return picture
    light = np.zeros(picture.shape, dtype=np.float32)
    middle = tag_px(pose)[:2].mean(axis=0)
    cv2.circle(light, tuple(int(place) for place in middle), 9, 400.0, cv2.FILLED)
    return np.asarray(np.clip(picture + cv2.GaussianBlur(light, (0, 0), 4), 0, 255), dtype=np.uint8)


def test_undisturbed_it_is_followed(filmed: Filmed) -> None:
    """What disturbances are compared with."""
    seen = followed(filmed, usual)
    assert share_found(seen) > 0.95
    assert sights(seen) == {"seeing"}
    assert off_m(filmed, seen) < 0.012
    assert jump_m(filmed, seen) < 0.01


def test_a_tag_that_cannot_be_read_for_a_while_makes_no_jump_and_is_told(filmed: Filmed) -> None:
    seen = followed(filmed, glare)
    hidden = [one.found for one in seen[int(2.1 * 50) : int(3.4 * 50)] if one.found is not None]
    assert not any(hidden)
    assert sights(seen) == {"seeing", "bridging"}
    assert off_m(filmed, seen) < 0.03
    assert jump_m(filmed, seen) < NO_JUMP_M
    assert seen[-1].estimate.restarts == 0


def test_a_robot_that_leaves_the_picture_is_bridged_and_then_lost(filmed: Filmed) -> None:
    """The picture ends where the tag is half out of it after 3 s."""
    row = int(tag_px(filmed.pose(150))[:, 1].mean())
    matrix = HERE.lens.matrix.copy()
    matrix[1, 2] -= row
    lens = Lens(
        width_px=960, height_px=540 - row, matrix=matrix, model=HERE.lens.model,
        distortion=HERE.lens.distortion,
    )  # fmt: skip
    camera = Camera(lens, HERE.rotation, HERE.position_floor)

    def cut(picture: Picture, _number: int, _pose: PlanarPose) -> Picture:
        return np.ascontiguousarray(picture[row:])

    seen = followed(filmed, cut, camera=camera)
    assert "bridging" in sights(seen)
    assert jump_m(filmed, seen) < NO_JUMP_M
    assert off_m(filmed, seen) < 0.05


def with_tag(picture: Picture, number: int, pose: PlanarPose) -> Picture:
    """A picture into which the tag of another robot is drawn, with its white edge."""
    modules = np.pad(~tag_modules(number), 1, constant_values=True).astype(np.uint8) * 200 + 25
    side_m = 0.1 * (MODULES + 2) / MODULES
    corners = pose.of_points(side_m * UNIT_CORNERS)
    corners_px = HERE.pixels(np.column_stack([corners, np.full(4, TAG_HEIGHT_M)]))
    large = cv2.resize(modules, None, fx=24, fy=24, interpolation=cv2.INTER_NEAREST)
    side = large.shape[0]
    # As printed: lower left, lower right, upper right, upper left.
    printed = np.array([[0, side], [side, side], [side, 0], [0, 0]], dtype=np.float32)
    turn = cv2.getPerspectiveTransform(printed, corners_px.astype(np.float32))
    size = picture.shape[::-1]
    drawn = cv2.warpPerspective(large, turn, size, flags=cv2.INTER_AREA)
    covers = cv2.warpPerspective(np.full_like(large, 255), turn, size) > 127
    soft = cv2.GaussianBlur(np.where(covers, drawn, picture), (0, 0), 0.7)
    return np.where(cv2.dilate(covers.astype(np.uint8), np.ones((3, 3))) > 0, soft, picture).astype(np.uint8)


def test_a_second_tag_with_the_same_number_draws_no_robot_away(filmed: Filmed) -> None:
    """It lies nearer to the camera, and is seen larger."""

    def twice(picture: Picture, number: int, _pose: PlanarPose) -> Picture:
        return with_tag(picture, ROBOT_TAG, PlanarPose(-0.5, 0.4, 0.3)) if number > 15 else picture

    seen = followed(filmed, twice)
    assert share_found(seen) > 0.95
    assert off_m(filmed, seen) < 0.012
    assert seen[-1].estimate.restarts == 0
