"""Preparation of a walk: settling, the self-rotation, the trial frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.clock import PERIOD_S, Tick
from hexctl.control.controllers import Controller, HeldLegs, Stand
from hexctl.control.guard import Guard
from hexctl.control.log import Recorder, Recorders, TickLog
from hexctl.control.loop import TickObserver, Until, run_controller
from hexctl.control.trace import Trace, TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import (
    MAX_TURN_STEPS,
    SMALL_TURN_RAD,
    TURN_WITHIN_RAD,
    Turn,
    TurnStep,
    TurnSteps,
    swallowed_rad,
    turn_needed_rad,
)
from hexctl.errors import RobotFaultError
from hexctl.gait.gait import Motion
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import ArrayFields, FloatArray, JointTargets, RobotState
from hexctl.waiting import StopRequested, never_stop

#: Rest between the self-rotation and the walk.
PAUSE_S = 0.5

#: Standard error of the yaw that lays the line: 3 mm at the end of 3.5 m. A noisier robot rests for longer.
LINE_ERROR_RAD = math.radians(0.05)

#: Maximum rest for that.
LONGEST_REST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkStart:
    """A robot, or a batch of n robots, that stands ready to walk.

    Attributes:
        plans: a single plan, or n in a batch.
        batch_shape: () for one robot, (n,) in a batch: the leading shape of states and targets.
        turned_rad: turn since the trial began, (n,) for different starts, as the fields of the frame.
        frame: None if the robot knows no pose.
        true_frame: the same by the true pose of a simulation, for the score only; None for other robots.
        reports_load: whether the servos report their angles and loads.
    """

    robot: Robot
    plans: tuple[TrialPlan, ...]
    batch_shape: tuple[int, ...] = ()
    period_s: float = PERIOD_S
    turned_rad: float = 0.0
    frame: TrialFrame | None = None
    true_frame: TrialFrame | None = None
    reports_load: bool = True

    @property
    def motions(self) -> list[Motion]:
        """Motion of each plan in the body frame."""
        turned_rad = np.broadcast_to(self.turned_rad, len(self.plans)).tolist()
        return [plan.motion(turned) for plan, turned in zip(self.plans, turned_rad, strict=True)]

    @property
    def held_legs(self) -> HeldLegs:
        """Legs that keep their stance pose; in a batch those of each robot."""
        each = tuple(plan.held_legs for plan in self.plans)
        return each if self.batch_shape else each[0]


def prepare(
    servos: Guard, plan: TrialPlan, recorders: Recorders | Sequence[Recorder | TickLog] = ()
) -> WalkStart:
    """Settle in the stance and turn the failed leg away; raises what `run_controller` raises."""
    return Preparation(Phases(servos, Recorders.of(recorders)), plan, never_stop).run()


def ticks_of(servos: LegServos, duration_s: float) -> int:
    """A duration in complete control periods, at least one."""
    return max(1, math.ceil(duration_s / servos.clock.period_s - 1e-9))


class Phases(TickObserver):
    """Runs controllers one after the other, each as a phase of the trial, traced and recorded."""

    def __init__(self, servos: Guard, recorders: Recorders | None) -> None:
        self.servos, self.trace, self._recorders = servos, Trace(), recorders
        self._simulation = servos.unwrapped.simulation

    def begin(self, phase: str) -> None:
        """Assign the next ticks to a phase, in the trace and in every recording."""
        self.trace.begin_phase(phase)
        if self._recorders is not None:
            self._recorders.begin_phase(phase, self.trace.frame)

    def run(
        self,
        controller: Controller,
        *,
        until: Until | None = None,
        first_step: int = 0,
        seen_by: Sequence[TickObserver] = (),
    ) -> int:
        """Run a controller until it is done; the last step."""
        if self._recorders is not None:
            self._recorders.log.controller = controller
        observers = (self, *seen_by)
        return run_controller(self.servos, controller, observers, until=until, first_step=first_step)[0]

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        """Trace and record a tick, with events before it."""
        pose = None if self._simulation is None else self._simulation.true_pose
        self.trace.add(tick.time_s, state, None if pose is None else pose[0])
        if self._recorders is not None:
            self._recorders.log.note_events(self.servos.unwrapped)
            self._recorders.record(tick, state, requested_rad, sent)

    def took(self, work_s: float) -> None:
        """Record the duration of the last tick's work."""
        if self._recorders is not None:
            self._recorders.took(work_s)


