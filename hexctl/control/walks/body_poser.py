"""Moves the bodies of walks to a commanded pose over their feet, and keeps them level by an IMU.

A body moves in a straight line to its goal, at joint speeds up to `SPEED_SHARE` of the servos'. Levelling
turns it slowly against the measured roll and pitch (phi, theta), until they are those of the command:

    c' = (command - (phi, theta)) / LEVEL_S

A measurement that repeats for `FROZEN_AFTER_S` is frozen: c stays as it is until another one comes.

A pose leaves less room for strokes, which become shorter. Levelling ends where they would be shorter than
`LEVEL_STROKE`: c stays at its last value that fits, until there is more room or it turned back.
"""

import math
from dataclasses import replace

import numpy as np

from hexctl.control.walks.sensor_loss import FrozenSensor
from hexctl.gait.body_pose import LEVEL, BodyPose, feet_from_body
from hexctl.gait.foot_trajectory import StepPattern
from hexctl.ik.legs import legs_that_reach, solve_legs
from hexctl.robot.model import Robot
from hexctl.robot.rotations import components, roll_pitch_rad
from hexctl.types import BoolArray, FloatArray, RobotState, any_of

#: Share of the servos' maximum speed with which a joint moves for a pose.
SPEED_SHARE = 0.25

#: Time constant of levelling, and the maximum inclination that it compensates.
LEVEL_S, MOST_LEVEL_RAD = 1.5, 0.35

#: Tried shares of the longest stroke, and the smallest that a pose must leave, to walk and to step home.
STROKES = np.linspace(0.125, 1.0, 8)
LEAST_STROKE = 0.25

#: The smallest share that levelling leaves: level to the end, pexod climbs 15 degrees at half its speed.
LEVEL_STROKE = 0.75

#: Directions of the tried strokes.
DIRECTIONS_RAD = np.linspace(0.0, math.tau, 8, endpoint=False)

#: Tried shares of a command.
POSE_SHARES = np.linspace(0.05, 1.0, 20)

#: A pose that moved by less, in rad or stance radii, leaves the same room.
SAME_POSE = 0.005

#: Small change of a pose whose joint motion is measured, in rad or stance radii.
_PROBE = 1e-3


