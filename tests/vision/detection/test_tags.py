import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.vision.detection.planar_pose import PlanarPose, tag_pose
from hexctl.vision.detection.tags import MODULES, Picture, TagFinder, only, tag_modules
from hexctl.vision.twin.rendering import CameraFlaws
from tests.vision.scenes import CAMERA, FLOOR_TAGS, ROBOT_TAG, scene, standing, tag_on


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


def test_noise_has_no_tags() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    assert TagFinder().search(noise) == {}


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


@pytest.mark.slow
def test_in_a_rendered_picture_all_tags_are_where_they_are() -> None:
    pose = PlanarPose(0.15, 0.2, 0.7)
    with scene(flaws=CameraFlaws()) as renderer:
        robot = load_robot("ant")
        found = TagFinder().search(renderer.draw(standing(robot, pose)), thorough=True)
    assert set(found) == {*FLOOR_TAGS, ROBOT_TAG}
    for tag_id, tag in FLOOR_TAGS.items():
        seen = tag_pose(CAMERA, found[tag_id].corners_px, 0.0)
        assert seen is not None
        assert np.hypot(seen.pose.x_m - tag.pose.x_m, seen.pose.y_m - tag.pose.y_m) < 0.002
        assert abs(seen.pose.yaw_rad - tag.pose.yaw_rad) < 0.02
    height_m = robot.standing_height_m + tag_on(robot).height_m
    seen = tag_pose(CAMERA, found[ROBOT_TAG].corners_px, height_m)
    assert seen is not None
    assert np.hypot(seen.pose.x_m - pose.x_m, seen.pose.y_m - pose.y_m) < 0.002
    assert abs(seen.pose.yaw_rad - pose.yaw_rad) < 0.01


def test_tags_are_chosen_by_number() -> None:
    found = TagFinder().search(printed(7))
    assert only(found, {7, 8}) == found
    assert only(found, {8}) == {}
