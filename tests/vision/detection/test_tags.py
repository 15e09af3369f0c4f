"""Tags in pictures, the pose of a robot by its tag, and what is drawn of it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.vision.detection.overlay import with_overlay
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose, tag_pose
from hexctl.vision.detection.robot_tracker import RobotTracker, SeenRobot
from hexctl.vision.detection.tags import MODULES, UNIT_CORNERS, Picture, SeenTag, TagFinder, tag_modules
from hexctl.vision.twin.rendering import SceneRenderer
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, ROBOT_TAG, scene, standing, tag_on


def printed(tag_id: int, module_px: int = 10) -> Picture:
    """Picture of a print, straight from above."""
    modules = np.pad(tag_modules(tag_id), 3)
    return np.where(np.kron(modules, np.ones((module_px, module_px))), 20, 235).astype(np.uint8)


def test_a_print_is_found_upright_with_its_corners_in_order() -> None:
    found = TagFinder().search(printed(7))
    assert set(found) == {7}
    low, high = 30 - 0.5, 30 + 10 * MODULES - 0.5
    expected = [[low, high], [high, high], [high, low], [low, low]]  # y of a picture is down
    assert np.allclose(found[7].corners_px, expected, atol=0.3)
    assert abs(found[7].edge_px - 10 * MODULES) < 0.5


def test_of_two_tags_with_one_number_the_larger_counts() -> None:
    picture = np.full((200, 400), 235, dtype=np.uint8)
    picture[:140, :140], picture[20:104, 200:284] = printed(7), printed(7, 6)
    assert abs(TagFinder().search(picture)[7].edge_px - 80) < 1


def test_a_tag_is_found_again_near_where_it_was_and_nowhere_else() -> None:
    picture = np.full((400, 600), 235, dtype=np.uint8)
    picture[100:240, 100:240] = printed(7)
    finder = TagFinder()
    corners_px = finder.search(picture)[7].corners_px
    assert np.allclose(finder.near(picture, {7: corners_px + 15})[7].corners_px, corners_px, atol=0.2)
    assert finder.near(picture, {7: corners_px + 300}) == {}
    assert finder.near(picture, {8: corners_px}) == {}
    assert finder.near(picture, {7: np.full((4, 2), np.nan)}) == {}
    assert finder.near(picture, {7: corners_px - 5000}) == {}


POSES = st.builds(PlanarPose, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.1, 3.1))


@given(POSES, POSES)
def test_a_motion_and_its_inverse_lead_back(pose: PlanarPose, motion: PlanarPose) -> None:
    back = pose.after(motion).after(motion.inverse())
    assert (back.x_m, back.y_m) == pytest.approx((pose.x_m, pose.y_m), abs=1e-9)
    assert wrapped_rad(back.yaw_rad - pose.yaw_rad) == pytest.approx(0, abs=1e-9)


@given(
    pose=st.builds(PlanarPose, st.floats(-0.8, 1), st.floats(-0.8, 0.8), st.floats(-3.1, 3.1)),
    height_m=st.floats(0, 0.3),
)
def test_a_tag_is_where_its_corners_are_seen(pose: PlanarPose, height_m: float) -> None:
    corners = np.column_stack([pose.of_points(0.1 * UNIT_CORNERS), np.full(4, height_m)])
    seen = tag_pose(CAMERA, CAMERA.pixels(corners), height_m)
    assert seen is not None
    assert (seen.pose.x_m, seen.pose.y_m) == pytest.approx((pose.x_m, pose.y_m), abs=1e-4)
    assert abs(wrapped_rad(seen.pose.yaw_rad - pose.yaw_rad)) < 1e-3
    assert seen.scale == pytest.approx(0.1, abs=1e-4)
    assert seen.residual_m < 1e-4


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


@pytest.mark.slow
def test_a_robot_that_was_carried_elsewhere_is_searched_for(usual: SceneRenderer) -> None:
    tracker = RobotTracker(TAG, TagFinder())
    assert tracker.find(usual.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
    away = usual.draw(standing(ROBOT, PlanarPose(0.7, 0.6, 2.0)))
    seen = tracker.find(away, CAMERA, ROBOT.standing_height_m)
    assert seen is not None
    assert seen.pose_floor.x_m == pytest.approx(0.7, abs=0.003)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_tag_of_another_size_or_height_is_not_the_robots(usual: SceneRenderer) -> None:
    picture = usual.draw(standing(ROBOT, HERE))
    for edge_m, height_m in ((0.14, TAG.height_m), (0.1, TAG.height_m + 0.5)):
        other = RobotTracker(PlacedTag(ROBOT_TAG, edge_m, TAG.pose, height_m), TagFinder())
        assert other.find(picture, CAMERA, ROBOT.standing_height_m) is None


@pytest.mark.slow
def test_a_robot_that_leans_is_where_its_base_is(usual: SceneRenderer) -> None:
    from scipy.spatial.transform import Rotation

    roll, pitch = np.radians((-3.0, 3.0))
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


def test_what_was_seen_is_drawn_into_a_copy_of_the_picture() -> None:
    here, picture = PlanarPose(0.1, 0.1, 0.5), np.full((720, 1280, 3), 90, dtype=np.uint8)
    corners = np.column_stack([here.of_points(0.1 * UNIT_CORNERS), np.full(4, 0.2)])
    seen = SeenRobot(here, np.eye(3) * 1e-6, SeenTag(10, CAMERA.pixels(corners), 80.0), 0.9)
    drawn = {}
    for pose in (here, PlanarPose(-30.0, 0.0, 0.0), None):
        drawn[pose] = with_overlay(
            picture, CAMERA, FLOOR_CORNERS, sighting=seen, pose_floor=pose, height_m=0.2, lines=["one"]
        )
    column, row = np.rint(seen.tag.corners_px[0]).astype(int)
    assert drawn[None][row, column].tolist() == [80, 220, 80]
    assert (drawn[here] != drawn[None]).any()
    behind = PlanarPose(-30.0, 0.0, 0.0)
    assert (drawn[behind] == drawn[None]).all(), "behind the camera"
    assert (picture == 90).all()
