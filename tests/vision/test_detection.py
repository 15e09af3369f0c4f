"""What is found in pictures: tags, the robot by its tag, the camera by the floor's, and the floor."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.simulators.camera.rendering import SceneRenderer
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera, place_camera, reprojection_px, sees_tags, visible_circle
from hexctl.vision.detection.camera_watch import CameraChange, CameraWatch
from hexctl.vision.detection.floor import averaged_corners, learn_floor
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.overlay import with_overlay
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose, tag_pose
from hexctl.vision.detection.robot_tracker import RobotTracker, SeenRobot
from hexctl.vision.detection.tags import MODULES, UNIT_CORNERS, Picture, SeenTag, TagFinder, tag_modules
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, ROBOT_TAG, WEBCAM, scene, standing, tag_on

# Tags and the robot.


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
def renderer() -> Iterator[SceneRenderer]:
    with scene() as usual:
        yield usual


@pytest.mark.slow
def test_a_walking_robot_is_followed_to_millimetres(renderer: SceneRenderer) -> None:
    tracker, misses_m, turns_rad = RobotTracker(TAG, TagFinder()), [], []
    for step in range(12):
        pose = PlanarPose(-0.3 + 0.05 * step, 0.04 * step, 0.25 * step)
        seen = tracker.find(renderer.draw(standing(ROBOT, pose)), CAMERA, ROBOT.standing_height_m)
        assert seen is not None
        misses_m.append(np.hypot(seen.pose_floor.x_m - pose.x_m, seen.pose_floor.y_m - pose.y_m))
        turns_rad.append(abs(wrapped_rad(seen.pose_floor.yaw_rad - pose.yaw_rad)))
        assert 0.5 < seen.quality <= 1
        assert misses_m[-1] < 3 * np.sqrt(np.trace(seen.covariance[:2, :2]))
        assert turns_rad[-1] < 3 * np.sqrt(seen.covariance[2, 2])
    assert max(misses_m) < 0.002
    assert np.degrees(max(turns_rad)) < 0.6


@pytest.mark.slow
def test_a_robot_that_was_carried_elsewhere_is_searched_for(renderer: SceneRenderer) -> None:
    tracker = RobotTracker(TAG, TagFinder())
    assert tracker.find(renderer.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
    away = renderer.draw(standing(ROBOT, PlanarPose(0.7, 0.6, 2.0)))
    seen = tracker.find(away, CAMERA, ROBOT.standing_height_m)
    assert seen is not None
    assert seen.pose_floor.x_m == pytest.approx(0.7, abs=0.003)


@pytest.mark.slow
def test_the_tag_may_be_anywhere_on_the_robot_and_turned(renderer: SceneRenderer) -> None:
    """The picture has it in the middle: told that it is elsewhere, the robot is elsewhere."""
    mount = PlanarPose(0.1, 0.0, np.pi / 2)
    tracker = RobotTracker(PlacedTag(ROBOT_TAG, 0.1, mount, TAG.height_m), TagFinder())
    seen = tracker.find(renderer.draw(standing(ROBOT, HERE)), CAMERA, ROBOT.standing_height_m)
    assert seen is not None
    again = seen.pose_floor.after(mount)
    assert (again.x_m, again.y_m, again.yaw_rad) == pytest.approx(
        (HERE.x_m, HERE.y_m, HERE.yaw_rad), abs=0.01
    )
    assert abs(seen.pose_floor.yaw_rad - (HERE.yaw_rad - np.pi / 2)) < 0.01


@pytest.mark.slow
def test_a_tag_of_another_size_or_height_is_not_the_robots(renderer: SceneRenderer) -> None:
    picture = renderer.draw(standing(ROBOT, HERE))
    for edge_m, height_m in ((0.14, TAG.height_m), (0.1, TAG.height_m + 0.5)):
        other = RobotTracker(PlacedTag(ROBOT_TAG, edge_m, TAG.pose, height_m), TagFinder())
        assert other.find(picture, CAMERA, ROBOT.standing_height_m) is None


@pytest.mark.slow
def test_a_robot_that_leans_is_where_its_base_is(renderer: SceneRenderer) -> None:
    from scipy.spatial.transform import Rotation

    roll, pitch = np.radians((-3.0, 3.0))
    turned = Rotation.from_euler("ZYX", [HERE.yaw_rad, pitch, roll])
    x, y, z, w = turned.as_quat()
    posture = replace(standing(ROBOT, HERE), quaternion_floor=np.array([w, x, y, z]))
    picture = renderer.draw(posture)
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


# The camera and the floor.

HEIGHT_M = ROBOT.standing_height_m + TAG.height_m


@given(x_m=st.floats(-1, 1.5), y_m=st.floats(-1, 1), height_m=st.floats(0, 0.4))
def test_a_point_lies_where_the_ray_of_its_pixel_meets_its_height(
    x_m: float, y_m: float, height_m: float
) -> None:
    seen = CAMERA.pixels(np.array([[x_m, y_m, height_m]]))
    assert np.allclose(CAMERA.floor_points(seen, height_m), [[x_m, y_m]], atol=1e-5)


def test_rays_above_the_horizon_meet_no_floor() -> None:
    level = Camera.looking(WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.0]))
    assert np.isnan(level.floor_points(np.array([[640.0, 100.0]]))).all()
    assert np.isfinite(level.floor_points(np.array([[640.0, 600.0]]))).all()


def test_the_tags_on_the_floor_tell_where_the_camera_is() -> None:
    seen = {
        tag_id: CAMERA.pixels(np.column_stack([corners, np.zeros(4)]))
        for tag_id, corners in FLOOR_CORNERS.items()
    }
    found = place_camera(WEBCAM, seen | {99: np.zeros((4, 2))}, FLOOR_CORNERS)
    assert found is not None
    assert np.allclose(found.position_floor, CAMERA.position_floor, atol=1e-4)
    assert np.allclose(found.rotation, CAMERA.rotation, atol=1e-4)
    assert max(reprojection_px(found, seen, FLOOR_CORNERS).values()) < 0.01


@pytest.mark.slow
def test_a_camera_above_the_floor_sees_a_circle_below_it() -> None:
    down = Camera.looking(WEBCAM, np.array([0.3, -0.2, 2.0]), np.array([0.3, -0.2, 0.0]))
    middle, radius_m = visible_circle(down, 0.1, 0.1)
    assert middle == pytest.approx((0.3, -0.2), abs=0.11)
    # The picture is 720 px high; a tag has to be seen whole.
    assert radius_m == pytest.approx(1.9 * 360 / 955 - 0.07, abs=0.1)
    up = Camera.looking(WEBCAM, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 1.9]))
    for camera, height_m, edge_m in ((up, 0.1, 0.1), (CAMERA, HEIGHT_M, 0.01)):
        with pytest.raises(InputError):
            visible_circle(camera, height_m, edge_m)


@pytest.mark.slow
def test_tags_are_found_where_they_are_said_to_be_and_not_found_outside(renderer: SceneRenderer) -> None:
    middle, radius_m = visible_circle(CAMERA, HEIGHT_M, 0.1)
    assert radius_m > 0.5
    around = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    ring = np.array(middle) + radius_m * np.column_stack([np.cos(around), np.sin(around)])
    outside = np.array([[-1.8, 0.0], [0.0, 2.5]])
    for points, expected in ((ring, True), (outside, False)):
        for x_m, y_m in points:
            picture = renderer.draw(standing(ROBOT, PlanarPose(float(x_m), float(y_m), 0.3)))
            assert (ROBOT_TAG in TagFinder().search(picture, thorough=True)) == expected, (x_m, y_m)
        assert sees_tags(CAMERA, points, HEIGHT_M, 0.1).all() == expected


AWAY = standing(ROBOT, PlanarPose(0.3, 0.3, 0.0))


def changes(watch: CameraWatch, picture: Picture, looks: int) -> list[CameraChange]:
    seen = [watch.look(picture) for _ in range(looks)]
    return [change for change in seen if change is not None]


@pytest.mark.slow
def test_one_tag_that_was_kicked_is_used_no_more(renderer: SceneRenderer) -> None:
    watching = CameraWatch(CAMERA, FLOOR_CORNERS, TagFinder())
    assert changes(watching, renderer.draw(AWAY), 20) == []
    kicked = FLOOR_TAGS | {3: PlacedTag(3, FLOOR_TAGS[3].edge_m, PlanarPose(-0.6, 0.03, 0.05))}
    with scene(kicked) as elsewhere:
        found = changes(watching, elsewhere.draw(AWAY), 60)
    assert [change.tag_id for change in found] == [3]
    assert 3 not in watching.floor_corners
    assert set(watching.visible) == {0, 1, 2}
    assert np.allclose(watching.camera.position_floor, CAMERA.position_floor, atol=0.01)


@pytest.mark.slow
def test_a_camera_that_stays_and_a_covered_lens_move_nothing(renderer: SceneRenderer) -> None:
    usual = renderer.draw(AWAY)
    watching = CameraWatch(CAMERA, FLOOR_CORNERS, TagFinder())
    assert changes(watching, usual, 60) == []
    assert changes(watching, np.zeros_like(usual), 60) == []
    assert watching.visible == []
    assert changes(watching, usual, 60) == []
    assert set(watching.visible) == set(FLOOR_TAGS)
    assert CameraWatch(CAMERA, {}, TagFinder()).look(usual) is None


#: As on the printed sheet, spread over a floor of 3 x 2 m.
TAGS = {
    0: PlacedTag(0, 0.11, PlanarPose(0, 0, 0)),
    1: PlacedTag(1, 0.16, PlanarPose(0.75, 0.7, 0.4)),
    2: PlacedTag(2, 0.16, PlanarPose(0.9, -0.8, -2.0)),
    3: PlacedTag(3, 0.16, PlanarPose(-0.5, 0.6, 1.2)),
}

EDGES_M = {tag_id: tag.edge_m for tag_id, tag in TAGS.items()}


def seen_by(
    camera: Camera, tags: dict[int, PlacedTag] = TAGS, noise_px: float = 0.0, seed: int = 0
) -> dict[int, FloatArray]:
    """Corners as a camera sees them, with noise."""
    random = np.random.default_rng(seed)
    return {
        tag_id: camera.pixels(np.column_stack([tag.corners, np.zeros(4)]))
        + noise_px * random.normal(size=(4, 2))
        for tag_id, tag in tags.items()
    }


def test_what_cannot_be_trusted_is_told() -> None:
    only_home = learn_floor(WEBCAM, {0: seen_by(CAMERA)[0]}, EDGES_M)
    assert "only one tag" in " ".join(only_home.doubts)
    smaller = TAGS | {2: PlacedTag(2, 0.14, TAGS[2].pose)}
    wrong = learn_floor(WEBCAM, seen_by(CAMERA, smaller), EDGES_M)
    assert "tag 2 looks 1" in " ".join(wrong.doubts)
    assumed = Lens.assumed(1280, 720, 67)
    camera = Camera(assumed, CAMERA.rotation, CAMERA.position_floor)
    assert "only assumed" in learn_floor(assumed, seen_by(camera), EDGES_M).doubts[0]


@pytest.mark.parametrize(
    ("view", "edges_m", "named"),
    [
        ({}, EDGES_M, "no tag"),
        ({2: seen_by(CAMERA)[2]}, EDGES_M, "tag 0"),
        (seen_by(CAMERA), {1: 0.16}, "tag 0"),
    ],
)
def test_without_the_home_tag_there_is_no_floor(
    view: dict[int, FloatArray], edges_m: dict[int, float], named: str
) -> None:
    with pytest.raises(InputError, match=named):
        learn_floor(WEBCAM, view, edges_m)


@pytest.mark.parametrize("seed", range(3))
def test_a_floor_that_is_learned_with_noise_is_right_within_a_centimetre(seed: int) -> None:
    """Pictures of a second have corners with 1 px of noise each; their median is what is learned from."""
    pictures = []
    for number in range(30):
        seen = seen_by(CAMERA, TAGS, 1.0, 100 * seed + number)
        pictures.append({tag_id: SeenTag(tag_id, corners, 50) for tag_id, corners in seen.items()})
    learned = learn_floor(WEBCAM, averaged_corners(pictures), EDGES_M)
    for tag_id, tag in learned.tags.items():
        true = TAGS[tag_id].pose
        assert np.hypot(tag.pose.x_m - true.x_m, tag.pose.y_m - true.y_m) < 0.02
    assert np.allclose(learned.camera.position_floor, CAMERA.position_floor, atol=0.03)
    pictures = [pictures[0], *[{0: pictures[0][0]}] * 9]
    assert set(averaged_corners(pictures)) == {0}, "few pictures show the others"
