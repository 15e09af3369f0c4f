"""Controllers: from step and state to joint targets, for one robot or a batch of robots."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hexctl.columns import Column
from hexctl.errors import LimitError, ReachError
from hexctl.gait.foot_trajectory import (
    RAMP_DURATION_S,
    StepPattern,
    feet_of_walks,
    gait_feet_body,
    part_of_cycle,
    stroke_vectors_m,
)
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.legs import leg_joints_rad, solve_legs_within_limits
from hexctl.robot.failure import Failure, NoticedFailure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, BoolArray, FloatArray, RobotState, leg_slice

#: Ticks planned together: enough to spread numpy's cost, few enough to start without delay.
LOOK_AHEAD_TICKS = 128

#: Points of the gait cycle at which a walk is checked before its first step.
CHECKED_POINTS = 120


#: Legs that keep their stance pose; or those of each robot of a batch.
HeldLegs = tuple[int, ...] | tuple[tuple[int, ...], ...]


class Controller(ABC):
    """Joint targets for each step, from time and the robot's state.

        class Still(hexctl.Controller):
            def targets_rad(self, step, state):
                return state.joint_positions_rad

        hexctl.run(controller=Still(), duration_s=2)

    In a batch of n robots the arrays of state and targets have the leading shape (n,), otherwise none.
    `targets_rad` is therefore written elementwise over robots, with `...` in its indices.

    Attributes:
        hold: its feedback, one of `hexctl.control.trial_plan.HOLDS` except `auto`.
        velocity_body: forward and left in m/s, turn in rad/s, leading shape + (3,); None if constant.
        limited_steps: steps so far in which the commanded speed exceeded the strokes, leading shape.
        leg_phases: normalised times of the legs in the last step, leading shape + (6,); None without a cycle.
        leg_suspicion: evidence against each leg, an alarm at 1, leading shape + (6,); None without a monitor.
        own_columns: columns that it adds to logs and recordings, the same at all times.
        own_values: their values in the last step, by name; those left out are unknown.
    """

    hold: str = "none"
    velocity_body: FloatArray | None = None
    limited_steps: NDArray[np.int64] | int = 0
    leg_phases: FloatArray | None = None
    leg_suspicion: FloatArray | None = None
    own_columns: tuple[Column, ...] = ()
    own_values: Mapping[str, FloatArray] = {}

    @abstractmethod
    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint targets, leading shape + (18,), for a step in control periods; the clock may skip steps."""

    def done(self, step: int, state: RobotState) -> bool | BoolArray:
        """Whether the controller has ended at a step, asked after its targets were sent; leading shape."""
        return False

    def why_stopped(self, index: int = 0) -> str | None:
        """Why it ended the walk of a robot of a batch early, in few words, or None."""
        return None

    def noticed_failures(self, index: int = 0) -> tuple[NoticedFailure, ...]:
        """Failures that it detected so far, of one robot of a batch."""
        return ()

    def known_failures(self, index: int = 0) -> tuple[Failure, ...] | None:
        """Failures that it assumes now, given or detected, by leg; None if legs are not monitored."""
        return None

    def news(self) -> Sequence[str]:
        """Events since the last call, in lines for a recording."""
        return ()

    def stop(self, step: int) -> int:
        """Begin a soft stop at a step; the number of further steps with targets, 0 without a soft stop."""
        return 0


def soft_stop_steps(period_s: float) -> int:
    """Duration of a soft stop from full stride, in control periods."""
    return round(RAMP_DURATION_S / period_s) + 1


class Stand(Controller):
    """Moves the joints evenly from angles (18,) to the stance, or to `end_rad`, and rests there."""

    def __init__(
        self,
        robot: Robot,
        start_rad: FloatArray,
        steps: int,
        rest_steps: int = 0,
        *,
        end_rad: FloatArray | None = None,
    ) -> None:
        self._start_rad = start_rad
        self._end_rad = robot.stance_angles_rad if end_rad is None else end_rad
        self._steps = max(1, steps)
        self._last_step = steps + rest_steps - 1

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Interpolated pose between start and end, then the end."""
        if step >= self._steps:
            return self._end_rad
        share = step / self._steps
        return np.asarray((1 - share) * self._start_rad + share * self._end_rad)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether motion and rest are over."""
        return step >= self._last_step


