"""One trial on any robot: settle, self-rotation, walk, stop; and its result."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from hexctl.control.controller import Stand, Walk, check_walk
from hexctl.control.frame import TrialFrame
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.loop import drive
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult, score
from hexctl.control.turning import CLOSE_ENOUGH_RAD, Turn, turn_needed_rad
from hexctl.errors import EStopError, RobotFaultError, SimulationDivergedError
from hexctl.robot.messages import RobotState
from hexctl.robot.rotation import yaw_rad

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


def never() -> bool:
    """Return False: nobody asks for a stop."""
    return False


def run_trial(
    servos: Guard,
    plan: TrialPlan,
    log: TickLog | None = None,
    *,
    stop_requested: StopRequested = never,
    soft_stop: bool = True,
) -> TrialResult:
    """Run a plan on connected servos, keep every tick in the log if there is one, and return the result.

    A fall, a latched stop, a diverged simulation or a requested stop is a status of the result. Other faults
    of the robot are raised. `soft_stop=False` leaves out the stop after the walk, which is never scored.
    """
    log = TickLog() if log is None else log
    status = "ok"
    try:
        start = prepare(servos, plan, log, stop_requested)
        if not stop_requested():
            _walk(servos, plan, start, log, stop_requested, soft_stop)
        if stop_requested():
            status = "aborted"
    except EStopError:
        status = "fell" if servos.stopped == "fell" else "aborted"
    except SimulationDivergedError:
        status = "diverged"
    finally:
        log.flush()
    rows = log.rows_of("walk")
    return score(
        servos.robot,
        plan,
        status=status,
        duration_s=_walked_s(log, rows, servos.clock.period_s),
        clipped_ticks=int((log["wanted_rad"][rows] != log["sent_rad"][rows]).any(axis=-1).sum()),
        frame=log.frame if log.pose_known else None,
        positions_world=log["base_position_world"][rows],
        quaternions_world=log["base_quaternion_world"][rows],
    )


def prepare(servos: Guard, plan: TrialPlan, log: TickLog, stop_requested: StopRequested = never) -> StartLine:
    """Settle in the stance and turn the failed leg away; return the robot at the start of its walk.

    Raises ReachError or LimitError for a walk that the legs cannot make, before anything moves.
    """
    check_walk(servos.robot, plan.gait, plan.motion(0.0))
    log.phase = "settle"
    state = _stand(servos, plan.settle_s, log)
    if state.base_position_world is None or state.base_quaternion_world is None:
        return StartLine(0.0, None)
    first_yaw_rad = float(yaw_rad(state.base_quaternion_world))
    turn_rad = turn_needed_rad(servos.robot, plan)
    if abs(turn_rad) > CLOSE_ENOUGH_RAD:
        log.phase = "turn"
        turn = Turn(servos.robot, plan, turn_rad, first_yaw_rad, servos.clock.period_s, stop_requested)
        drive(servos, turn.controller, log, turn.until)
        state = _stand(servos, PAUSE_S, log)
    if state.base_position_world is None or state.base_quaternion_world is None:
        raise RobotFaultError("the robot lost its pose while it turned; check what measures it and run again")
    yaw = float(yaw_rad(state.base_quaternion_world))
    frame = TrialFrame(state.base_position_world, first_yaw_rad + plan.heading_rad, yaw)
    return StartLine(yaw - first_yaw_rad, frame)


def ticks_of(servos: Guard, duration_s: float) -> int:
    """Return a duration in whole control periods, at least one."""
    return max(1, math.ceil(duration_s / servos.clock.period_s - 1e-9))


def _stand(servos: Guard, duration_s: float, log: TickLog) -> RobotState:
    """Come to the stance in the first half of a duration and rest in it for the second."""
    ticks = ticks_of(servos, duration_s)
    stand = Stand(servos.robot, servos.accepted_rad, ticks // 2)
    _, state = drive(servos, stand, log, lambda step, _: step >= ticks - 1)
    return state


def _walk(
    servos: Guard,
    plan: TrialPlan,
    start: StartLine,
    log: TickLog,
    stop_requested: StopRequested,
    soft_stop: bool,
) -> None:
    """Walk for the plan's duration, or until a stop is requested, and let the strides run out."""
    last = ticks_of(servos, plan.duration_s) - 1
    motion = plan.motion(start.turned_rad)
    period_s = servos.clock.period_s
    walk = Walk(servos.robot, plan.gait, motion, period_s=period_s, held_legs=plan.held_legs)
    log.phase, log.frame = "walk", start.frame
    step, _ = drive(servos, walk, log, lambda step, _: step >= last or stop_requested())
    if soft_stop:
        log.phase = "stop"
        walk.stop(step + 1)
        end = step + walk.stopping_ticks
        drive(servos, walk, log, lambda step, _: step >= end, first_step=step + 1)


def _walked_s(log: TickLog, rows: slice, period_s: float) -> float:
    """Return the time that the rows of the walk span, points that the clock skipped included."""
    times = log["time_s"][rows]
    ticks = round((times[-1] - times[0]) / period_s) + 1 if times.size else 0
    return ticks * period_s
