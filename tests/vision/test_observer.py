"""A robot under a rendered camera that is knocked or sees badly: what is published makes no jump."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import about_z
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import MODULES, UNIT_CORNERS, Picture, TagFinder, tag_modules
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observer
from hexctl.vision.robot_link import LegState
from hexctl.vision.twin.rendering import RobotPosture, SceneRenderer
from tests.driven import Driven, driven
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, ROBOT_TAG, WEBCAM, tag_on

pytestmark = pytest.mark.slow
ROBOT = load_robot("ant")
HERE = Camera(WEBCAM.scaled(960, 540), CAMERA.rotation, CAMERA.position_floor)
TAG = tag_on(ROBOT)

#: Ticks of 20 ms for each picture, and by how many of them it comes late.
TICKS, LATE_TICKS = 4, 4

#: A picture, disturbed, by its time and the true pose in it.
Disturbance = Callable[[Picture, float, PlanarPose], Picture]


@dataclass(frozen=True, eq=False)
class Filmed:
    """A walk, and the pictures of it, one each `TICKS` ticks."""

    walk: Driven
    pictures: list[Picture]


@pytest.fixture(scope="module")
def filmed() -> Filmed:
    """It stands for a second, walks ahead for 3 s and turns for 2 s, in an arc."""
    walk = driven("ant", ((1, 0, 0, 0), (3, 1, 0, 0), (2, 0.6, 0, 0.5)))
    pictures = []
    with SceneRenderer(ROBOT, HERE, FLOOR_TAGS, TAG) as renderer:
        for tick in range(0, len(walk.times_s), TICKS):
            x_m, y_m, yaw_rad = walk.poses[tick].tolist()
            position = np.array([x_m, y_m, walk.height_m[tick]])
            pictures.append(renderer.draw(RobotPosture(position, about_z(yaw_rad), walk.joints_rad[tick])))
    return Filmed(walk, pictures)


def followed(filmed: Filmed, disturb: Disturbance) -> list[PoseEstimate]:
    """What is published tick by tick, of pictures that come late."""
    observer = Observer(ROBOT, HERE, FLOOR_CORNERS, TAG, finder=TagFinder(), latency_s=0.02 * LATE_TICKS)
    published = []
    for tick, at_s in enumerate(filmed.walk.times_s.tolist()):
        observer.listen(LegState(at_s, filmed.walk.joints_rad[tick], None, None))
        taken = tick - LATE_TICKS
        if taken >= 0 and taken % TICKS == 0:
            pose = PlanarPose(*filmed.walk.poses[taken].tolist())
            observer.look(disturb(filmed.pictures[taken // TICKS], 0.02 * taken, pose), at_s)
        published.append(observer.estimate(at_s))
    return published


def errors_m(filmed: Filmed, published: list[PoseEstimate]) -> tuple[float, float]:
    """Greatest distance from the truth after the first second, and greatest step beyond the robot's."""
    found = [(math.nan, math.nan) if one.pose is None else (one.pose.x_m, one.pose.y_m) for one in published]
    off_m = np.array(found) - filmed.walk.poses[:, :2]
    jumps_m = np.hypot(*np.diff(off_m, axis=0).T)
    return float(np.nanmax(np.hypot(*off_m[50:].T))), float(np.nanmax(jumps_m))


def corners_px(pose: PlanarPose, side_m: float) -> FloatArray:
    """Corners of a square at the height of the robot's tag in the picture, (4, 2)."""
    corners = pose.of_points(side_m * UNIT_CORNERS)
    height_m = ROBOT.standing_height_m + TAG.height_m
    return HERE.pixels(np.column_stack([corners, np.full(4, height_m)]))


