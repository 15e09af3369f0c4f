"""Trials on a robot that stays where its last walk ended, as every real one does."""

from dataclasses import dataclass, replace
from pathlib import Path

from hexctl.adapt.aiming import aimed, as_placed
from hexctl.adapt.arena import Arena
from hexctl.adapt.fence import LEFT_THE_ARENA, Fence
from hexctl.adapt.measuring import Operator, measured, not_walked
from hexctl.adapt.stops import check_not_stopped
from hexctl.adapt.walker import Walker
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult
from hexctl.control.trial import Enough, run_trial
from hexctl.control.turning import turn_gait
from hexctl.errors import RobotFaultError
from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.types import RobotState

#: Ticks that a robot has to say where it is and to be upright.
PATIENCE_TICKS = 50

#: How often the robot tries to get to a better start before it begins where it is.
APPROACHES = 2

#: A walk to a start may take so many times as long as it would without loss.
APPROACH_PATIENCE = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class StayingWalker:
    """Walks the gaits of one session on one connected robot, through one guard: a stop stays latched.

    Attributes:
        walker: makes plans and recordings.
        servos: the robot, connected.
        arena: where it is kept, or None to let it wander.
        operator: who puts it down and measures, or None where the robot knows where it is.
    """

    walker: Walker
    servos: Guard
    arena: Arena | None = None
    operator: Operator | None = None

    def walk(
        self, index: int, code: int, slots: Slots, enough: Enough | None = None
    ) -> tuple[TrialResult, Path | None]:
        """Run one trial from where the robot is and return its result and recording.

        Raises RobotStoppedError for a robot that is stopped before it begins, RobotFaultError for one that
        does not know where it is or has gone.
        """
        plan = self.walker.plan_for(slots)
        if self.operator is not None:
            return self._walk_and_ask(self.operator, index, code, as_placed(plan, self.walker.robot))
        if self.arena is not None:
            return self._walk_inside(self.arena, index, code, plan, enough)
        await_ready(self.servos)
        return self.walker.walk_on(self.servos, plan, index, code, lambda _: enough)

    def _walk_and_ask(
        self, operator: Operator, index: int, code: int, plan: TrialPlan
    ) -> tuple[TrialResult, Path | None]:
        """Walk a gait that a person measures, as often as that person likes."""
        robot, again = self.walker.robot, False

        def completed(result: TrialResult) -> TrialResult:
            nonlocal again
            if result.status not in ("ok", "no_progress"):
                return result
            answer = operator.measure(index, at_most_m=2 * result.ideal_distance_m)
            again = answer.word == "again"
            return measured(result, answer, robot, plan)

        check_not_stopped(self.servos)
        if not operator.place(index, code):
            return not_walked(robot, plan), None
        await_ready(self.servos, needs_pose=False)
        walked = self.walker.walk_on(self.servos, plan, index, code, lambda _: None, completed)
        return self._walk_and_ask(operator, index, code, plan) if again else walked

    def _walk_inside(
        self, arena: Arena, index: int, code: int, plan: TrialPlan, enough: Enough | None
    ) -> tuple[TrialResult, Path | None]:
        """Walk through the middle of the arena, from a better start if need be, and end at its edge."""
        hindered = self._come_to_start(arena)
        if hindered is not None:
            return hindered, None
        fences: list[Fence] = []

        def enough_of(log: TickLog) -> Enough:
            fences.append(Fence(arena, log, enough))
            return fences[-1]

        def completed(result: TrialResult) -> TrialResult:
            at_edge = result.status == "cut_short" and fences[-1].reached
            return replace(result, stopped=LEFT_THE_ARENA) if at_edge else result

        state = await_ready(self.servos)
        here = aimed(plan, self.walker.robot, state, arena)
        return self.walker.walk_on(self.servos, here, index, code, enough_of, completed)

    def _come_to_start(self, arena: Arena) -> TrialResult | None:
        """Walk away from the middle while a walk has no room; return what stopped the robot there, if any.

        It walks with the gait of self-rotations, not with one that nobody knows.
        """
        robot = self.walker.robot
        plan = self.walker.plan_for(turn_gait(robot).slots)
        speed_m_s = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
        reach_m = speed_m_s * plan.duration_s
        start = arena.start(reach_m)
        for _ in range(APPROACHES):
            state = await_ready(self.servos)
            position = state.base_position_world
            if position is None or not arena.too_near(position, reach_m):
                return None
            missing_m = start.radius_m - start.distance_m(position)
            patience_s = APPROACH_PATIENCE * (RAMP_DURATION_S + missing_m / speed_m_s)
            there = replace(aimed(plan, robot, state, arena, outward=True), duration_s=patience_s)
            log, stop = TickLog(), self.walker.stop_requested
            result = run_trial(self.servos, there, log, stop_requested=stop, enough=Fence(start, log))
            if result.status == "fell":
                # No fault of the gait that is due: nothing to be kept.
                return replace(result, status="aborted", stopped="fell")
            if result.status == "aborted":
                return result
        return None


def await_ready(servos: Guard, *, needs_pose: bool = True) -> RobotState:
    """Return the state of a robot that is upright and, if it must, says where it is.

    Raises RobotStoppedError for one that is stopped, RobotFaultError for one that never says where it is:
    without a pose there is nothing to score.
    """
    servos.rest()
    check_not_stopped(servos)
    # It may have been carried, or sat down: it begins from where its joints are, not from the last command.
    servos.clear()
    for _ in range(PATIENCE_TICKS):
        servos.clock.tick()
        state = servos.read()
        check_not_stopped(servos)
        if servos.leaning_ticks == 0 and (state.base_position_world is not None or not needs_pose):
            return state
    raise RobotFaultError(
        "the robot knows no position, so a trial cannot be scored; use one with odometry or motion capture, "
        "or measure by hand with --ask"
    )
