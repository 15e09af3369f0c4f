"""A walk for driving: it stands without a command, and can stop at any moment of a step.

Each foot has an offset d from its stance position p in the body frame. With the velocity v and the turn rate
omega of the body, and the duration T_s of a stance,

    stance  d' = -(v + omega x p)
    swing   d moves evenly to -T_s/2 of that for the commanded velocity, in the rest of the swing

At a constant velocity these are the strokes of `VelocityWalk`. The velocity is limited: no stance foot gets
further than half the longest stroke from its place. To stop, the robot slows down and puts its swing feet
down where they are.
"""

from collections.abc import Callable

import numpy as np

from hexctl.control.controllers import joints_of_feet
from hexctl.control.preparation import WalkStart
from hexctl.control.walks.velocity_walk import FULL_SPEED_S, OVERDRIVE, VelocityWalk
from hexctl.errors import InputError
from hexctl.gait.body_pose import BodyPose
from hexctl.gait.foot_trajectory import SWING_END, SWING_START, lift_offset, part_of_cycle
from hexctl.gait.gait import Gait
from hexctl.types import FloatArray, RobotState

#: Time to lift the feet to their height, and to stop from full speed on all feet. Soft servos sway for up to
#: 0.2 s: with a halt of 0.15 s pexod's body was not always at rest within 0.3 s.
LIFT_S, HALT_S = 0.15, 0.1

#: Maximum speed of a swing foot, relative to that in the longest stroke.
FASTEST_SWING = 1.25

#: Feet nearer to their places than this, in strokes, need no step.
AT_HOME = 0.02

#: The commanded velocity: forward and left in m/s, turn in rad/s, (3,).
VelocityCommand = Callable[[], FloatArray]