def glare(picture: Picture, at_s: float, pose: PlanarPose) -> Picture:
    """For a second and a half a lamp is mirrored on a part of the tag, with a halo."""
    import cv2

    if not 2.0 <= at_s < 3.5:
        return picture
    light = np.zeros(picture.shape, dtype=np.float32)
    middle = corners_px(pose, 0.1)[:2].mean(axis=0)
    cv2.circle(light, tuple(int(place) for place in middle), 9, 400.0, cv2.FILLED)
    return np.asarray(np.clip(picture + cv2.GaussianBlur(light, (0, 0), 4), 0, 255), dtype=np.uint8)


def twin_tag(picture: Picture, at_s: float, _pose: PlanarPose) -> Picture:
    """A second tag with the number of the robot's lies nearer to the camera, and is seen larger."""
    import cv2

    if at_s < 1.25:
        return picture
    modules = np.pad(~tag_modules(ROBOT_TAG), 1, constant_values=True).astype(np.uint8) * 200 + 25
    large = cv2.resize(modules, None, fx=24, fy=24, interpolation=cv2.INTER_NEAREST)
    side = large.shape[0]
    # As printed: lower left, lower right, upper right, upper left.
    printed = np.array([[0, side], [side, side], [side, 0], [0, 0]], dtype=np.float32)
    lies = corners_px(PlanarPose(-0.5, 0.4, 0.3), 0.1 * (MODULES + 2) / MODULES)
    turn = cv2.getPerspectiveTransform(printed, lies.astype(np.float32))
    size = picture.shape[::-1]
    drawn = cv2.warpPerspective(large, turn, size, flags=cv2.INTER_AREA)
    covers = cv2.warpPerspective(np.full_like(large, 255), turn, size) > 127
    return np.where(covers, drawn, picture).astype(np.uint8)


def test_a_tag_that_cannot_be_read_for_a_while_makes_no_jump_and_is_told(filmed: Filmed) -> None:
    published = followed(filmed, glare)
    off_m, jump_m = errors_m(filmed, published)
    assert {one.sight for one in published[50:]} == {"seeing", "bridging"}
    assert off_m < 0.03
    assert jump_m < 0.02
    assert published[-1].restarts == 0


def test_a_second_tag_with_the_same_number_draws_no_robot_away(filmed: Filmed) -> None:
    published = followed(filmed, twin_tag)
    assert errors_m(filmed, published)[0] < 0.012
    assert published[-1].restarts == 0


KNOCKED = Camera.looking(HERE.lens, np.array([-1.55, 0.08, 1.6]), np.array([0.03, 0.05, 0.0]))


def test_a_knocked_camera_makes_no_jump_and_is_told() -> None:
    position = np.array([0.2, -0.1, ROBOT.standing_height_m])
    stands = RobotPosture(position, about_z(0.4), ROBOT.stance_angles_rad)
    pictures = []
    for camera in (HERE, KNOCKED):
        with SceneRenderer(ROBOT, camera, FLOOR_TAGS, TAG) as renderer:
            pictures.append(renderer.draw(stands))
    observer, changes, offs_m = Observer(ROBOT, HERE, FLOOR_CORNERS, TAG, finder=TagFinder()), [], []
    for number, picture in enumerate([pictures[0]] * 20 + [pictures[1]] * 45):
        observer.listen(LegState(number / 30, ROBOT.stance_angles_rad, None, None))
        changes.append(observer.look(picture, number / 30).change)
        estimate = observer.estimate(number / 30)
        if number >= 20:
            assert estimate.pose is not None
            offs_m.append(math.hypot(estimate.pose.x_m - 0.2, estimate.pose.y_m + 0.1))
    (told,) = [change for change in changes if change is not None]
    true_shift_m = np.linalg.norm(KNOCKED.position_floor - HERE.position_floor)
    assert (told.tag_id, told.shift_m) == (None, pytest.approx(true_shift_m, abs=0.01))
    assert max(offs_m) < 0.02
    assert offs_m[-1] < 0.005
    assert (estimate.sight, estimate.restarts) == ("seeing", 0)
