"""Faults of a camera on request."""

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import TagFinder
from hexctl.vision.twin.camera_faults import CameraFault, CameraFaults, parse_camera_fault, with_hand
from hexctl.vision.twin.rendering import CameraFlaws
from tests.vision.scenes import CAMERA, FLOOR_TAGS, ROBOT_TAG, scene, standing, tag_on


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("moved:0.05,0,-0.1@10", CameraFault(kind="moved", at_s=10, values=(0.05, 0, -0.1))),
        ("turned:-2.5", CameraFault(kind="turned", values=(-2.5,))),
        ("covered:2@0.5", CameraFault(kind="covered", at_s=0.5, values=(2.0,))),
    ],
)
def test_a_fault_is_understood(text: str, fault: CameraFault) -> None:
    assert parse_camera_fault(text) == fault


@pytest.mark.parametrize(
    "text",
    ["", "moved", "moved:1,2", "moved:1,2,3@", "turned:nan", "covered:0@1", "covered:2@-1", "fogged:1"],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"fault: got .*; allowed: moved:X,Y,Z \(m\), turned"):
        parse_camera_fault(text)


def test_a_camera_stands_still_until_it_is_moved_and_turned() -> None:
    faults = CameraFaults((parse_camera_fault("moved:0.1,0,0.2@5"), parse_camera_fault("turned:90@6")))
    assert faults.camera(CAMERA, 4.9) == CAMERA
    moved = faults.camera(CAMERA, 5.0)
    assert np.allclose(moved.position_floor, CAMERA.position_floor + np.array([0.1, 0, 0.2]))
    assert (moved.rotation == CAMERA.rotation).all()
    turned = faults.camera(CAMERA, 6.0)
    assert np.allclose(CAMERA.rotation[:2, 2] @ turned.rotation[:2, 2], 0)
    assert turned.rotation[1, 2] > 0  # from ahead to the left
    assert turned.tilt_rad == pytest.approx(CAMERA.tilt_rad)


def test_a_hand_is_over_the_tag_for_as_long_as_asked() -> None:
    faults = CameraFaults((parse_camera_fault("covered:2@3"),))
    assert [faults.cover(at_s) for at_s in (2.9, 3.0, 4.9, 5.0)] == [False, True, True, False]


@pytest.mark.slow
def test_a_covered_tag_is_not_seen_and_the_others_are() -> None:
    robot = load_robot("ant")
    posture = standing(robot, PlanarPose(0.2, -0.1, 0.5))
    with scene(flaws=CameraFlaws()) as renderer:
        picture = renderer.draw_color(posture)
        covered = with_hand(picture, CAMERA, posture, tag_on(robot))
    finder = TagFinder()
    assert ROBOT_TAG in finder.search(picture[..., 1].copy(), thorough=True)
    assert set(finder.search(covered[..., 1].copy(), thorough=True)) == set(FLOOR_TAGS)
