"""A robot under a camera: standing, knocked, covered, and walking under disturbed pictures."""

from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation, Observer
from hexctl.vision.robot_link import LegState
from hexctl.vision.twin.rendering import SceneRenderer
from tests.vision.scenes import CAMERA, FLOOR_CORNERS, FLOOR_TAGS, ROBOT_TAG, WEBCAM, standing, tag_on

ROBOT = load_robot("ant")


TAG = tag_on(ROBOT)


#: A picture that nobody looks at.
NO_PICTURE: Picture = np.zeros((720, 1280), dtype=np.uint8)


class CornerFinder(TagFinder):
    """Finds the tags where they are, whatever the picture shows.

    Args:
        noise_px: standard deviation of the coordinates of the robot's tag.
        seed: of it.
        camera: that sees them.

    Attributes:
        pose: of the robot.
    """

    def __init__(self, noise_px: float, seed: int = 0, camera: Camera = CAMERA) -> None:
        self._noise_px, self._random, self._camera = noise_px, np.random.default_rng(seed), camera
        self.pose = PlanarPose(0, 0, 0)

    def search(self, gray: Picture, *, thorough: bool = False) -> dict[int, SeenTag]:
        """All tags."""
        return {number: self._corners(number) for number in (*FLOOR_CORNERS, ROBOT_TAG)}

    def near(self, gray: Picture, expected_px: Mapping[int, FloatArray]) -> dict[int, SeenTag]:
        """The tags that are asked for."""
        return {number: self._corners(number) for number in expected_px}

    def _corners(self, number: int) -> SeenTag:
        corners, height_m, noise_px = FLOOR_CORNERS.get(number), 0.0, 0.0
        if corners is None:
            corners = self.pose.of_points(TAG.corners_body[:, :2])
            height_m, noise_px = ROBOT.standing_height_m + TAG.height_m, self._noise_px
        corners_px = self._camera.pixels(np.column_stack([corners, np.full(4, height_m)]))
        return SeenTag(number, corners_px + noise_px * self._random.normal(size=(4, 2)), 60.0)


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
    return Observer(ROBOT, CAMERA, FLOOR_CORNERS, TAG, latency_s=LATENCY_S)


def watched(
    observer: Observer, pictures: Iterator[Picture | None], from_s: float = 0.0, *, legs: bool = True
) -> list[tuple[Observation | None, PoseEstimate]]:
    """What came of pictures, None where none comes, at 30 per second; the legs stand still."""
    seen = []
    for number, picture in enumerate(pictures):
        now_s = from_s + number * PERIOD_S
        if legs:
            observer.listen(LegState(now_s, ROBOT.stance_angles_rad, None, None))
        observation = None if picture is None else observer.look(picture, now_s)
        seen.append((observation, observer.estimate(now_s)))
    return seen


def off_m(estimate: PoseEstimate) -> float:
    assert estimate.pose is not None
    return float(np.hypot(estimate.pose.x_m - HERE.x_m, estimate.pose.y_m - HERE.y_m))


@pytest.mark.slow
def test_a_robot_that_stands_is_where_it_stands(usual: Picture) -> None:
    seen = watched(observer(), iter([usual] * 15), legs=False)
    assert seen[0][1].sight == "lost"
    last = seen[-1][1]
    assert last.sight == "seeing"
    assert off_m(last) < 0.003
    assert last.pose is not None
    assert abs(last.pose.yaw_rad - HERE.yaw_rad) < 0.01
    assert last.age_s == pytest.approx(LATENCY_S, abs=1e-6)
    assert all(observation is not None and observation.robot is not None for observation, _ in seen)


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


@pytest.mark.slow
def test_a_robot_that_was_carried_is_found_again(usual: Picture) -> None:
    there = PlanarPose(-0.3, 0.4, -1.0)
    elsewhere = pictures_of(CAMERA, there)[0]
    observing = observer()
    watched(observing, iter([usual] * 20))
    last = watched(observing, iter([elsewhere] * 40), 20 * PERIOD_S)[-1][1]
    assert last.restarts == 1
    assert last.pose is not None
    assert np.hypot(last.pose.x_m - there.x_m, last.pose.y_m - there.y_m) < 0.005


def test_a_state_of_the_legs_that_is_late_or_doubled_is_left_out() -> None:
    observing = observer()
    for at_s in (0.0, 0.02, 0.02, 0.01, 0.04, 5.0):
        observing.listen(LegState(at_s, ROBOT.stance_angles_rad, None, None))
    assert observing.height_m == pytest.approx(ROBOT.standing_height_m, abs=0.002)


def heading_errors_deg(noise_px: float, pictures: int) -> tuple[float, float]:
    """RMS of the heading by one picture and by the filter after several, over places on the floor."""
    finder, alone_deg, fused_deg = CornerFinder(noise_px), [], []
    for place in np.random.default_rng(1).uniform([-0.5, -0.8, -np.pi], [0.8, 0.8, np.pi], (12, 3)):
        finder.pose = PlanarPose(*place.tolist())
        observing = Observer(ROBOT, CAMERA, FLOOR_CORNERS, TAG, finder=finder)
        seen, estimate = watched(observing, iter([NO_PICTURE] * pictures))[-1]
        assert seen is not None
        assert seen.robot is not None
        assert estimate.pose is not None
        alone_deg.append(np.degrees(wrapped_rad(seen.robot.pose_floor.yaw_rad - finder.pose.yaw_rad)))
        fused_deg.append(np.degrees(wrapped_rad(estimate.pose.yaw_rad - finder.pose.yaw_rad)))
    return float(np.sqrt(np.mean(np.square(alone_deg)))), float(np.sqrt(np.mean(np.square(fused_deg))))


@pytest.mark.slow
def test_a_second_of_noisy_pictures_gives_the_heading() -> None:
    """With the noise that corners have, and not the one that good pictures have, each picture counts."""
    alone_deg, fused_deg = heading_errors_deg(1.0, 31)
    assert alone_deg > 1.0
    assert fused_deg < 0.3 * alone_deg
    assert fused_deg < 0.35
