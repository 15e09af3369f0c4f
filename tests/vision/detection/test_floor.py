import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.floor import LearnedFloor, averaged_corners, learn_floor
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose, tag_pose
from hexctl.vision.detection.tags import UNIT_CORNERS, SeenTag, TagFinder
from hexctl.vision.twin.rendering import CameraFlaws
from tests.vision.scenes import CAMERA, FLOOR_TAGS, WEBCAM, scene, standing

#: As on the printed sheet, spread over a floor of 3 x 2 m.
TAGS = {
    0: PlacedTag(0, 0.11, PlanarPose(0, 0, 0)),
    1: PlacedTag(1, 0.16, PlanarPose(0.75, 0.7, 0.4)),
    2: PlacedTag(2, 0.16, PlanarPose(0.9, -0.8, -2.0)),
    3: PlacedTag(3, 0.16, PlanarPose(-0.5, 0.6, 1.2)),
}
EDGES_M = {tag_id: tag.edge_m for tag_id, tag in TAGS.items()}
OTHER_SIDE = Camera.looking(WEBCAM, np.array([0.4, 2.0, 1.5]), np.array([0.3, 0.0, 0.0]))


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


def position_rms_m(true: Camera, learned: Camera, height_m: float = 0.15) -> tuple[float, float]:
    """RMS of position in m and yaw in deg of a robot's tag on 3 x 2 m, by a camera as learned."""
    misses = []
    for x_m in np.linspace(-1, 1.2, 9):
        for y_m in np.linspace(-1, 1, 7):
            points = PlanarPose(x_m, y_m, 0.3).of_points(0.1 * UNIT_CORNERS)
            corners_px = true.pixels(np.column_stack([points, np.full(4, height_m)]))
            if (corners_px < 0).any() or (corners_px > [1279, 719]).any():
                continue
            found = tag_pose(learned, corners_px, height_m)
            assert found is not None
            yaw_deg = np.degrees(wrapped_rad(found.pose.yaw_rad - 0.3))
            misses.append((found.pose.x_m - x_m, found.pose.y_m - y_m, yaw_deg))
    assert len(misses) > 30
    squares = np.square(misses)
    return float(np.sqrt(squares[:, :2].sum(axis=1).mean())), float(np.sqrt(squares[:, 2].mean()))


def farthest_m(learned: LearnedFloor, tags: dict[int, PlacedTag] = TAGS) -> float:
    """How far the tag whose place is worst is from where it is."""
    return max(
        float(np.hypot(found.pose.x_m - tags[tag_id].pose.x_m, found.pose.y_m - tags[tag_id].pose.y_m))
        for tag_id, found in learned.tags.items()
    )


def test_without_noise_all_tags_are_where_they_are() -> None:
    learned = learn_floor(WEBCAM, [seen_by(CAMERA)], EDGES_M)
    assert set(learned.tags) == set(TAGS)
    assert farthest_m(learned) < 1e-4
    assert learned.rms_px < 1e-2
    assert np.allclose(learned.cameras[0].position_floor, CAMERA.position_floor, atol=1e-3)
    for tag_id, tag in learned.tags.items():
        assert abs(wrapped_rad(tag.pose.yaw_rad - TAGS[tag_id].pose.yaw_rad)) < 1e-3
    assert learned.doubts == ()


def test_a_robot_is_found_within_a_centimetre_by_a_floor_learned_with_noise() -> None:
    """Pictures of a second have corners with 1 px of noise each; their median is what is learned from."""
    errors = []
    for seed in range(5):
        pictures = [
            {
                tag_id: SeenTag(tag_id, corners, 50)
                for tag_id, corners in seen_by(CAMERA, TAGS, 1.0, 100 * seed + n).items()
            }
            for n in range(30)
        ]
        learned = learn_floor(WEBCAM, [averaged_corners(pictures)], EDGES_M)
        errors.append(position_rms_m(CAMERA, learned.cameras[0]))
    position_m, yaw_deg = np.sqrt(np.mean(np.square(errors), axis=0))
    assert position_m < 0.01
    assert yaw_deg < 0.5


