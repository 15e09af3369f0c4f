import numpy as np

from hexctl.vision.detection.overlay import Overlay
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.robot_tracker import SeenRobot
from hexctl.vision.detection.tags import UNIT_CORNERS, Picture, SeenTag
from tests.vision.scenes import CAMERA, FLOOR_CORNERS

EMPTY = np.full((720, 1280, 3), 90, dtype=np.uint8)
HERE = PlanarPose(0.1, 0.1, 0.5)


def sighting() -> SeenRobot:
    corners = np.column_stack([HERE.of_points(0.1 * UNIT_CORNERS), np.full(4, 0.2)])
    return SeenRobot(HERE, np.eye(3) * 1e-6, SeenTag(10, CAMERA.pixels(corners), 80.0), 0.9)


def drawn(overlay: Overlay, seen: SeenRobot | None, pose: PlanarPose | None, gray: bool = False) -> Picture:
    picture = EMPTY[..., 0] if gray else EMPTY
    return overlay.draw(
        picture, CAMERA, FLOOR_CORNERS, sighting=seen, pose_floor=pose, height_m=0.2, lines=["one", "two"]
    )


def test_a_tag_that_was_seen_has_a_green_edge_and_the_picture_is_left_as_it_was() -> None:
    seen = sighting()
    with_tag, without = (drawn(Overlay(), tag, None) for tag in (seen, None))
    column, row = np.rint(seen.tag.corners_px[0]).astype(int)
    assert with_tag[row, column].tolist() == [80, 220, 80]
    assert without[row, column].tolist() != [80, 220, 80]
    assert (EMPTY == 90).all()


def test_the_way_is_remembered() -> None:
    overlay = Overlay()
    first = drawn(overlay, None, HERE)
    again = drawn(overlay, None, PlanarPose(0.6, 0.4, 0.5))
    middle = CAMERA.pixels(np.array([[0.35, 0.25, 0.2]]))[0]
    column, row = np.rint(middle).astype(int)
    patch = (slice(row - 3, row + 4), slice(column - 3, column + 4))
    orange = (np.abs(again[patch].astype(int) - (60, 160, 255)).sum(axis=2) < 60).any()
    assert orange
    assert not (np.abs(first[patch].astype(int) - (60, 160, 255)).sum(axis=2) < 60).any()


def test_a_robot_behind_the_camera_is_not_drawn() -> None:
    behind = drawn(Overlay(), None, PlanarPose(-30.0, 0.0, 0.0))
    assert (behind == drawn(Overlay(), None, None)).all()


def test_a_grey_picture_becomes_one_in_colour() -> None:
    assert drawn(Overlay(), sighting(), HERE, gray=True).shape == (720, 1280, 3)


def test_the_way_is_interrupted_while_the_robot_is_lost() -> None:
    overlay = Overlay()
    for pose in (HERE, None):
        drawn(overlay, None, pose)
    again = drawn(overlay, None, PlanarPose(0.6, 0.4, 0.5))
    column, row = np.rint(CAMERA.pixels(np.array([[0.35, 0.25, 0.2]]))[0]).astype(int)
    patch = again[row - 3 : row + 4, column - 3 : column + 4].astype(int)
    assert not (np.abs(patch - (60, 160, 255)).sum(axis=2) < 60).any()


def test_tags_and_axes_have_names_and_those_far_outside_do_not() -> None:
    every = drawn(Overlay(), None, None)
    fewer = Overlay().draw(
        EMPTY, CAMERA, {0: FLOOR_CORNERS[0]}, sighting=None, pose_floor=None, height_m=0.2, lines=[]
    )
    below = CAMERA.pixels(np.column_stack([FLOOR_CORNERS[2], np.zeros(4)]))
    column, row = np.rint(below[below[:, 1].argmax()]).astype(int)
    beside = (slice(row + 8, row + 32), slice(column + 6, column + 36))
    assert (every[beside] != fewer[beside]).any()
    far = {0: FLOOR_CORNERS[0], 1: FLOOR_CORNERS[0] - [60.0, 0.0]}
    Overlay().draw(EMPTY, CAMERA, far, sighting=None, pose_floor=None, height_m=0.2, lines=[])


def test_a_line_of_low_letters_covers_none_above_it() -> None:
    def text(*lines: str) -> Picture:
        return Overlay().draw(EMPTY, CAMERA, {}, sighting=None, pose_floor=None, height_m=0.2, lines=lines)[
            :120, :300
        ]

    one, both = text("tag 32 px, quality 0.49"), text("tag 32 px, quality 0.49", "no more")
    letters = one > 150
    assert letters.any()
    assert (both[letters] > 150).all()


def test_lines_that_a_distortion_folds_back_are_not_drawn() -> None:
    """Below a camera that stands over the floor the webcam's distortion folds what it does not see."""
    floor = Overlay().draw(EMPTY, CAMERA, {}, sighting=None, pose_floor=None, height_m=0.2, lines=[])
    rows, columns = np.nonzero((floor != 90).any(axis=2))
    keep = (rows > 560) & (columns > 200) & (columns < 1080)
    points = CAMERA.floor_points(np.column_stack([columns, rows])[keep].astype(float))
    off_grid_m = np.abs(points / 0.5 - np.round(points / 0.5)).min(axis=1) * 0.5
    assert keep.any()
    assert (off_grid_m < 0.02).all()