class DriveWalk(VelocityWalk):
    """Walks with the velocity that `desired` returns, stands while it is 0; foot offsets are (6, 2) in m."""

    def __init__(self, start: WalkStart, desired: VelocityCommand) -> None:
        if start.batch_shape:
            raise InputError(f"drive: got a batch of {len(start.plans)} robots; allowed: one robot")
        super().__init__(start)
        self.leave_plain()
        self._desired = desired
        self.offsets_m: FloatArray = np.zeros_like(self._turning_m)
        self._lifted = 0.0
        self._phases_then = self._u()
        self._going_home = False

    @property
    def at_rest(self) -> bool:
        """Whether it stands on all feet, and none moves, apart from levelling."""
        return self._lifted == 0 and not self.velocity_body.any() and self.poser.at_rest

    @property
    def home(self) -> bool:
        """Whether all stepping feet are at their places of the stance."""
        away_m = np.hypot(*self.offsets_m.T) * self._pattern.stepping
        return bool(away_m.max() <= AT_HOME * self._pattern.amplitude_m)

    @property
    def leg_phases(self) -> FloatArray | None:  # type: ignore[override]  # None while legs do not step
        """Normalised time of each leg in the last step, (6,); None unless the feet step at full height."""
        return self._u() if self._lifted == 1 else None

    def go_home(self) -> None:
        """Step in place until all feet are at their stance positions, or a velocity is commanded."""
        self._going_home = self._lifted > 0 or not self.home

    def pose_body(self, pose: BodyPose) -> None:
        """Move the body to a pose over its feet, as far as the legs reach."""
        self.poser.move_to(pose, self._pattern)

    def reach(self, pose: BodyPose) -> float:
        """Share of a body pose that the legs reach."""
        return self.poser.reach(pose, self._pattern)

    def change_gait(self, gait: Gait) -> None:
        """Glide to a gait, or to the one that suits the failed legs: phases, heights and posture."""
        self.glide_to(self.suited([gait]))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (18,)."""
        dt_s = (step - self._last_step) * self._period_s
        self._last_step = step
        desired = np.asarray(self._desired(), dtype=float)
        self._going_home = self._going_home and not desired.any()
        stepping = self._going_home or bool(desired.any())
        if dt_s > 0:
            self.poser.update(dt_s, state, self._pattern)
            self._accelerate(dt_s, desired, stepping)
            self._advance(step, dt_s, desired, stepping)
        feet = self.poser.feet(self._feet())
        self._meet_ground(dt_s, self._u(), feet, self._lifted, state)
        return joints_of_feet(self._robot, feet, self._held)

    def _feet(self) -> FloatArray:
        pattern = self.poser.lowered(self._pattern)
        feet = self._robot.stance_feet_body.copy()
        feet += pattern.posture_m
        feet[:, :2] += self.offsets_m * pattern.stepping[:, np.newaxis]
        feet[:, 2] += (
            self._lifted * pattern.stepping * lift_offset(self._u(), pattern.swing) * pattern.height_m
        )
        return feet if self.foot_offsets_m is None else feet + self.foot_offsets_m

    def _u(self) -> FloatArray:
        return part_of_cycle(self._cycles + self._pattern.phases)

    def _swing(self) -> tuple[float, float]:
        share = self._pattern.swing_share
        if share is None:
            return SWING_START, SWING_END
        half = float(share[0]) / 2
        return 0.5 - half, 0.5 + half

    def _most_stroke(self) -> float:
        return OVERDRIVE * float(self._pattern.amplitude_m * self.poser.stroke_share)

    def _over_floor(self, velocity: FloatArray) -> FloatArray:
        """Velocities of stance feet in the body frame, (6, 2) in m/s."""
        return np.asarray(velocity[2] * self._turning_m - velocity[:2])

    def _accelerate(self, dt_s: float, desired: FloatArray, stepping: bool) -> None:
        lifted = self._lifted + (dt_s / LIFT_S if stepping else -dt_s / HALT_S)
        self._lifted = float(np.clip(lifted, 0.0, 1.0))
        full_m_s = self._most_change * FULL_SPEED_S
        change = desired - self.velocity_body
        size_m_s = float(np.linalg.norm(change * (1.0, 1.0, self._robot.stance_radius_m)))
        most_m_s = float(full_m_s) * OVERDRIVE * dt_s / (FULL_SPEED_S if desired.any() else HALT_S)
        if size_m_s > most_m_s:
            change = change * (most_m_s / size_m_s)
        velocity = self.velocity_body + change
        share = self._allowed(velocity)
        if stepping and share < 1:
            self.limited_steps = self.limited_steps + 1
        self.velocity_body = velocity * share

    def _allowed(self, velocity: FloatArray) -> float:
        """Share of a velocity at which each stance foot swings before it is too far from its place."""
        begins, ends = self._swing()
        u, pace_hz = self._u(), float(self._pattern.pace_hz)
        on_floor = (u < begins) | (u >= ends)
        left_s = np.where(on_floor, (begins - u) % 1.0, 0.0) / pace_hz
        way_m = self._over_floor(velocity) * left_s[:, np.newaxis] * self._pattern.stepping[:, np.newaxis]
        most_m = self._most_stroke() / 2
        # The maximum s of 0..1 with |d + s way| <= most, for each foot.
        a = (way_m * way_m).sum(axis=1)
        b = (self.offsets_m * way_m).sum(axis=1)
        c = np.minimum((self.offsets_m * self.offsets_m).sum(axis=1) - most_m**2, 0.0)
        moving = a > 0
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        shares = (root - b)[moving] / a[moving]
        return float(np.clip(shares.min(initial=1.0) + 1e-9, 0.0, 1.0))

    def _advance(self, step: int, dt_s: float, desired: FloatArray, stepping: bool) -> None:
        cycles = dt_s * float(self._pattern.pace_hz) * self._lifted
        self._cycles = self._cycles + cycles
        # A posture also changes while the robot stands.
        self._change(step, np.asarray(cycles if stepping else dt_s * self._pattern.pace_hz))
        then, self._phases_then = self._phases_then, self._u()
        gone = (self._phases_then - then) % 1.0
        # Gliding phases may go back a little, or change at rest: no foot moves then.
        gone = np.where(gone > 0.5, 0.0, gone) if cycles else np.zeros_like(gone)
        begins, ends = self._swing()
        before, after = _progress(then, begins, ends), _progress(then + gone, begins, ends)
        in_air_s = dt_s * np.where(
            gone > 0, (after - before) * (ends - begins) / np.maximum(gone, 1e-12), 0.0
        )
        in_air_s = np.where((before > 0) & (before < 1) & (gone == 0), dt_s, np.minimum(in_air_s, dt_s))
        floor_m = self._over_floor(self.velocity_body) * (dt_s - in_air_s)[:, np.newaxis]
        standing_s = (1 - (ends - begins)) / float(self._pattern.pace_hz)
        landing_m = -self._over_floor(desired) * standing_s / 2
        left = 1 - before
        share = np.where(left > 0, (after - before) / np.maximum(left, 1e-12), 0.0)[:, np.newaxis]
        landed = (after >= 1)[:, np.newaxis]
        lifting_off = np.where(landed, self.offsets_m, self.offsets_m + floor_m)
        way_m = share * (landing_m - lifting_off)
        # After a late change of the velocity, the foot lands short of its new goal.
        most_m = FASTEST_SWING * self._most_stroke() * float(self._pattern.pace_hz) / (ends - begins)
        far = np.hypot(*way_m.T) / np.maximum(most_m * in_air_s, 1e-12)
        moved = lifting_off + way_m / np.maximum(1.0, far)[:, np.newaxis]
        self.offsets_m = np.where(landed, moved + floor_m, moved)
        self._going_home = self._going_home and (bool(self.velocity_body.any()) or not self.home)


def _progress(u: FloatArray, begins: float, ends: float) -> FloatArray:
    """Progress of a swing at normalised times: 0 before it, 1 after it, (6,)."""
    return np.clip((u - begins) / (ends - begins), 0.0, 1.0)