def test_two_places_of_the_camera_know_more_than_one() -> None:
    one, two = [], []
    for seed in range(4):
        views = [seen_by(CAMERA, TAGS, 0.5, seed), seen_by(OTHER_SIDE, TAGS, 0.5, seed + 50)]
        one.append(farthest_m(learn_floor(WEBCAM, views[:1], EDGES_M)))
        two.append(farthest_m(learn_floor(WEBCAM, views, EDGES_M)))
    assert np.mean(two) < 0.7 * np.mean(one)


def test_a_place_without_the_home_tag_is_tied_by_the_others() -> None:
    near, far = seen_by(CAMERA), seen_by(OTHER_SIDE)
    del near[2], far[0]
    learned = learn_floor(WEBCAM, [far, near], EDGES_M)
    assert set(learned.tags) == set(TAGS)
    assert farthest_m(learned) < 1e-3
    assert len(learned.cameras) == 2
    apart = learn_floor(WEBCAM, [{2: far[2]}, near], EDGES_M)
    assert len(apart.cameras) == 1
    assert "camera position 1 shares no tag" in " ".join(apart.doubts)


@pytest.mark.parametrize("seed", range(5))
def test_a_small_tag_far_away_is_not_seen_tilted(seed: int) -> None:
    """By itself each tag has two solutions; the others decide."""
    small = {tag_id: PlacedTag(tag_id, 0.06, tag.pose) for tag_id, tag in TAGS.items()}
    learned = learn_floor(WEBCAM, [seen_by(CAMERA, small, 0.2, seed)], dict.fromkeys(small, 0.06))
    assert farthest_m(learned, small) < 0.06
    assert abs(learned.cameras[0].tilt_rad - CAMERA.tilt_rad) < 0.03


@pytest.mark.slow
def test_rendered_pictures_give_the_floor_within_millimetres() -> None:
    home = FLOOR_TAGS[0].pose
    true = {tag_id: home.inverse().after(tag.pose) for tag_id, tag in FLOOR_TAGS.items()}
    finder, robot = TagFinder(), standing(load_robot("ant"), PlanarPose(0.2, 0.3, 0.0))
    with scene(flaws=CameraFlaws()) as renderer:
        pictures = [finder.search(renderer.draw(robot), thorough=True) for _ in range(5)]
    edges_m = {tag_id: tag.edge_m for tag_id, tag in FLOOR_TAGS.items()}
    learned = learn_floor(WEBCAM, [averaged_corners(pictures)], edges_m)
    assert set(learned.tags) == set(true)
    for tag_id, tag in learned.tags.items():
        assert np.hypot(tag.pose.x_m - true[tag_id].x_m, tag.pose.y_m - true[tag_id].y_m) < 0.008
    assert learned.rms_px < 0.3


def test_what_cannot_be_trusted_is_told() -> None:
    only_home = learn_floor(WEBCAM, [{0: seen_by(CAMERA)[0]}], EDGES_M)
    assert "only one tag" in " ".join(only_home.doubts)
    smaller = TAGS | {2: PlacedTag(2, 0.14, TAGS[2].pose)}
    wrong = learn_floor(WEBCAM, [seen_by(CAMERA, smaller)], EDGES_M)
    assert "tag 2 looks 1" in " ".join(wrong.doubts)
    assumed = Lens.assumed(1280, 720, 67)
    camera = Camera(assumed, CAMERA.rotation, CAMERA.position_floor)
    assert "only assumed" in learn_floor(assumed, [seen_by(camera)], EDGES_M).doubts[0]


def test_tags_that_few_pictures_show_are_not_used() -> None:
    shown = {tag_id: SeenTag(tag_id, corners, 50) for tag_id, corners in seen_by(CAMERA).items()}
    pictures = [shown, *[{0: shown[0]}] * 9]
    assert set(averaged_corners(pictures)) == {0}
    assert averaged_corners([]) == {}


@pytest.mark.parametrize(
    ("view", "edges_m", "said"),
    [
        ({}, EDGES_M, "no tag in the picture"),
        ({2: seen_by(CAMERA)[2]}, EDGES_M, r"only the tags \[2\].*home tag 0"),
        (seen_by(CAMERA), {1: 0.16}, "no edge of tag 0"),
    ],
)
def test_without_the_home_tag_there_is_no_floor(
    view: dict[int, FloatArray], edges_m: dict[int, float], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        learn_floor(WEBCAM, [view], edges_m)
