"""Pictures of a camera and the robot's own motion become one pose: where the robot is now."""

import math
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hexctl.ik.leg_odometer import LegOdometer
from hexctl.ik.standing_position import LegsPath, StandingPosition
from hexctl.robot.model import Robot
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.camera_watch import CameraChange, CameraWatch
from hexctl.vision.detection.planar_pose import PlacedTag
from hexctl.vision.detection.robot_tracker import LEVEL, RobotTracker, SeenRobot
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.estimation.pose_belief import Sighting
from hexctl.vision.estimation.pose_filter import PoseEstimate, PoseFilter
from hexctl.vision.robot_link import LegState

#: Accepted distance from the expected position while no floor tag is visible. The body may cover the tags,
#: but the camera may also have been turned.
NEAR_M = 0.05

#: Motion by the legs that every new picture of the robot shows.
MOVED_M, TURNED_RAD = 0.01, math.radians(3.0)

#: Pictures that are recognized if they come again: half a minute.
MOST_PICTURES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Observation(ArrayFields):
    """Result of one picture.

    Attributes:
        robot: sighting of the robot, or None.
        accepted: whether the filter accepted the sighting.
        frozen: whether the picture has come before, or shows a robot at one place although its legs walked.
        change: detected change of camera or tags, or None.
    """

    robot: SeenRobot | None
    accepted: bool
    change: CameraChange | None
    frozen: bool = False


class RepeatedPictures:
    """Recognizes pictures that have come before: cameras have noise, so that something repeats them."""

    def __init__(self) -> None:
        self._came: OrderedDict[int, tuple[complex, float]] = OrderedDict()

    def repeats(self, gray: Picture, legs: LegsPath) -> bool:
        """Whether a picture has come before the legs brought the body to where it is."""
        number = zlib.crc32(np.ascontiguousarray(gray).data)
        position_m, turned_rad = self._came.setdefault(number, (legs.position_m, legs.turned_rad))
        if len(self._came) > MOST_PICTURES:
            self._came.popitem(last=False)
        turned = abs(legs.turned_rad - turned_rad) > TURNED_RAD
        return turned or abs(legs.position_m - position_m) > MOVED_M


class Observer:
    """Estimates the robot's pose from pictures and leg states. All times are on one clock.

    Attributes:
        latency_s: age of a picture on arrival.
        tag: tag on the robot.
        watch: check of the camera's pose.
        height_m: height of the robot's base above the floor from its legs.
    """

    def __init__(
        self,
        robot: Robot,
        camera: Camera,
        floor_corners: Mapping[int, FloatArray],
        tag: PlacedTag,
        *,
        finder: TagFinder,
        latency_s: float = 0.0,
    ) -> None:
        self.latency_s, self.tag = latency_s, tag
        self.watch = CameraWatch(camera, floor_corners, finder)
        self.height_m = robot.standing_height_m
        self._tracker = RobotTracker(tag, finder)
        self._filter = PoseFilter()
        self._odometer = LegOdometer(robot)
        self._legs, self._standing, self._pictures = LegsPath(), StandingPosition(), RepeatedPictures()
        self._up_body = LEVEL
        self._newest: PoseEstimate | None = None

    def listen(self, state: LegState) -> None:
        """Add a state of the legs; states out of order are ignored."""
        step = self._odometer.update(state.at_s, state.joint_positions_rad, state.foot_contacts)
        if step is None:
            return
        self.height_m, self._up_body = step.height_m, step.up_body
        if step.motion is not None:
            self._legs.move(step.motion)
            self._filter.move(step.from_s, step.to_s, step.motion, state.yaw_rad)

    def look(self, gray: Picture, came_s: float) -> Observation:
        """Look at a picture that came at a time."""
        if self._pictures.repeats(gray, self._legs):
            return Observation(None, False, None, frozen=True)
        change = self.watch.look(gray)
        expected = None if self._newest is None else self._newest.pose
        robot = self._tracker.find(gray, self.watch.camera, self.height_m, expected, self._up_body)
        if robot is not None and self._standing.stands(
            robot.pose_floor.x_m, robot.pose_floor.y_m, self._legs
        ):
            self._filter.forget()
            return Observation(robot, False, change, frozen=True)
        accepted = robot is not None and self._may_be_accepted(robot)
        if robot is not None and accepted:
            taken_s, pose = came_s - self.latency_s, robot.pose_floor
            self._odometer.see(taken_s, np.array([pose.x_m, pose.y_m, pose.yaw_rad]))
            accepted = self._filter.see(Sighting(taken_s, pose, robot.covariance))
        return Observation(robot, accepted, change)

    def estimate(self, now_s: float) -> PoseEstimate:
        """Where the robot is at a time; to be asked at a steady rate, with times that ascend."""
        self._newest = self._filter.estimate(now_s)
        return self._newest

    def _may_be_accepted(self, robot: SeenRobot) -> bool:
        if self.watch.doubt is None:
            return True
        known = None if self._newest is None else self._newest.pose
        if self.watch.doubt == "moved" or known is None:
            return False
        away_m = math.hypot(robot.pose_floor.x_m - known.x_m, robot.pose_floor.y_m - known.y_m)
        return away_m < NEAR_M
