"""One trial on any robot: settle, self-rotation, walk, stop; and its result."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.control.controllers import Stand, Walk
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.loop import drive
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult, score
from hexctl.control.trace import TrialFrame
from hexctl.control.turning import CLOSE_ENOUGH_RAD, Turn, check_plan, turn_needed_rad
from hexctl.errors import CommandRefusedError, EStopError, InputError, SimulationDivergedError
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import FloatArray, RobotState

#: Rest between the self-rotation and the walk.
PAUSE_S = 0.5


@dataclass(frozen=True, slots=True)
class StartLine:
    """The robot stands ready to walk.

    Attributes:
        turned_rad: how far the body has turned since the trial began.
        frame: the trial frame, or None where the robot knows no pose.
    """

    turned_rad: float
    frame: TrialFrame | None


StopRequested = Callable[[], bool]

#: Is asked now and then with the walk's path so far, (T, 2), and says whether it has shown enough.
Enough = Callable[[FloatArray], bool]

#: Every so many ticks a walk that may end early is looked at.
LOOK_TICKS = 50


def never() -> bool:
    """Return False: nobody asks for a stop."""
    return False


@dataclass(slots=True)
class _Walked:
    """How the walk went so far.

    Attributes:
        status: `ok` once the whole duration was walked.
        stopped: why it was aborted, if it was.
        turned_rad: how far the self-rotation turned.
        clipped_ticks: ticks in which the guard changed the targets.
    """

    status: str = "aborted"
    stopped: str | None = None
    turned_rad: float = 0.0
    clipped_ticks: int = 0


def run_trial(
    servos: Guard,
    plan: TrialPlan,
    log: TickLog | None = None,
    *,
    stop_requested: StopRequested = never,
    enough: Enough | None = None,
    soft_stop: bool = True,
) -> TrialResult:
    """Run a plan on connected servos, keep every tick in the log if there is one, and return the result.

    A fall, a latched stop, a diverged simulation or a requested stop is a status of the result; so is
    `cut_short`, when `enough` ends the walk.
    `soft_stop=False` leaves out the stop after the walk, which is never scored.

    Raises InputError when a simulated robot has another failure than the plan, ReachError or LimitError for a
    walk that the legs cannot make, all before anything moves; and RobotFaultError when the robot has gone.
    """
    log = TickLog() if log is None else log
    check_same_failure(servos, plan)
    check_plan(servos.robot, plan)
    servos.rest()
    try:
        walked = _attempt(servos, plan, log, stop_requested, enough, soft_stop)
    finally:
        log.flush()
    # What comes now takes its time, and silence must not be taken for a failure.
    servos.rest()
    rows = log.rows_of("walk")
    return score(
        servos.robot,
        plan,
        status=walked.status,
        stopped=walked.stopped,
        duration_s=_walked_s(log, rows, servos.clock.period_s),
        turned_rad=walked.turned_rad,
        clipped_ticks=walked.clipped_ticks,
        frame=log.frame,
        positions_world=log["base_position_world"][rows],
        quaternions_world=log["base_quaternion_world"][rows],
    )


def _attempt(
    servos: Guard,
    plan: TrialPlan,
    log: TickLog,
    stop_requested: StopRequested,
    enough: Enough | None,
    soft_stop: bool,
) -> _Walked:
    """Settle, turn, walk and stop, and return how far that went and why no further."""
    walked = _Walked()
    try:
        start = prepare(servos, plan, log, stop_requested)
        walked.turned_rad = start.turned_rad
        if not stop_requested():
            _walk(servos, plan, start, log, stop_requested, enough, walked, soft_stop)
    except EStopError:
        walked.status = "fell" if servos.stopped == "fell" else "aborted"
    except CommandRefusedError as error:
        walked.status, walked.stopped = "aborted", str(error)
    except SimulationDivergedError:
        walked.status = "diverged"
    if walked.status == "aborted" and walked.stopped is None:
        walked.stopped = servos.stopped or "requested"
    return walked


def check_same_failure(servos: LegServos, plan: TrialPlan) -> None:
    """Raise InputError when a simulation injects another failure than the plan names."""
    if servos.injects_failure and servos.failure != plan.failure:
        raise InputError(
            f"plan: got failure {plan.failure!r} on a simulation with {servos.failure!r}; "
            "allowed: the same, as in SimServos(robot, failure=plan.failure)"
        )


def prepare(servos: Guard, plan: TrialPlan, log: TickLog, stop_requested: StopRequested = never) -> StartLine:
    """Settle in the stance and turn the failed leg away; return the robot at the start of its walk.

    Position and yaw are the means over the rest before the walk, so that noise of the sensors does not bend
    the line of travel. Raises what `drive` raises.
    """
    log.phase = "settle"
    _stand(servos, plan.settle_s, log)
    if not log.pose_known or stop_requested():
        return StartLine(0.0, None)
    position, first_yaw_rad = _resting_pose(log, servos, plan.settle_s)
    yaw = first_yaw_rad
    turn_rad = turn_needed_rad(servos.robot, plan)
    if abs(turn_rad) > CLOSE_ENOUGH_RAD:
        log.phase = "turn"
        turn = Turn(servos.robot, plan, turn_rad, first_yaw_rad, servos.clock.period_s, stop_requested)
        drive(servos, turn.controller, log, turn.until)
        _stand(servos, PAUSE_S, log)
        position, yaw = _resting_pose(log, servos, PAUSE_S)
    frame = TrialFrame(position, first_yaw_rad + plan.heading_rad, yaw)
    return StartLine(wrapped_rad(yaw - first_yaw_rad), frame)


def ticks_of(servos: Guard, duration_s: float) -> int:
    """Return a duration in whole control periods, at least one."""
    return max(1, math.ceil(duration_s / servos.clock.period_s - 1e-9))


def _stand(servos: Guard, duration_s: float, log: TickLog) -> None:
    """Come to the stance in the first half of a duration and rest in it for the second."""
    ticks = ticks_of(servos, duration_s)
    stand = Stand(servos.robot, servos.accepted_rad(), ticks // 2)
    drive(servos, stand, log, lambda step, _: step >= ticks - 1)


def _resting_pose(log: TickLog, servos: Guard, duration_s: float) -> tuple[FloatArray, float]:
    """Return mean position (3,) and mean yaw of the resting half of a stand that has just ended."""
    rest = slice(max(0, len(log) - ticks_of(servos, duration_s) // 2 - 1), len(log))
    positions, quaternions = log["base_position_world"][rest], log["base_quaternion_world"][rest]
    known = np.isfinite(positions[:, 0])
    yaws = yaw_rad(quaternions[known])
    yaw = float(yaws[-1]) + float(np.mean([wrapped_rad(value - yaws[-1]) for value in yaws.tolist()]))
    return positions[known].mean(axis=0), yaw


def _walk(
    servos: Guard,
    plan: TrialPlan,
    start: StartLine,
    log: TickLog,
    stop_requested: StopRequested,
    enough: Enough | None,
    walked: _Walked,
    soft_stop: bool,
) -> None:
    """Walk for the plan's duration, or until a stop or no more is wanted, and let the strides run out."""
    last = ticks_of(servos, plan.duration_s) - 1
    motion = plan.motion(start.turned_rad)
    period_s = servos.clock.period_s
    walk = Walk(servos.robot, plan.gait, motion, period_s=period_s, held_legs=plan.held_legs)
    log.phase, log.frame = "walk", start.frame
    clipped_before = servos.counters.clipped
    looks = 0

    def over(step: int, _state: RobotState) -> bool:
        nonlocal looks
        if step >= last:
            walked.status = "ok"
        elif enough is not None and (step + 1) // LOOK_TICKS > looks:
            looks = (step + 1) // LOOK_TICKS
            walked.status = "cut_short" if enough(_path_so_far(log)) else "aborted"
        return walked.status != "aborted" or stop_requested()

    try:
        step, _ = drive(servos, walk, log, over)
    finally:
        walked.clipped_ticks = servos.counters.clipped - clipped_before
    if soft_stop:
        _stop_softly(servos, walk, log, step + 1)


def _path_so_far(log: TickLog) -> FloatArray:
    """Return progress and deviation at each tick of the walk that the log is in, (T, 2)."""
    positions = log["base_position_world"][log.rows_of("walk")]
    return np.zeros((0, 2)) if log.frame is None else log.frame.path(positions)


def _stop_softly(servos: Guard, walk: Walk, log: TickLog, step: int) -> None:
    """Let the strides run out from a step on; what goes wrong now no longer changes the walk."""
    log.phase = "stop"
    walk.stop(step)
    end = step + walk.stopping_ticks - 1
    with suppress(EStopError, CommandRefusedError, SimulationDivergedError):
        drive(servos, walk, log, lambda step, _: step >= end, first_step=step)


def _walked_s(log: TickLog, rows: slice, period_s: float) -> float:
    """Return the time that the rows of the walk span, points that the clock skipped included."""
    times = log["time_s"][rows]
    ticks = round((times[-1] - times[0]) / period_s) + 1 if times.size else 0
    return ticks * period_s
