"""One trial on any robot: settle, self-rotation, walk, stop; and its result."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from typing import Protocol, runtime_checkable

from hexctl.backends.base import LegServos
from hexctl.backends.clock import Tick, realtime_priority
from hexctl.control.controllers import Controller, Stand, Walk, soft_stop_steps
from hexctl.control.custom_controller import (
    CustomController,
    check_controller,
    controller_name,
    made_controller,
)
from hexctl.control.guard import Guard
from hexctl.control.log import Recorder, Recorders, TickLog
from hexctl.control.loop import TickObserver, Until
from hexctl.control.preparation import Phases, Preparation, WalkStart, ticks_of
from hexctl.control.scoring.cause import WalkSamples
from hexctl.control.scoring.score import score
from hexctl.control.scoring.walk_quality import WalkEffort
from hexctl.control.sit_down import sit_down
from hexctl.control.telemetry_watch import with_troubles
from hexctl.control.trace import Trace, TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.control.walks.turning import check_plan
from hexctl.control.walks.velocity_walk import MotionWalk, VelocityWalk
from hexctl.errors import (
    CommandRefusedError,
    EStopError,
    InputError,
    SimulationDivergedError,
    check_callable,
    check_type,
)
from hexctl.robot.failure import NoticedFailure
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.waiting import StopRequested, never_stop

#: Ticks between two calls of `should_stop`.
LOOK_TICKS = 50

#: Allowed stop requests, for messages.
STOP_REQUESTED = "a function without arguments that says whether to stop"

#: Called every `LOOK_TICKS` with the trace so far; True or a reason ends the walk as `cut_short`.
ShouldStop = Callable[[Trace], bool | str]


@runtime_checkable
class EndCheck(Protocol):
    """A `should_stop` that also judges walks that have come to their end."""

    def __call__(self, trace: Trace) -> bool | str:
        """As any `should_stop`."""

    def at_end(self, trace: Trace) -> str | None:
        """Reason for which a walk that has come to its end is `cut_short`, or None."""


#: Called with the path so far, (T, 2); True ends the walk.
Enough = Callable[[FloatArray], bool]


def stop_when(enough: Enough | None) -> ShouldStop | None:
    """Early stopping by only the path; None for None."""
    return None if enough is None else lambda trace: enough(trace.path_m)


def planned_walk(start: WalkStart) -> Walk | VelocityWalk:
    """The walk of the plans: steered if they hold something, else open loop with constant motion."""
    plan = start.plans[0]
    hold = possible_hold(plan, start.frame)
    if plan.level and start.frame is None:
        raise InputError("level: got a robot without a pose; allowed: one that measures roll and pitch")
    if hold != "none":
        return SteeredWalk(start, hold=hold)
    if plan.changes or plan.level or plan.feet == "adaptive":
        return MotionWalk(start)
    gaits, motions, alone = [plan.gait for plan in start.plans], start.motions, start.batch_shape == ()
    return Walk(
        start.robot,
        gaits[0] if alone else gaits,
        motions[0] if alone else motions,
        period_s=start.period_s,
        held_legs=start.held_legs,
    )


def run_trial(
    servos: LegServos,
    plan: TrialPlan,
    controller: CustomController | None = None,
    recorders: Recorders | Sequence[Recorder | TickLog] = (),
    *,
    stop_requested: StopRequested = never_stop,
    should_stop: ShouldStop | None = None,
    soft_stop: bool = True,
) -> TrialResult:
    """Run a plan on connected servos and return the result.

    A fall, a latched stop, a diverged simulation or a requested stop is a status of the result. A stop that
    is requested from the start commands nothing: a limp robot stays limp. With a real-time clock this thread
    has real-time priority, if permitted.

    Args:
        servos: guarded, connected servos; a simulation may come without a guard.
        plan: the failures it knows may differ from those of a simulation.
        controller: walks instead of the plan's own walk; a controller, a factory of one for a `WalkStart`, or
            a function of step and state that returns 18 joint angles. Its `done` may end the walk.
        recorders: take the ticks in blocks; failures are warnings, or are kept by `Recorders`.
        stop_requested: called before and at every tick; True ends the trial as `aborted`.
        should_stop: called every `LOOK_TICKS` of the walk; an `EndCheck` at its end, too.
        soft_stop: False omits the stop after the walk, which is never scored.

    Raises, before anything moves, WrongTypeError for an argument of another type, InputError for a robot
    without a guard, ReachError or LimitError for a walk that the legs cannot make. Later InputError for a
    controller that returns other than 18 joint angles, RobotFaultError when the link fails.
    """
    check_type(servos, LegServos, "servos", "connected LegServos, as Guard(SimServos('ant')) gives")
    check_type(plan, TrialPlan, "plan", "a TrialPlan")
    check_callable(stop_requested, "stop_requested", STOP_REQUESTED)
    check_callable(should_stop, "should_stop", "a function of the trace that says whether to end, or None")
    if controller is None:
        controller = planned_walk
    check_controller(controller)
    check_plan(servos.robot, plan)
    kept = Recorders.of(recorders)
    guard = _guarded(servos)
    trial = _Trial(Phases(guard, kept), plan, controller, stop_requested, should_stop)
    guard.pause_watchdog()
    try:
        with realtime_priority() if guard.clock.waits else nullcontext():
            trial.run(soft_stop=soft_stop)
            sit_down(guard, stop_requested)
        # What follows takes time, and silence must not count as a failure.
        guard.pause_watchdog()
    finally:
        if kept is not None:
            kept.flush()
    if kept is not None and kept is not recorders:
        for failure in kept.failures:
            warnings.warn(f"{type(failure.recorder).__name__} failed: {failure.error}", stacklevel=2)
    return trial.result()


def _guarded(servos: LegServos) -> Guard:
    """The guard given, or a new one around a simulation.

    Raises InputError for other servos: a stop is latched in the guard, which must outlive the trial.
    """
    if isinstance(servos, Guard):
        return servos
    if servos.simulation is not None:
        return Guard(servos)
    raise InputError(
        f"servos: got {type(servos).__name__} without a guard; allowed: Guard(servos), one for all trials, "
        "as its stops stay latched; only a simulation needs none"
    )


class _Trial(TickObserver):
    """A trial in progress; the status is `ok` once the full duration was walked."""

    def __init__(
        self,
        phases: Phases,
        plan: TrialPlan,
        controller: CustomController,
        stop_requested: StopRequested,
        should_stop: ShouldStop | None,
    ) -> None:
        self.phases, self.servos, self.trace = phases, phases.servos, phases.trace
        self.plan, self.controller = plan, controller
        self.stop_requested, self.should_stop = stop_requested, should_stop
        self.true_frame: TrialFrame | None = None
        self.status = "aborted"
        self.stopped: str | None = None
        self.turned_rad, self.clipped_ticks, self.hold = 0.0, 0, "none"
        self.limited_ticks = 0
        self.noticed: tuple[NoticedFailure, ...] = ()
        self.requested = self.by_recovery = False
        self.samples, self.effort = WalkSamples(ticks_of(self.servos, plan.duration_s)), WalkEffort()

    def run(self, *, soft_stop: bool) -> None:
        try:
            # The first command would power up a limp robot.
            if not self.stop_requested():
                start = Preparation(self.phases, self.plan, self.stop_requested).run()
                self.turned_rad = start.turned_rad
                if not self.stop_requested():
                    self._walk(start, soft_stop=soft_stop)
        except EStopError:
            self.status = "fell" if self.servos.stopped == "fell" else "aborted"
        except CommandRefusedError as error:
            self.status, self.stopped = "aborted", str(error)
        except SimulationDivergedError:
            self.status = "diverged"
        if self.status == "aborted" and self.stopped is None:
            self.stopped = self.servos.stopped or "requested"

    def result(self) -> TrialResult:
        trace, plan = self.trace, self.plan
        rows, warnings = trace.rows("walk"), trace.warnings.texts
        stopped = self.stopped
        if stopped is not None and self.by_recovery:
            stopped = with_troubles(stopped, warnings, [one.failure.leg for one in self.noticed])
        return score(
            self.servos.robot,
            plan,
            status=self.status,
            stopped=stopped,
            duration_s=_span_s(trace.times_s[rows], self.servos.clock.period_s),
            turned_rad=self.turned_rad,
            clipped_ticks=self.clipped_ticks,
            hold=self.hold,
            limited_ticks=self.limited_ticks,
            frame=trace.frame,
            true_frame=self.true_frame,
            positions_world=trace.positions_world[rows],
            true_positions_world=trace.true_positions_world[rows],
            quaternions_world=trace.quaternions_world[rows],
            samples=self.samples.of(rows.stop - rows.start),
            energy_j=self.effort.energy_j(),
            noticed=self.noticed,
            warnings=warnings,
            controller=controller_name(self.controller),
        )

    def _walk(self, start: WalkStart, *, soft_stop: bool) -> None:
        """Walk for the plan's duration, or until a stop is due, and let the strides run out."""
        walk = made_controller(self.controller, start)
        self.hold = walk.hold
        self.trace.frame, self.true_frame = start.frame, start.true_frame
        self.phases.begin("walk")
        if self.servos.simulation is not None:
            self.servos.simulation.walk_begins()
        clipped_before = self.servos.counters.clipped
        try:
            step = self.phases.run(walk, until=self._until(), seen_by=(self,))
        finally:
            self.clipped_ticks = self.servos.counters.clipped - clipped_before
            self.limited_ticks = int(walk.limited_steps)
            self.noticed = walk.noticed_failures()
        why = walk.why_stopped()
        if self.status == "aborted" and why is not None:
            self.stopped, self.by_recovery = why, True
        elif self.status == "aborted" and not self.requested:
            self._complete()  # the controller itself has ended the walk
        if soft_stop:
            self._stop_softly(walk, step + 1)

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        """Measure a tick of the walk."""
        self.samples.add(state, sent.joint_positions_rad)
        self.effort.add(state, sent.joint_positions_rad)

    def _until(self) -> Until:
        """The condition that ends the walk before its controller does; sets the status."""
        last = ticks_of(self.servos, self.plan.duration_s) - 1
        looks = 0

        def over(step: int, _state: RobotState) -> bool:
            nonlocal looks
            if step >= last:
                self._complete()
            elif self.should_stop is not None and (step + 1) // LOOK_TICKS > looks:
                looks = (step + 1) // LOOK_TICKS
                answer = self.should_stop(self.trace)
                self.status = "cut_short" if answer else "aborted"
                self.stopped = (answer or None) if isinstance(answer, str) else None
            self.requested = self.status == "aborted" and self.stop_requested()
            return self.status != "aborted" or self.requested

        return over

    def _complete(self) -> None:
        """End the walk as `ok`, unless a check of its end has a reason against it."""
        ends = self.should_stop if isinstance(self.should_stop, EndCheck) else None
        self.stopped = None if ends is None else ends.at_end(self.trace)
        self.status = "ok" if self.stopped is None else "cut_short"

    def _stop_softly(self, walk: Controller, step: int) -> None:
        """Stop the robot softly from a step on; errors no longer change the result."""
        self.phases.begin("stop")
        with suppress(EStopError, CommandRefusedError, SimulationDivergedError):
            if steps := walk.stop(step):
                self.phases.run(_SoftStop(walk, step + steps - 1), first_step=step)
            else:
                steps = soft_stop_steps(self.servos.clock.period_s)
                self.phases.run(Stand(self.servos.robot, self.servos.accepted_rad(), steps))


class _SoftStop(Controller):
    def __init__(self, walk: Controller, last_step: int) -> None:
        self._walk, self._last_step = walk, last_step
        self.own_columns = walk.own_columns

    @property
    def own_values(self) -> Mapping[str, FloatArray]:  # type: ignore[override]  # of the walk
        return self._walk.own_values

    def news(self) -> Sequence[str]:
        return self._walk.news()

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        return self._walk.targets_rad(step, state)

    def done(self, step: int, state: RobotState) -> bool:
        self._walk.done(step, state)  # it may update itself there, as `Turn` does
        return step >= self._last_step


def _span_s(times_s: FloatArray, period_s: float) -> float:
    """The time that ticks span, including those that the clock skipped."""
    ticks = round((times_s[-1] - times_s[0]) / period_s) + 1 if times_s.size else 0
    return ticks * period_s