class Preparation:
    """Settling and self-rotation."""

    def __init__(self, phases: Phases, plan: TrialPlan, stop_requested: StopRequested) -> None:
        self._phases, self._plan, self._stop_requested = phases, plan, stop_requested
        self._servos, self._trace = phases.servos, phases.trace

    def run(self) -> WalkStart:
        """Settle, turn if necessary, and set the trial frame."""
        plan, robot = self._plan, self._servos.robot
        self._phases.begin("settle")
        pose = first = self._settle()
        true_yaw_rad = self._true_yaw_rad
        if not first.yaw_known or self._stop_requested():
            return self._start(0.0, self._frame_without_yaw(first), true_yaw_rad)
        turn_rad = turn_needed_rad(robot, plan)
        if abs(turn_rad) > TURN_WITHIN_RAD:
            self._phases.begin("turn")
            pose = self._turn(turn_rad, first)
        frame = TrialFrame(pose.position_world, first.yaw_rad + plan.heading_rad, pose.yaw_rad)
        return self._start(wrapped_rad(pose.yaw_rad - first.yaw_rad), frame, true_yaw_rad)

    def _settle(self) -> "_RestingPose":
        """Move to the stance and rest until the yaw is known well; the resting pose then."""
        servos = self._servos
        rested = self._stand(self._plan.settle_s)
        pose = self._resting_pose(rested)
        if pose.yaw_error_rad > LINE_ERROR_RAD and not self._stop_requested():
            needed = math.ceil(rested * (pose.yaw_error_rad / LINE_ERROR_RAD) ** 2)
            more = min(needed, ticks_of(servos, LONGEST_REST_S)) - rested
            if more > 0:
                self._phases.run(Stand(servos.robot, servos.accepted_rad(), 0, more))
                pose = self._resting_pose(rested + more)
        return pose

    def _frame_without_yaw(self, pose: "_RestingPose") -> TrialFrame | None:
        """The frame of a robot without yaw for a held line: it is assumed to face along the x axis."""
        if self._plan.hold not in ("auto", "line") or not pose.position_known:
            return None
        return TrialFrame(pose.position_world, self._plan.heading_rad, 0.0)

    def _turn(self, turn_rad: float, first: "_RestingPose") -> "_RestingPose":
        """Turn in place, then in small steps to the goal; the resting pose then."""
        robot, plan, period_s = self._servos.robot, self._plan, self._servos.clock.period_s
        pose, steps = first, TurnSteps(swallowed_rad(robot))
        if abs(turn_rad) > SMALL_TURN_RAD:
            turn = Turn(robot, plan, turn_rad, first.yaw_rad, period_s, self._stop_requested)
            pose = self._stand_after(turn)
            if turn.timed_out:
                return pose
        for _ in range(MAX_TURN_STEPS):
            missing_rad = wrapped_rad(turn_rad - (pose.yaw_rad - first.yaw_rad))
            if abs(missing_rad) <= max(TURN_WITHIN_RAD, 2 * pose.yaw_error_rad) or self._stop_requested():
                break
            step = TurnStep(robot, plan, steps.command_rad(missing_rad), period_s)
            before, pose = pose, self._stand_after(step)
            steps.learn(step.commanded_rad, wrapped_rad(pose.yaw_rad - before.yaw_rad))
        return pose

    def _stand_after(self, controller: Controller) -> "_RestingPose":
        self._phases.run(controller)
        pose = self._resting_pose(self._stand(PAUSE_S))
        if not pose.yaw_known:
            raise RobotFaultError("the robot's yaw was lost before the walk; check what measures it")
        return pose

    @property
    def _true_yaw_rad(self) -> float:
        """True yaw of a simulated robot, else NaN."""
        simulation = self._servos.unwrapped.simulation
        pose = None if simulation is None else simulation.true_pose
        return math.nan if pose is None else float(yaw_rad(pose[1]))

    def _start(self, turned_rad: float, frame: TrialFrame | None, true_yaw_rad: float) -> WalkStart:
        """The start of the walk; the true yaw is that at the start of the trial."""
        true_position_world = self._trace.true_positions_world[-1]
        true_frame = None
        if math.isfinite(true_yaw_rad + true_position_world[0]):
            heading_rad = true_yaw_rad + self._plan.heading_rad
            true_frame = TrialFrame(true_position_world, heading_rad, self._true_yaw_rad)
        return WalkStart(
            robot=self._servos.robot,
            plans=(self._plan,),
            period_s=self._servos.clock.period_s,
            turned_rad=turned_rad,
            frame=frame,
            true_frame=true_frame,
            reports_load=self._trace.reports_load,
        )

    def _stand(self, duration_s: float) -> int:
        """Move to the stance in the first half of a duration, and rest in the second; its ticks."""
        ticks = ticks_of(self._servos, duration_s)
        moving = ticks // 2
        self._phases.run(Stand(self._servos.robot, self._servos.accepted_rad(), moving, ticks - moving))
        return moving

    def _resting_pose(self, ticks: int) -> "_RestingPose":
        rest = slice(max(0, len(self._trace) - ticks - 1), None)
        return _RestingPose.of(self._trace.positions_world[rest], self._trace.quaternions_world[rest])


@dataclass(frozen=True, slots=True, eq=False)
class _RestingPose(ArrayFields):
    """Mean pose of a robot at rest: position (3,), yaw and its standard error; NaN if unknown."""

    position_world: FloatArray
    yaw_rad: float
    yaw_error_rad: float

    @classmethod
    def of(cls, positions_world: FloatArray, quaternions_world: FloatArray) -> "_RestingPose":
        positions = positions_world[np.isfinite(positions_world[:, 0])]
        position = positions.mean(axis=0) if len(positions) else np.full(3, np.nan)
        yaws = yaw_rad(quaternions_world[np.isfinite(quaternions_world[:, 0])])
        if not yaws.size:
            return cls(position, math.nan, math.nan)
        off_rad = np.array([wrapped_rad(value - yaws[-1]) for value in yaws.tolist()])
        error_rad = float(off_rad.std() / math.sqrt(len(off_rad)))
        return cls(position, float(yaws[-1]) + float(off_rad.mean()), error_rad)

    @property
    def position_known(self) -> bool:
        return math.isfinite(self.position_world[0])

    @property
    def yaw_known(self) -> bool:
        return math.isfinite(self.yaw_rad)
