"""A walk whose velocity may change at every tick."""

import math

import numpy as np

from hexctl.control.controllers import Controller, joints_of_feet, soft_stop_steps
from hexctl.control.preparation import WalkStart
from hexctl.control.steering import Course, CourseHold, SteeringGains
from hexctl.errors import InputError, check_type
from hexctl.gait.foot_trajectory import feet_at_phases, phase_in_cycle, ramp, strokes_per_velocity
from hexctl.gait.gait import STROKES_PER_CYCLE, half_amplitude_turn_rate_rad_s, ideal_speed_m_s
from hexctl.types import BoolArray, FloatArray, RobotState

#: Time constant with which the strokes follow the velocity that is asked for.
RESPONSE_S = 0.2

#: Strokes may be longer than the gait's amplitude by this factor; more is scaled down, all feet alike.
OVERDRIVE = 1.2


class SteeredWalk(Controller):
    """Walks with a gait along the line of the trial, its course corrected at every tick.

    Strokes are proportional to the velocity asked for and follow it smoothly, so that no foot jumps. A walk
    in a batch is the same to the last bit as alone.

    Args:
        start: the robot, or batch of robots, ready to walk.
        hold: `line`, or `heading`: positions are then ignored.
        gains: of the law.

    Attributes:
        limited_steps: steps in which strokes were scaled down, leading shape.
    """

    def __init__(self, start: WalkStart, *, hold: str = "line", gains: SteeringGains | None = None) -> None:
        check_type(start, WalkStart, "start", "a WalkStart, as a trial gives to its controller")
        robot, plans, frame = start.robot, start.plans, start.frame
        if frame is None:
            raise InputError("steering: got a robot without a pose; allowed: one that knows position and yaw")
        self.hold = hold
        self._robot, self._period_s, self._held_legs = robot, start.period_s, plans[0].held_legs
        pick = 0 if start.batch_shape == () else slice(None)
        gaits = [plan.gait for plan in plans]

        def each(values: list[float]) -> FloatArray:
            return np.array(values, dtype=float)[pick]

        self._offsets = (np.array([gait.slots for gait in gaits])[pick] - 1) / 6
        self._pace_hz = each([gait.pace_hz for gait in gaits])
        self._height_m = each([gait.height * robot.size_m for gait in gaits])[..., np.newaxis]
        amplitude_m = each([gait.amplitude * robot.size_m for gait in gaits])
        self._most_stroke_m2 = (OVERDRIVE * amplitude_m) ** 2
        self._per_velocity = strokes_per_velocity(robot, self._pace_hz)
        self._law = CourseHold(
            Course(origin_world=frame.origin_world[:2], heading_rad=frame.heading_rad, yaw_rad=frame.yaw_rad),
            speed_m_s=each([ideal_speed_m_s(robot, p.gait, p.motion(0.0)) for p in plans]),
            cycle_s=1 / self._pace_hz,
            stride_m=STROKES_PER_CYCLE * amplitude_m,
            most_turn_rad_s=each([half_amplitude_turn_rate_rad_s(robot, gait) for gait in gaits]),
            hold=hold,
            gains=gains,
        )
        self._velocity_body = self._law.velocity_body
        self._cycles = np.zeros(start.batch_shape)[()]
        self.limited_steps = np.zeros(start.batch_shape, dtype=int)[()]
        self._last_step = 0
        self._stop_step: int | None = None

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        dt_s = (step - self._last_step) * self._period_s
        self._last_step = step
        if dt_s > 0:
            wanted = self._law.update(dt_s, state)
            share = 1 - math.exp(-dt_s / RESPONSE_S)
            self._velocity_body = self._velocity_body + share * (wanted - self._velocity_body)
            self._cycles = self._cycles + dt_s * self._pace_hz
        u = phase_in_cycle(np.asarray(self._cycles)[..., np.newaxis] + self._offsets, 1)
        stop_s = None if self._stop_step is None else self._stop_step * self._period_s
        envelope = float(ramp(step * self._period_s, stop_s))
        feet = feet_at_phases(self._robot, u, self._strokes(), self._height_m, envelope)
        return joints_of_feet(self._robot, feet, self._held_legs)

    def _strokes(self) -> FloatArray:
        """Strokes of the feet now, leading shape + (6, 2) in m, scaled to what the gait allows."""
        velocity = self._velocity_body[..., np.newaxis, np.newaxis, :]
        per = self._per_velocity
        strokes = per[..., 0] * velocity[..., 0] + per[..., 1] * velocity[..., 1]
        strokes = strokes + per[..., 2] * velocity[..., 2]
        squares = strokes[..., 0] * strokes[..., 0] + strokes[..., 1] * strokes[..., 1]
        longest = squares.max(axis=-1)
        too_long: BoolArray = longest > self._most_stroke_m2
        if too_long.any():
            self.limited_steps = self.limited_steps + too_long
            scale = np.sqrt(self._most_stroke_m2 / np.maximum(longest, self._most_stroke_m2))
            strokes = strokes * scale[..., np.newaxis, np.newaxis]
        return np.asarray(strokes)

    def stop(self, step: int) -> None:
        """Begin the soft stop at a step; it lasts `soft_stop_steps`."""
        if self._stop_step is None:
            self._stop_step = step

    def done(self, step: int, state: RobotState) -> bool:
        """Whether a soft stop has ended."""
        return self._stop_step is not None and step >= self._stop_step + soft_stop_steps(self._period_s) - 1
