from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.robot_tracker import RobotTracker
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.twin.rendering import CameraFlaws, SceneRenderer
from tests.vision.scenes import CAMERA, ROBOT_TAG, scene, standing, tag_on

ROBOT = load_robot("ant")
TAG = tag_on(ROBOT)
HERE = PlanarPose(0.2, -0.1, 0.4)


@pytest.fixture(scope="module")
def usual() -> Iterator[SceneRenderer]:
    with scene() as renderer:
        yield renderer


@pytest.mark.slow
def test_a_walking_robot_is_followed_to_millimetres(usual: SceneRenderer) -> None:
    tracker, misses_m, turns_rad = RobotTracker(TAG, TagFinder()), [], []
    for step in range(12):
        pose = PlanarPose(-0.3 + 0.05 * step, 0.04 * step, 0.25 * step)
        seen = tracker.find(usual.draw(standing(ROBOT, pose)), CAMERA, ROBOT.standing_height_m)
        assert seen is not None
        misses_m.append(np.hypot(seen.pose_floor.x_m - pose.x_m, seen.pose_floor.y_m - pose.y_m))
        turns_rad.append(abs(wrapped_rad(seen.pose_floor.yaw_rad - pose.yaw_rad)))
        assert 0.5 < seen.quality <= 1
        assert misses_m[-1] < 3 * np.sqrt(np.trace(seen.covariance[:2, :2]))
        assert turns_rad[-1] < 3 * np.sqrt(seen.covariance[2, 2])
    assert max(misses_m) < 0.002
    assert np.degrees(max(turns_rad)) < 0.6


def test_a_robot_that_was_carried_elsewhere_is_searched_for(usual: SceneRenderer) -> None:
    tracker = RobotTracker(TAG, TagFinder())
    assert tracker.find(usual.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
    away = usual.draw(standing(ROBOT, PlanarPose(0.7, 0.6, 2.0)))
    seen = tracker.find(away, CAMERA, ROBOT.standing_height_m)
    assert seen is not None
    assert seen.pose_floor.x_m == pytest.approx(0.7, abs=0.003)


def test_the_whole_picture_is_searched_now_and_then_only(usual: SceneRenderer) -> None:
    finder, empty = TagFinder(), usual.draw(standing(ROBOT, PlanarPose(50.0, 0.0, 0.0)))
    searches: list[bool] = []
    search = finder.search

    def noted(gray: Picture, *, thorough: bool = False) -> dict[int, SeenTag]:
        searches.append(thorough)
        return search(gray, thorough=thorough)

    finder.search = noted  # type: ignore[method-assign]
    tracker = RobotTracker(TAG, finder)
    assert all(tracker.find(empty, CAMERA, ROBOT.standing_height_m) is None for _ in range(18))
    assert searches == [True, False, False, True, False, False]


def test_the_tag_may_be_anywhere_on_the_robot_and_turned(usual: SceneRenderer) -> None:
    """The picture has it in the middle: told that it is elsewhere, the robot is elsewhere."""
    mount = PlanarPose(0.1, 0.0, np.pi / 2)
    tracker = RobotTracker(PlacedTag(ROBOT_TAG, 0.1, mount, TAG.height_m), TagFinder())
    seen = tracker.find(usual.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
    assert seen is not None
    again = seen.pose_floor.after(mount)
    assert (again.x_m, again.y_m, again.yaw_rad) == pytest.approx(
        (HERE.x_m, HERE.y_m, HERE.yaw_rad), abs=0.01
    )
    assert abs(seen.pose_floor.yaw_rad - (HERE.yaw_rad - np.pi / 2)) < 0.01


def test_a_tag_of_another_size_or_height_is_not_the_robots(usual: SceneRenderer) -> None:
    picture = usual.draw(standing(ROBOT, HERE))
    for edge_m, height_m in ((0.14, TAG.height_m), (0.1, TAG.height_m + 0.5)):
        other = RobotTracker(PlacedTag(ROBOT_TAG, edge_m, TAG.pose, height_m), TagFinder())
        assert other.find(picture, CAMERA, ROBOT.standing_height_m) is None


@pytest.mark.slow
def test_blur_lowers_the_quality() -> None:
    qualities = []
    for blur_px in (0.7, 3.0):
        with scene(flaws=CameraFlaws(blur_px=blur_px)) as renderer:
            tracker = RobotTracker(TAG, TagFinder())
            seen = tracker.find(renderer.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
            qualities.append(0.0 if seen is None else seen.quality)
    assert qualities[1] < 0.7 * qualities[0]


@pytest.mark.parametrize("lean_deg", [(4.0, 0.0), (-3.0, 3.0)])
def test_a_robot_that_leans_is_where_its_base_is(usual: SceneRenderer, lean_deg: tuple[float, float]) -> None:
    roll, pitch = np.radians(lean_deg)
    turned = Rotation.from_euler("ZYX", [HERE.yaw_rad, pitch, roll])
    x, y, z, w = turned.as_quat()
    posture = replace(standing(ROBOT, HERE), quaternion_floor=np.array([w, x, y, z]))
    picture = usual.draw(posture)
    up_body = turned.inv().apply([0.0, 0.0, 1.0])
    offs = []
    for up in (up_body, np.array([0.0, 0.0, 1.0])):
        seen = RobotTracker(TAG, TagFinder()).find(picture, CAMERA, ROBOT.standing_height_m, up_body=up)
        assert seen is not None
        offs.append(np.hypot(seen.pose_floor.x_m - HERE.x_m, seen.pose_floor.y_m - HERE.y_m))
    assert offs[0] < 0.002
    assert offs[0] < 0.6 * offs[1]
