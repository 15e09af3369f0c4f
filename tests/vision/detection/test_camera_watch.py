from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.camera_watch import LEAST_LOOKS, MOST_LOOKS, CameraChange, CameraWatch
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.twin.rendering import SceneRenderer
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, WEBCAM, standing, tag_on

ROBOT = load_robot("ant")
AWAY = standing(ROBOT, PlanarPose(0.3, 0.3, 0.0))
SHIFTED = Camera.looking(WEBCAM, np.array([-1.6, 0.1, 1.6]), np.array([0.05, 0.0, 0.0]))
TURNED_AWAY = Camera.looking(WEBCAM, np.array([-1.63, 0.0, 1.63]), np.array([0.1, 0.45, 0.0]))


def picture_of(camera: Camera, tags: Mapping[int, PlacedTag] = FLOOR_TAGS) -> Picture:
    with SceneRenderer(ROBOT, camera, tags, tag_on(ROBOT)) as renderer:
        return renderer.draw(AWAY)


@pytest.fixture(scope="module")
def usual() -> Picture:
    return picture_of(CAMERA)


def changes(watch: CameraWatch, picture: Picture, looks: int) -> Iterator[CameraChange]:
    for _ in range(looks):
        change = watch.look(picture)
        if change is not None:
            yield change


def watch() -> CameraWatch:
    return CameraWatch(CAMERA, FLOOR_CORNERS, TagFinder())


@pytest.mark.slow
def test_a_camera_that_stays_is_not_said_to_have_moved(usual: Picture) -> None:
    watching = watch()
    assert list(changes(watching, usual, 100)) == []
    assert set(watching.visible) == set(FLOOR_TAGS)


@pytest.mark.slow
def test_many_looks_make_the_place_of_the_camera_better() -> None:
    believed = Camera(WEBCAM, CAMERA.rotation, CAMERA.position_floor + np.array([0.0, 0.0, 0.004]))
    watching = CameraWatch(believed, FLOOR_CORNERS, TagFinder())
    with SceneRenderer(ROBOT, CAMERA, FLOOR_TAGS, tag_on(ROBOT)) as renderer:
        pictures = [renderer.draw(AWAY) for _ in range(5)]
    for look in range(4 * len(FLOOR_TAGS) * (MOST_LOOKS - 1)):
        watching.look(pictures[look % 5])
    assert watching.camera is believed, "fewer looks than of which a floor is learned do not count"
    for look in range(4 * len(FLOOR_TAGS) * (LEAST_LOOKS + 1)):
        watching.look(pictures[look % 5])
    assert np.linalg.norm(watching.camera.position_floor - CAMERA.position_floor) < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("moved", [SHIFTED, TURNED_AWAY], ids=["shifted", "turned away"])
def test_a_camera_that_was_knocked_is_placed_anew(usual: Picture, moved: Camera) -> None:
    watching = watch()
    assert list(changes(watching, usual, 20)) == []
    told = list(changes(watching, picture_of(moved), 60))
    assert [change.tag_id for change in told] == [None]
    true_shift_m = np.linalg.norm(moved.position_floor - CAMERA.position_floor)
    assert told[0].shift_m == pytest.approx(true_shift_m, abs=0.01)
    assert np.linalg.norm(watching.camera.position_floor - moved.position_floor) < 0.01
    ahead = watching.camera.floor_points(np.array([[640.0, 360.0]]))
    assert np.allclose(ahead, moved.floor_points(np.array([[640.0, 360.0]])), atol=0.005)


@pytest.mark.slow
def test_one_tag_that_was_kicked_is_used_no_more(usual: Picture) -> None:
    watching = watch()
    list(changes(watching, usual, 20))
    kicked = FLOOR_TAGS | {3: PlacedTag(3, FLOOR_TAGS[3].edge_m, PlanarPose(-0.6, 0.03, 0.05))}
    told = list(changes(watching, picture_of(CAMERA, kicked), 60))
    assert [change.tag_id for change in told] == [3]
    assert 3 not in watching.floor_corners
    assert set(watching.visible) == {0, 1, 2}
    assert np.allclose(watching.camera.position_floor, CAMERA.position_floor, atol=0.01)


def test_a_covered_lens_moves_nothing(usual: Picture) -> None:
    watching = watch()
    list(changes(watching, usual, 20))
    assert list(changes(watching, np.zeros_like(usual), 60)) == []
    assert watching.visible == []
    assert list(changes(watching, usual, 100)) == []
    assert set(watching.visible) == set(FLOOR_TAGS)


def test_without_tags_on_the_floor_nothing_is_watched(usual: Picture) -> None:
    assert CameraWatch(CAMERA, {}, TagFinder()).look(usual) is None