class Walk(Controller):
    """Walks with a gait and a constant motion until stopped; n gaits and motions for a batch of n robots."""

    def __init__(
        self,
        robot: Robot,
        gaits: Gait | Sequence[Gait],
        motions: Motion | Sequence[Motion],
        *,
        period_s: float,
        held_legs: HeldLegs = (),
    ) -> None:
        self._robot, self._period_s, self._held = robot, period_s, held_joints(held_legs)
        alone = isinstance(gaits, Gait)
        each = [gaits] if isinstance(gaits, Gait) else list(gaits)
        ways = [motions] if isinstance(motions, Motion) else list(motions)
        pick = 0 if alone else slice(None)
        self._strokes = np.stack(
            [stroke_vectors_m(robot, gait, motion) for gait, motion in zip(each, ways, strict=True)]
        )[pick]
        self._pattern = StepPattern.of(robot, each[0] if alone else each)
        self._stop_step: int | None = None
        self._planned_rad: FloatArray = np.empty((0,))
        self._planned_from = self._step = 0

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles of the gait at this step, leading shape + (18,)."""
        self._step = step
        row = step - self._planned_from
        if not 0 <= row < len(self._planned_rad):
            self._plan(step)
            row = 0
        return np.asarray(self._planned_rad[row])

    @property
    def leg_phases(self) -> FloatArray:  # type: ignore[override]  # from the last step
        """Normalised time of each leg in the last step, leading shape + (6,)."""
        cycles = self._pattern.pace_hz[..., np.newaxis] * (self._step * self._period_s)
        return part_of_cycle(cycles + self._pattern.phases)

    def stop(self, step: int) -> int:
        """Begin the soft stop at a step; it takes `soft_stop_steps`."""
        if self._stop_step is None:
            self._stop_step = step
            self._planned_rad = self._planned_rad[:0]
        return soft_stop_steps(self._period_s)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether a soft stop has ended."""
        return self._stop_step is not None and step >= self._stop_step + soft_stop_steps(self._period_s) - 1

    def _plan(self, step: int) -> None:
        steps = np.arange(step, step + LOOK_AHEAD_TICKS)
        feet = feet_of_walks(
            self._robot,
            self._pattern,
            stroke_vectors=self._strokes,
            time_s=np.asarray(steps * self._period_s, dtype=float),
            stop_s=None if self._stop_step is None else self._stop_step * self._period_s,
        )
        held = None if self._held is None else self._held[..., np.newaxis, :]
        joints_rad = joints_of_feet(self._robot, feet, held)  # leading shape + (steps, 18)
        self._planned_rad = np.ascontiguousarray(joints_rad.swapaxes(0, -2))
        self._planned_from = step


def held_joints(held_legs: HeldLegs) -> BoolArray | None:
    """Joints of held legs, (18,), or (n, 18) for those of n robots; None if no leg is held."""
    rows = [legs if isinstance(legs, tuple) else (legs,) for legs in held_legs]
    if not any(rows):
        return None
    held: BoolArray = np.zeros((len(rows), N_JOINTS), dtype=bool)
    for row, legs in zip(held, rows, strict=True):
        for leg in legs:
            row[leg_slice(leg)] = True
    return held if isinstance(held_legs[0], tuple) else np.logical_or.reduce(held)


def joints_of_feet(
    robot: Robot, feet_body: FloatArray, held_legs: HeldLegs | BoolArray | None = None
) -> FloatArray:
    """Joint angles (18,) of feet (6, 3) in m, leading shapes before; held legs are in their stance."""
    joints_rad = leg_joints_rad(robot, feet_body)
    held = held_joints(held_legs) if isinstance(held_legs, tuple) else held_legs
    return joints_rad if held is None else np.where(held, robot.stance_angles_rad, joints_rad)


def check_walk(robot: Robot, gait: Gait, motion: Motion) -> None:
    """Raise ReachError or LimitError, naming leg and joint, for a walk that the legs cannot make."""
    cycle_s = RAMP_DURATION_S + np.arange(CHECKED_POINTS) / (CHECKED_POINTS * gait.pace_hz)
    solve_legs_within_limits(robot, gait_feet_body(robot, gait, motion, cycle_s))


SITTING_S = 2.0


def sitting_angles_rad(robot: Robot) -> FloatArray:
    """Joint angles, (18,), that lower the body as far as the legs can, the feet in place."""
    lift_m = robot.standing_height_m - robot.body.size_m[2] / 2
    for share in np.linspace(1.0, 0.0, 21).tolist():
        feet_body = robot.stance_feet_body + np.array([0.0, 0.0, share * lift_m])
        try:
            return solve_legs_within_limits(robot, feet_body)
        except (ReachError, LimitError):
            continue
    return robot.stance_angles_rad
