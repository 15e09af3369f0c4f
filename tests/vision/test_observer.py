"""A robot under a camera: standing, knocked, covered, and walking under disturbed pictures."""

from collections.abc import Iterator

import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation, Observer
from hexctl.vision.robot_link import LegState
from hexctl.vision.twin.rendering import SceneRenderer
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, WEBCAM, standing, tag_on

ROBOT = load_robot("ant")
TAG = tag_on(ROBOT)
HERE = PlanarPose(0.2, -0.1, 0.4)
KNOCKED = Camera.looking(WEBCAM, np.array([-1.55, 0.08, 1.6]), np.array([0.03, 0.05, 0.0]))
LATENCY_S = 0.08
PERIOD_S = 1 / 30


def pictures_of(camera: Camera, *places: PlanarPose) -> list[Picture]:
    with SceneRenderer(ROBOT, camera, FLOOR_TAGS, tag_on(ROBOT)) as renderer:
        return [renderer.draw(standing(ROBOT, place)) for place in places]


@pytest.fixture(scope="module")
def usual() -> Picture:
    return pictures_of(CAMERA, HERE)[0]


@pytest.fixture(scope="module")
def knocked() -> Picture:
    return pictures_of(KNOCKED, HERE)[0]


def observer() -> Observer:
    return Observer(ROBOT, CAMERA, FLOOR_CORNERS, TAG, finder=TagFinder(), latency_s=LATENCY_S)


def watched(
    observer: Observer, pictures: Iterator[Picture | None], from_s: float = 0.0
) -> list[tuple[Observation | None, PoseEstimate]]:
    """What came of pictures, None where none comes, at 30 per second; the legs stand still."""
    seen = []
    for number, picture in enumerate(pictures):
        now_s = from_s + number * PERIOD_S
        observer.listen(LegState(now_s, ROBOT.stance_angles_rad, None, None))
        observation = None if picture is None else observer.look(picture, now_s)
        seen.append((observation, observer.estimate(now_s)))
    return seen


def off_m(estimate: PoseEstimate) -> float:
    assert estimate.pose is not None
    return float(np.hypot(estimate.pose.x_m - HERE.x_m, estimate.pose.y_m - HERE.y_m))


@pytest.mark.slow
def test_while_the_tag_is_covered_a_robot_that_stands_is_believed_to_stand(usual: Picture) -> None:
    observing = observer()
    watched(observing, iter([usual] * 15))
    dark = np.zeros_like(usual)
    seen = watched(observing, iter([dark] * 60), 15 * PERIOD_S)
    assert seen[-1][1].sight == "bridging"
    assert max(off_m(estimate) for _, estimate in seen) < 0.005
    lost = watched(observing, iter([None] * 60), 75 * PERIOD_S)
    assert lost[-1][1].sight == "lost"
    assert lost[-1][1].pose is None


@pytest.mark.slow
def test_a_knocked_camera_makes_no_jump_and_is_told(usual: Picture, knocked: Picture) -> None:
    observing = observer()
    watched(observing, iter([usual] * 20))
    seen = watched(observing, iter([knocked] * 45), 20 * PERIOD_S)
    changes = [observation.change for observation, _ in seen if observation and observation.change]
    assert [change.tag_id for change in changes] == [None]
    assert max(off_m(estimate) for _, estimate in seen) < 0.02
    assert seen[-1][1].sight == "seeing"
    assert off_m(seen[-1][1]) < 0.005
    assert seen[-1][1].restarts == 0


def test_a_state_of_the_legs_that_is_late_or_doubled_is_left_out() -> None:
    observing = observer()
    for at_s in (0.0, 0.02, 0.02, 0.01, 0.04, 5.0):
        observing.listen(LegState(at_s, ROBOT.stance_angles_rad, None, None))
    assert observing.height_m == pytest.approx(ROBOT.standing_height_m, abs=0.002)
