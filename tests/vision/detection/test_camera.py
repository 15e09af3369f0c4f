"""Where a camera stands, whether it was moved, and the floor that it learns."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera, place_camera, reprojection_px, sees_tags, visible_circle
from hexctl.vision.detection.camera_watch import CameraChange, CameraWatch
from hexctl.vision.detection.floor import LearnedFloor, averaged_corners, learn_floor
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, ROBOT_TAG, WEBCAM, scene, standing, tag_on

ROBOT = load_robot("ant")
HEIGHT_M = ROBOT.standing_height_m + tag_on(ROBOT).height_m


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
def test_tags_are_found_where_they_are_said_to_be_and_not_found_outside() -> None:
    middle, radius_m = visible_circle(CAMERA, HEIGHT_M, 0.1)
    assert radius_m > 0.5
    around = np.linspace(0, 2 * np.pi, 4, endpoint=False)
    ring = np.array(middle) + radius_m * np.column_stack([np.cos(around), np.sin(around)])
    outside = np.array([[-1.8, 0.0], [0.0, 2.5]])
    with scene() as renderer:
        finder = TagFinder()
        for points, expected in ((ring, True), (outside, False)):
            for x_m, y_m in points:
                picture = renderer.draw(standing(ROBOT, PlanarPose(float(x_m), float(y_m), 0.3)))
                assert (ROBOT_TAG in finder.search(picture, thorough=True)) == expected, (x_m, y_m)
            assert sees_tags(CAMERA, points, HEIGHT_M, 0.1).all() == expected


def picture_of(tags: Mapping[int, PlacedTag]) -> Picture:
    with scene(tags) as renderer:
        return renderer.draw(standing(ROBOT, PlanarPose(0.3, 0.3, 0.0)))


@pytest.fixture(scope="module")
def usual() -> Picture:
    return picture_of(FLOOR_TAGS)


def changes(watch: CameraWatch, picture: Picture, looks: int) -> list[CameraChange]:
    seen = [watch.look(picture) for _ in range(looks)]
    return [change for change in seen if change is not None]


@pytest.mark.slow
def test_one_tag_that_was_kicked_is_used_no_more(usual: Picture) -> None:
    watching = CameraWatch(CAMERA, FLOOR_CORNERS, TagFinder())
    assert changes(watching, usual, 20) == []
    kicked = FLOOR_TAGS | {3: PlacedTag(3, FLOOR_TAGS[3].edge_m, PlanarPose(-0.6, 0.03, 0.05))}
    assert [change.tag_id for change in changes(watching, picture_of(kicked), 60)] == [3]
    assert 3 not in watching.floor_corners
    assert set(watching.visible) == {0, 1, 2}
    assert np.allclose(watching.camera.position_floor, CAMERA.position_floor, atol=0.01)


@pytest.mark.slow
def test_a_camera_that_stays_and_a_covered_lens_move_nothing(usual: Picture) -> None:
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


def farthest_m(learned: LearnedFloor) -> float:
    """How far the tag whose place is worst is from where it is."""
    return max(
        float(np.hypot(found.pose.x_m - TAGS[tag_id].pose.x_m, found.pose.y_m - TAGS[tag_id].pose.y_m))
        for tag_id, found in learned.tags.items()
    )


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
    assert farthest_m(learned) < 0.02
    assert np.allclose(learned.camera.position_floor, CAMERA.position_floor, atol=0.03)
    pictures = [pictures[0], *[{0: pictures[0][0]}] * 9]
    assert set(averaged_corners(pictures)) == {0}, "few pictures show the others"