class BodyPoser:
    """Poses of the bodies of walks over their feet.

    Attributes:
        level: whether the bodies are kept level, if their orientation is measured; may be set.
        poses: of the bodies now, numbers of `BodyPose`, leading shape + (6,).
        commanded: those without levelling, on the way to the `goals`, likewise.
        goals: the commanded poses, as far as the legs reach them, likewise.
        stroke_share: of the longest stroke of a level body that the poses leave, leading shape.
        pose_share: of the commanded pose that the legs reach.
    """

    def __init__(
        self, robot: Robot, shape: tuple[int, ...], longest_stroke: float, *, level: bool = False
    ) -> None:
        """Begin with level bodies; the longest stroke is a multiple of the gait's amplitude."""
        self._robot, self._longest, self.level = robot, longest_stroke, level
        self.poses: FloatArray = np.zeros((*shape, 6))
        self.goals, self.commanded, self._poses_of_room = self.poses, self.poses, self.poses
        self._correction: FloatArray = np.zeros((*shape, 2))
        self._last_fitting = self._correction  # at the last measurement of the room
        self._least, self._most = self._correction - MOST_LEVEL_RAD, self._correction + MOST_LEVEL_RAD
        self._frozen_imu = FrozenSensor()
        self._pattern: StepPattern | None = None
        self._posed = False
        self._level_room: FloatArray = np.ones(shape)[()]
        self.stroke_share: FloatArray = np.ones(shape)[()]
        self._desired, self.pose_share = LEVEL, 1.0
        self._units = np.repeat([1.0, robot.stance_radius_m], 3)
        self._speeds = _pose_speeds(robot, self._units)

    @property
    def at_rest(self) -> bool:
        """Whether the bodies have the commanded pose, apart from levelling."""
        return self.commanded is self.goals or bool((self.commanded == self.goals).all())

    def reach(self, pose: BodyPose, pattern: StepPattern) -> float:
        """Share of a pose that the legs of all bodies reach with short strokes of a pattern."""
        tried = POSE_SHARES.reshape(-1, *(1,) * self.poses.ndim) * pose.array + self._level_poses()
        reached = self._room(tried, pattern, np.array([LEAST_STROKE])) > 0
        allowed = reached.reshape(len(POSE_SHARES), -1).all(axis=1)
        return float(POSE_SHARES[np.cumprod(allowed).astype(bool)].max(initial=0.0))

    def move_to(self, pose: BodyPose, pattern: StepPattern) -> None:
        """Move to a pose, scaled down to the legs' reach."""
        self._desired, self.pose_share = pose, self.reach(pose, pattern)
        self.goals = np.broadcast_to(self.pose_share * pose.array, self.poses.shape)

    def give_up_goal(self) -> None:
        """Let the bodies stay as they are, on the way to the goal."""
        self.goals, self._desired = self.commanded, BodyPose.of(self.commanded.reshape(-1, 6)[0])

    def update(self, dt_s: float, state: RobotState, pattern: StepPattern) -> None:
        """Move the bodies, `dt_s` after the last update."""
        moves = not self.at_rest
        if not (moves or self.level or self._posed or self._desired != LEVEL):
            return
        if moves:
            change = self.goals - self.commanded
            needed_s = np.add.reduce(np.abs(change) / self._speeds, axis=-1)[..., np.newaxis]
            going = self.commanded + dt_s / np.maximum(needed_s, dt_s) * change
            self.commanded = np.where(needed_s > dt_s, going, self.goals)
            self._free_levelling(np.asarray(True))
        levels = self.level or bool(self._correction.any())
        if levels:
            self._level(dt_s, state)
        if not (moves or levels or (pattern is not self._pattern and self._desired != LEVEL)):
            return
        self.poses = self.commanded + self._level_poses()
        self._measure_room(pattern)
        self._posed = bool(self.poses.any())

    def feet(self, feet_m: FloatArray) -> FloatArray:
        """Feet in the frames of the posed bodies, of feet of level ones, leading shape + (6, 3) in m."""
        return feet_from_body(feet_m, self.poses) if self._posed else feet_m

    def lowered(self, pattern: StepPattern) -> StepPattern:
        """Pattern with the step heights that the poses leave."""
        if not any_of(self.stroke_share < 1.0):
            return pattern
        return replace(pattern, height_m=pattern.height_m * lift_share(self.stroke_share)[..., np.newaxis])

    def _level(self, dt_s: float, state: RobotState) -> None:
        quaternion = state.base_quaternion_world
        if not self.level:
            self._correction = np.where(
                np.abs(self._correction) < SAME_POSE, 0.0, (1 - dt_s / LEVEL_S) * self._correction
            )
        if quaternion is None or not self.level:
            return
        w, x, y, z = components(quaternion)
        unseen = np.asarray(self._frozen_imu.update(dt_s, w, x, y, z))[..., np.newaxis]
        error = self.commanded[..., :2] - np.stack(roll_pitch_rad(quaternion), axis=-1)
        correction = self._correction + dt_s / LEVEL_S * np.where(np.isfinite(error) & ~unseen, error, 0.0)
        self._correction = np.clip(correction, self._least, self._most)

    def _end_levelling(self, rows: BoolArray) -> None:
        """Undo what did not fit in `rows`, leading shape; the angle that grew most, in rad, ends there."""
        grown = np.abs(self._correction) - np.abs(self._last_fitting)
        ends = rows[..., np.newaxis] & (grown == grown.max(axis=-1, keepdims=True))
        self._most = np.where(ends & (self._correction > 0), self._last_fitting, self._most)
        self._least = np.where(ends & (self._correction < 0), self._last_fitting, self._least)
        self._correction = np.where(rows[..., np.newaxis], self._last_fitting, self._correction)

    def _free_levelling(self, rows: BoolArray) -> None:
        """Level up to the maximum again in `rows`, leading shape."""
        self._least = np.where(rows[..., np.newaxis], -MOST_LEVEL_RAD, self._least)
        self._most = np.where(rows[..., np.newaxis], MOST_LEVEL_RAD, self._most)

    def _level_poses(self) -> FloatArray:
        """Poses of only levelling, leading shape + (6,)."""
        poses = np.zeros_like(self.poses)
        poses[..., :2] = self._correction
        return poses

    def _measure_room(self, pattern: StepPattern) -> None:
        """Measure the room for strokes if it may have changed; levelling that leaves too little is undone."""
        moved = np.asarray((np.abs(self.poses - self._poses_of_room) > SAME_POSE * self._units).any(axis=-1))
        if self._pattern is not pattern:
            self._pattern, moved = pattern, np.ones_like(moved)
            self._free_levelling(moved)
            self._level_room = self._room(np.zeros_like(self.poses), pattern, STROKES)
            if self._desired != LEVEL:
                self.move_to(self._desired, pattern)  # another gait reaches more or less
        if not any_of(moved):
            return
        share = self._share(pattern)
        levelled = (self._correction != self._last_fitting).any(axis=-1)
        too_far = np.asarray(moved & levelled & (share < np.minimum(self.stroke_share, LEVEL_STROKE)))
        if any_of(too_far):
            self._end_levelling(too_far)
            self.poses = self.commanded + self._level_poses()
            share = self._share(pattern)
        away = np.minimum(self._correction - self._least, self._most - self._correction)
        turned_back = (away > SAME_POSE).all(axis=-1)
        self._free_levelling(np.asarray(moved & ~too_far & (turned_back | (share > self.stroke_share))))
        self._last_fitting = np.where(moved[..., np.newaxis], self._correction, self._last_fitting)
        self._poses_of_room = np.where(moved[..., np.newaxis], self.poses, self._poses_of_room)
        self.stroke_share = np.where(moved, share, self.stroke_share)[()]

    def _share(self, pattern: StepPattern) -> FloatArray:
        """Share of the strokes of level bodies that the poses leave, leading shape."""
        share = self._room(self.poses, pattern, STROKES) / np.maximum(self._level_room, STROKES[0])
        return np.asarray(np.clip(share, LEAST_STROKE, 1.0))

    def _room(self, poses: FloatArray, pattern: StepPattern, shares: FloatArray) -> FloatArray:
        """Largest share of the steps within reach, in every direction, of poses (..., 6): (...)."""
        robot = self._robot
        places = self._step_places(pattern, shares)
        places = places + pattern.posture_m[..., np.newaxis, np.newaxis, :, :]
        feet = robot.stance_feet_body + places  # leading shape + (shares, places, 6, 3)
        reach = legs_that_reach(robot, feet_from_body(feet, poses[..., np.newaxis, np.newaxis, :]))
        reach = reach | (pattern.stepping[..., np.newaxis, np.newaxis, :] == 0)
        within = reach.all(axis=(-1, -2))
        return np.asarray(np.where(np.cumprod(within, axis=-1), shares, 0.0).max(axis=-1))

    def _step_places(self, pattern: StepPattern, shares: FloatArray) -> FloatArray:
        """Places of a foot in steps of some shares from the stance, leading shape + (shares, 9, 1, 3)."""
        places = np.zeros((*np.shape(pattern.pace_hz), len(shares), 1 + len(DIRECTIONS_RAD), 1, 3))
        ahead = np.stack([np.cos(DIRECTIONS_RAD), np.sin(DIRECTIONS_RAD)], axis=-1)
        radius_m = self._longest / 2 * np.multiply.outer(pattern.amplitude_m, shares)
        places[..., 1:, 0, :2] = radius_m[..., np.newaxis, np.newaxis] * ahead
        places[..., 0, 0, 2] = pattern.height_m * lift_share(shares)
        return places


def lift_share(stroke_share: FloatArray) -> FloatArray:
    """Share of the step height with a share of the stroke: heights shrink half as much."""
    return 0.5 + 0.5 * stroke_share


def _pose_speeds(robot: Robot, units: FloatArray) -> FloatArray:
    """Speed of each number of a pose at which a joint in the stance has its share of speed, (6,)."""
    poses = np.diag(_PROBE * units)
    moved = solve_legs(robot, feet_from_body(robot.stance_feet_body, poses)).joint_positions_rad
    turned = np.abs(moved - solve_legs(robot, robot.stance_feet_body).joint_positions_rad)
    return np.asarray(_PROBE * units * SPEED_SHARE / (turned / robot.joint_max_speed_rad_s).max(axis=-1))
