"""Frames of a robot in ROS, as REP 105 has them: `odom` drifts and does not jump, `map` may jump."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from hexctl.ik.leg_odometer import LegOdometer
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z, inverse, product, turned, yaw_rad
from hexctl.server.ros.snapshot import RobotSnapshot
from hexctl.types import ArrayFields, FloatArray, RobotState

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class BodyPose(ArrayFields):
    """Where a body, or a frame, is in another frame.

    Attributes:
        position_m: of its origin, (3,).
        quaternion: its orientation (w, x, y, z), (4,).
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
        """x, y, z in m and the quaternion as ROS orders it, (x, y, z, w): (7,)."""
        return np.concatenate([self.position_m, self.quaternion[1:], self.quaternion[:1]])


class DeadReckoning:
    """Pose of a robot by what it measures itself, state by state.

    Its legs tell how it goes and how high it is, its IMU how it turns and leans. Without an IMU the legs tell
    how it turns, and it counts as level: the lean that legs tell jumps where other feet begin to carry.

    Args:
        robot: geometry and masses.
        start: where it begins; at the origin, as high as the legs say, unless given.
    """

    def __init__(self, robot: Robot, start: BodyPose | None = None) -> None:
        self._odometer = LegOdometer(robot)
        begun = BodyPose(np.zeros(3), _LEVEL) if start is None else start
        self._position_m = begun.position_m.copy()
        self._yaw_rad, self._tilt = _parted(begun.quaternion)
        self._own_yaw_rad: float | None = None
        self._has_height = start is not None

    def update(self, state: RobotState, orientation: FloatArray | None) -> BodyPose:
        """Pose after a state.

        Args:
            state: whose pose is not looked at.
            orientation: (4,) that an IMU measured; None where there is none.
        """
        turn_rad = self._turn_rad(orientation)
        motion = self._moved(state)
        if motion is not None:
            forward_m, left_m, legs_turn_rad = motion.tolist()
            cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
            self._position_m[:2] += (cos * forward_m - sin * left_m, sin * forward_m + cos * left_m)
            turn_rad = legs_turn_rad if turn_rad is None else turn_rad
        self._yaw_rad += turn_rad or 0.0
        return BodyPose(self._position_m.copy(), product(about_z(self._yaw_rad), self._tilt))

    def see(self, at_s: float, pose: BodyPose) -> None:
        """Take in a pose from outside: only which leg carries nothing is told by it, and no place.

        Args:
            at_s: when, on the clock of the states.
            pose: of the body in any frame that stays.
        """
        place = np.array([*pose.position_m[:2], float(yaw_rad(pose.quaternion))])
        self._odometer.see(at_s, place)

    def _turn_rad(self, orientation: FloatArray | None) -> float | None:
        """Turn since the last state by the IMU, None where it does not say; its tilt is kept."""
        before, self._own_yaw_rad = self._own_yaw_rad, None
        if orientation is None or not np.isfinite(orientation).all():
            return None
        self._own_yaw_rad, self._tilt = _parted(orientation)
        return None if before is None else math.remainder(self._own_yaw_rad - before, math.tau)

    def _moved(self, state: RobotState) -> FloatArray | None:
        """Motion of the legs since the last state, None where they do not say; rises with them."""
        step = self._odometer.update(state.stamp_s, state.joint_positions_rad, state.foot_contacts)
        if step is None:
            return None
        if not self._has_height:
            self._has_height, self._position_m[2] = True, step.height_m - step.rise_m
        self._position_m[2] += step.rise_m
        return step.motion


def _parted(quaternion: FloatArray) -> tuple[float, FloatArray]:
    """Yaw in rad of an orientation, and what is left of it without: roll and pitch, with w of 0 or more."""
    yaw = float(yaw_rad(quaternion))
    tilt = product(about_z(-yaw), quaternion)
    return yaw, -tilt if tilt[0] < 0 else tilt


MAP_FRAME = "map"


class Frames:
    """Where a robot is in `odom`, and `odom` in `map`.

    A robot with a pose of its own has no `map`: that pose is the one in `odom`. A pose from outside is the
    one in `map`, and the one in `odom` is dead reckoning, which goes on where the robot's own pose ended. It
    begins with the first subscriber, as it takes half a millisecond of each control period, and then never
    pauses: who subscribes again finds the frame where it was.

    Args:
        robot: geometry and masses.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._own: RobotSnapshot | None = None
        self._reckoning: DeadReckoning | None = None
        self._body: BodyPose | None = None
        self._odom: BodyPose | None = None
        self._posed_at_s: float | None = None

    def follow(self, snapshot: RobotSnapshot, *, wanted: bool) -> None:
        """Take in a state, each of them.

        Args:
            snapshot: of the robot.
            wanted: whether anything subscribes to where the robot is.
        """
        if snapshot.posed_at_s is None:
            self._own = snapshot
            return
        if self._reckoning is None and wanted:
            self._reckoning = self._begun()
        if self._reckoning is None:
            return
        self._body = self._reckoning.update(snapshot.state, snapshot.orientation)
        pose = BodyPose.of(snapshot.state)
        if pose is not None and snapshot.posed_at_s != self._posed_at_s:
            self._odom = _parent(pose, self._body, has_tilt=snapshot.orientation is not None)
            self._posed_at_s = snapshot.posed_at_s
            self._reckoning.see(snapshot.state.stamp_s, pose)

    def body_in_odom(self, snapshot: RobotSnapshot) -> BodyPose | None:
        """Pose of `base_link` in `odom`, None where it is not known."""
        return BodyPose.of(snapshot.state) if snapshot.posed_at_s is None else self._body

    def odom_in_map(self, snapshot: RobotSnapshot) -> BodyPose | None:
        """Pose of `odom` in `map`, None where there is no `map`.

        It changes with each pose from outside, and stays while none comes.
        """
        return None if snapshot.posed_at_s is None else self._odom

    def _begun(self) -> DeadReckoning:
        own = self._own
        if own is None:
            return DeadReckoning(self._robot)
        begun = DeadReckoning(self._robot, BodyPose.of(own.state))
        begun.update(own.state, own.orientation)
        return begun


def _parent(pose: BodyPose, body: BodyPose, *, has_tilt: bool) -> BodyPose:
    """Pose in `map` of the frame in which a body is at `body`, while it is at `pose` in `map`.

    An orientation that is exactly level is that of something which does not see roll and pitch, such as a
    camera: these stay as the robot measures them, if it does, and the frame does not sway with them.
    """
    level = not pose.quaternion[1:3].any()
    if level and has_tilt:
        turn: FloatArray = about_z(float(yaw_rad(pose.quaternion) - yaw_rad(body.quaternion)))
    else:
        turn = product(pose.quaternion, inverse(body.quaternion))
    return BodyPose(pose.position_m - turned(turn, body.position_m), turn)
