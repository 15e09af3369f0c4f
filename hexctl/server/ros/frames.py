"""Frames of a robot in ROS by REP 105: `odom` drifts without jumps, `map` may jump."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from hexctl.ik.leg_odometer import LegOdometer
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z, inverse, product, turned, yaw_rad
from hexctl.server.snapshot import RobotSnapshot
from hexctl.types import ArrayFields, FloatArray, RobotState
from hexctl.wire.ros.odometry_error import ReckoningError, own_pose_covariance

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class FramePose(ArrayFields):
    """Pose of a body or a frame in another frame.

    Attributes:
        position_m: (3,).
        quaternion: (w, x, y, z), (4,).
    """

    position_m: FloatArray
    quaternion: FloatArray

    @classmethod
    def of(cls, state: RobotState) -> Self | None:
        """Pose in a state; None unless all of it is known and finite."""
        position, quaternion = state.base_position_world, state.base_quaternion_world
        if position is None or quaternion is None:
            return None
        finite = np.isfinite(position).all() and np.isfinite(quaternion).all()
        return cls(position, quaternion) if finite else None

    @property
    def numbers(self) -> FloatArray:
        """x, y, z in m and the quaternion in the order of ROS, (x, y, z, w): (7,)."""
        return np.concatenate([self.position_m, self.quaternion[1:], self.quaternion[:1]])


class DeadReckoning:
    """Pose of a robot by its own measurements.

    Legs measure motion and height, the IMU turn and tilt. Without an IMU the legs measure the turn too, and
    the body counts as level: the tilt by the legs jumps when other feet begin to carry.

    Attributes:
        error: how far it may be off.
    """

    def __init__(self, robot: Robot, start: FramePose | None = None) -> None:
        self._odometer = LegOdometer(robot)
        begun = FramePose(np.zeros(3), _LEVEL) if start is None else start
        self._position_m = begun.position_m.copy()
        self._yaw_rad, self._tilt = _parted(begun.quaternion)
        self._own_yaw_rad: float | None = None
        self._at_s: float | None = None
        self.error = ReckoningError()
        self._has_height = start is not None

    def update(self, state: RobotState, orientation: FloatArray | None) -> FramePose:
        """Pose after a state, whose pose is ignored; `orientation` (4,) is from an IMU, or None."""
        turn_rad = self._turn_rad(orientation)
        motion = self._moved(state)
        if motion is not None:
            forward_m, left_m, legs_turn_rad = motion.tolist()
            cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
            self._position_m[:2] += (cos * forward_m - sin * left_m, sin * forward_m + cos * left_m)
            turn_rad = legs_turn_rad if turn_rad is None else turn_rad
        self._yaw_rad += turn_rad or 0.0
        self._grow(state, motion, turn_rad or 0.0, imu=self._own_yaw_rad is not None)
        return FramePose(self._position_m.copy(), product(about_z(self._yaw_rad), self._tilt))

    def see(self, at_s: float, pose: FramePose) -> None:
        """Take in an external pose, on the clock of the states: it only reveals unloaded legs."""
        place = np.array([*pose.position_m[:2], float(yaw_rad(pose.quaternion))])
        self._odometer.see(at_s, place)

    def _grow(self, state: RobotState, motion: FloatArray | None, turn_rad: float, *, imu: bool) -> None:
        passed_s = 0.0 if self._at_s is None else max(0.0, state.stamp_s - self._at_s)
        self._at_s = state.stamp_s
        moved_m = 0.0 if motion is None else math.hypot(motion[0], motion[1])
        self.error.grow(moved_m, turn_rad, passed_s, measured=state.measured, imu=imu)

    def _turn_rad(self, orientation: FloatArray | None) -> float | None:
        """Turn since the last state by the IMU, or None; stores its tilt."""
        before, self._own_yaw_rad = self._own_yaw_rad, None
        if orientation is None or not np.isfinite(orientation).all():
            return None
        self._own_yaw_rad, self._tilt = _parted(orientation)
        return None if before is None else math.remainder(self._own_yaw_rad - before, math.tau)

    def _moved(self, state: RobotState) -> FloatArray | None:
        """Motion since the last state by the legs, or None; follows the height too."""
        step = self._odometer.update(state.stamp_s, state.joint_positions_rad, state.foot_contacts)
        if step is None:
            return None
        if not self._has_height:
            self._has_height, self._position_m[2] = True, step.height_m - step.rise_m
        self._position_m[2] += step.rise_m
        return step.motion


def _parted(quaternion: FloatArray) -> tuple[float, FloatArray]:
    """Yaw in rad, and the rest of an orientation: roll and pitch, with w >= 0."""
    yaw = float(yaw_rad(quaternion))
    tilt = product(about_z(-yaw), quaternion)
    return yaw, -tilt if tilt[0] < 0 else tilt


MAP_FRAME = "map"


class Frames:
    """Pose of a robot in `odom`, and of `odom` in `map`.

    A robot that measures its own pose has no `map`. With an external pose, which is the one in `map`, the
    pose in `odom` is dead reckoning. It starts with the first subscriber, because it takes 0.5 ms of each
    control period, and never pauses: later subscribers find the same frame.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._own: RobotSnapshot | None = None
        self._reckoning: DeadReckoning | None = None
        self._body: FramePose | None = None
        self._odom: FramePose | None = None
        self._posed_at_s: float | None = None

    def follow(self, snapshot: RobotSnapshot, *, subscribed: bool) -> None:
        """Take in every state; `subscribed` means that anything subscribes to the pose."""
        if snapshot.posed_at_s is None:
            self._own = snapshot
            return
        if self._reckoning is None and subscribed:
            self._reckoning = self._begun()
        if self._reckoning is None:
            return
        self._body = self._reckoning.update(snapshot.state, snapshot.orientation)
        pose = FramePose.of(snapshot.state)
        if pose is not None and snapshot.posed_at_s != self._posed_at_s:
            self._odom = _parent(pose, self._body, has_tilt=snapshot.orientation is not None)
            self._posed_at_s = snapshot.posed_at_s
            self._reckoning.see(snapshot.state.stamp_s, pose)

    def body_in_odom(self, snapshot: RobotSnapshot) -> FramePose | None:
        """Pose of `base_link` in `odom`, or None if unknown."""
        return FramePose.of(snapshot.state) if snapshot.posed_at_s is None else self._body

    def covariance(self, snapshot: RobotSnapshot) -> FloatArray:
        """Covariance of that pose, (36,)."""
        if self._reckoning is None or snapshot.posed_at_s is None:
            return own_pose_covariance()
        return self._reckoning.error.covariance(imu=snapshot.orientation is not None)

    def odom_in_map(self, snapshot: RobotSnapshot) -> FramePose | None:
        """Pose of `odom` in `map`, of the last external pose; None without `map`."""
        return None if snapshot.posed_at_s is None else self._odom

    def _begun(self) -> DeadReckoning:
        own = self._own
        if own is None:
            return DeadReckoning(self._robot)
        begun = DeadReckoning(self._robot, FramePose.of(own.state))
        begun.update(own.state, own.orientation)
        return begun


def _parent(pose: FramePose, body: FramePose, *, has_tilt: bool) -> FramePose:
    """Pose in `map` of the frame in which a body is at `body`, while it is at `pose` in `map`.

    An exactly level `pose` is from a source without tilt, such as a camera: the measured tilt replaces it.
    """
    level = not pose.quaternion[1:3].any()
    if level and has_tilt:
        turn: FloatArray = about_z(float(yaw_rad(pose.quaternion) - yaw_rad(body.quaternion)))
    else:
        turn = product(pose.quaternion, inverse(body.quaternion))
    return FramePose(pose.position_m - turned(turn, body.position_m), turn)
