"""A robot that stays connected between trials: preparation, cooling, and walks from its position."""

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace

from hexctl.adapt.arena import Arena, Geofence, aimed, facing_ahead
from hexctl.adapt.measurement import Operator, measured
from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.runner import (
    InterruptedTrialError,
    TrialRequest,
    TrialRunner,
    WalkedTrial,
    check_not_stopped,
)
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.setting import Note, Setting
from hexctl.backends.base import LegServos, check_stance, connection_notes
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.guard import Guard
from hexctl.control.sit_down import SittingMotion
from hexctl.control.telemetry_watch import SeenWarnings
from hexctl.control.trial import run_trial, stop_when
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.turning import turn_gait
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.failure import difference_note, drawn_failure
from hexctl.types import RobotState, joint_in_words
from hexctl.waiting import StopRequested, comes_true

#: How long a robot that has connected may take to tell its yaw.
YAW_COMES_S = 1.0

#: Ticks in which a robot must report its position and be upright.
READY_TICKS = 50

#: Servos that have not cooled down after this long never will.
COOLING_TIMEOUT_S = 3600.0

#: Interval of notes on the temperature to an operator.
COOLING_NOTE_S = 60.0

#: Attempts to reach a better start before the trial begins at the present position.
APPROACHES = 2

#: Time limit of a walk to a start, in multiples of its duration without slip.
APPROACH_TIMEOUT = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetFreeRunner:
    """Walks the gaits of one session on one connected robot, through one guard: a stop stays latched.

    `arena` limits its position; without `operator` the robot measures it.
    """

    runner: TrialRunner
    servos: Guard
    arena: Arena | None = None
    operator: Operator | None = None
    note: Note = lambda _text: None
    seen: SeenWarnings = field(default_factory=SeenWarnings)

    def walk(self, request: TrialRequest) -> WalkedTrial:
        """Run one trial from the robot's position; its new warnings are noted.

        Raises RobotStoppedError if the robot is stopped before the start, RobotFaultError for one that is
        lost or without a position, InterruptedTrialError if the operator ends instead.
        """
        walked = self._walk(request)
        for text in self.seen.take(walked.result.warnings):
            self.note(f"servos: {text}")
        return walked

    def _walk(self, request: TrialRequest) -> WalkedTrial:
        plan = self.runner.setting.plan_for(request.slots, request.trim, request.stride)
        if self.runner.spec.cool_down_c is not None:
            cool_down(self.servos, self.runner.spec.cool_down_c, self.runner.stop_requested, self.note)
        if self.operator is not None:
            return self._walk_and_ask(self.operator, request, facing_ahead(plan, self.runner.setting.robot))
        if self.arena is not None:
            return self._walk_inside(self.arena, request, plan)
        await_ready(self.servos)
        return self.runner.walk_on(self.servos, plan, request, stop_when(request.should_stop))

    def _walk_and_ask(self, operator: Operator, request: TrialRequest, plan: TrialPlan) -> WalkedTrial:
        robot, again = self.runner.setting.robot, False

        def completed(result: TrialResult) -> TrialResult:
            nonlocal again
            if result.status not in ("ok", "no_progress"):
                return result
            answer = operator.measure(request.index, at_most_m=2 * result.ideal_distance_m)
            again = answer.word == "again"
            return measured(result, answer, robot, plan)

        check_not_stopped(self.servos)
        if not operator.place(request.index, request.code):
            raise InterruptedTrialError
        await_ready(self.servos, needs_pose=False)
        walked = self.runner.walk_on(self.servos, plan, request, completed=completed)
        return self._walk_and_ask(operator, request, plan) if again else walked

    def _walk_inside(self, arena: Arena, request: TrialRequest, plan: TrialPlan) -> WalkedTrial:
        self._come_to_start(arena)
        state = await_ready(self.servos)
        here = aimed(plan, self.runner.setting.robot, state, arena)
        fence = Geofence(arena, stop_when(request.should_stop))
        return self.runner.walk_on(self.servos, here, request, fence)

    def _come_to_start(self, arena: Arena) -> None:
        """Walk away from the middle, with the gait of self-rotations, until there is room."""
        robot = self.runner.setting.robot
        plan = self.runner.setting.plan_for(turn_gait(robot).slots, None, None)
        speed_m_s = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
        reach_m = speed_m_s * plan.duration_s
        start = arena.start(reach_m)
        for _ in range(APPROACHES):
            state = await_ready(self.servos)
            position = state.base_position_world
            if position is None or not arena.too_near(position, reach_m):
                return
            missing_m = start.radius_m - start.distance_m(position)
            timeout_s = APPROACH_TIMEOUT * (RAMP_DURATION_S + missing_m / speed_m_s)
            there = replace(aimed(plan, robot, state, arena, outward=True), duration_s=timeout_s)
            result = run_trial(
                self.servos,
                there,
                stop_requested=self.runner.stop_requested,
                should_stop=Geofence(start),
            )
            check_not_stopped(self.servos)  # the gait of the trial is not at fault: nothing is stored
            if result.status == "aborted":
                raise InterruptedTrialError


def cool_down(servos: Guard, below_c: float, stop_requested: StopRequested, note: Note) -> None:
    """Sit down and wait until all servos are cooler, in degrees Celsius, unless they are.

    Raises InputError for servos without temperatures, RobotFaultError if they stay hot.
    """
    hottest_c, hottest = _hottest(servos.peek())
    if hottest_c < below_c:
        return
    note(f"cooling down below {below_c:g} C: {hottest}")
    _sit_down(servos, stop_requested)
    began_s = noted_s = servos.clock.now_s
    while hottest_c >= below_c and not stop_requested():
        servos.clock.tick()
        hottest_c, hottest = _hottest(servos.read())
        check_not_stopped(servos)
        if servos.clock.now_s - noted_s > COOLING_NOTE_S:
            noted_s = servos.clock.now_s
            note(f"still cooling down: {hottest}")
        if servos.clock.now_s - began_s > COOLING_TIMEOUT_S:
            minutes = COOLING_TIMEOUT_S / 60
            raise RobotFaultError(f"not below {below_c:g} C after {minutes:g} min: {hottest}")


def _sit_down(servos: Guard, stop_requested: StopRequested) -> None:
    """Sit down softly and go limp, if possible; a robot stopped meanwhile holds."""
    check_not_stopped(servos)
    motion, sits = SittingMotion(servos, servos.clock.tick().time_s), False
    while not sits and not stop_requested():
        servos.read()
        check_not_stopped(servos)
        sits = motion.step(servos.clock.now_s)
        servos.clock.tick()
    servos.pause_watchdog()
    if sits:  # limp legs would drop a body that is still up
        servos.disable_torque()


def _hottest(state: RobotState) -> tuple[float, str]:
    """Temperature of the hottest joint in degrees Celsius, and in words; raises InputError without one."""
    readings = state.servos
    if readings is None or (joint := readings.hottest_joint) is None:
        raise InputError(
            f"{argument('cool_down_c')}: used with a robot that measures no temperatures; allowed: with "
            "servos on a bus, here or behind hexctl serve"
        )
    hottest_c = float(readings.temperatures_c[joint])
    return hottest_c, f"{joint_in_words(joint)} {hottest_c:.0f} C"


def await_ready(servos: Guard, *, needs_pose: bool = True) -> RobotState:
    """State of a robot once it is upright and, if needed, knows its position.

    Raises RobotStoppedError for one that is stopped, RobotFaultError for one without a pose.
    """
    servos.pause_watchdog()
    check_not_stopped(servos)
    # It may have been carried, or sat down: it starts from its present joint angles.
    servos.clear()
    for _ in range(READY_TICKS):
        servos.clock.tick()
        state = servos.read()
        check_not_stopped(servos)
        if servos.leaning_ticks == 0 and (state.base_position_world is not None or not needs_pose):
            return state
    raise RobotFaultError(
        "the robot knows no position, so a trial cannot be scored; use one with odometry or motion capture, "
        f"or measure by hand with {argument('ask')}"
    )


def at_home(spec: SessionSpec, servos: Guard | None) -> SessionSpec:
    """Spec of a session that begins at the robot's position, unless its arena has a home.

    Raises RobotStoppedError for a stopped robot, RobotFaultError for one without a required position,
    InputError for one without the joint torques that the objective needs.
    """
    if servos is None or spec.ask:
        return spec
    state = await_ready(servos)
    objective = OBJECTIVES.get(spec.objective)
    total_nm = math.nan if state.joint_torques_nm is None else state.joint_torques_nm.sum()
    if objective is not None and objective.needs_torques and not math.isfinite(total_nm):
        usable = [name for name, shipped in OBJECTIVES.items() if not shipped.needs_torques]
        raise InputError(
            f"{argument('objective')}: got {spec.objective} with a robot that does not tell its joint "
            f"torques; allowed: {', '.join(usable)}"
        )
    position = state.base_position_world
    if spec.arena_m is None or spec.home_m is not None or position is None:
        return spec
    return replace(spec, home_m=[float(position[0]), float(position[1])])


def yaw_note(spec: SessionSpec, servos: Guard | None) -> str | None:
    """Note that walks cannot hold their heading without a measured yaw, or None; RobotFaultError if lost."""
    wanted = spec.hold == "heading" or (spec.hold == "auto" and spec.ask)
    if servos is None or not wanted:
        return None
    if comes_true(lambda: servos.peek().base_quaternion_world is not None, YAW_COMES_S):
        return None
    said = "this robot reports no yaw, so its walks cannot hold their heading"
    instead = "; --hold none learns a turn from its paths"
    return said + (instead if spec.optimizer == TRIM else "")


def arena_of(spec: SessionSpec) -> Arena | None:
    """Arena of a session, if it has one."""
    if spec.arena_m is None or spec.home_m is None:
        return None
    return Arena(home_m=(spec.home_m[0], spec.home_m[1]), radius_m=spec.arena_m)


@contextmanager
def connected_robot(
    spec: SessionSpec, setting: Setting, given: LegServos | None, note: Note
) -> Iterator[Guard | None]:
    """Keep the robot of a session connected; None if each trial has its own simulation.

    `given` is the robot, if it is not made by `spec.backend`. Raises RobotFaultError if it cannot be reached.
    """
    if spec.simulated:
        text = difference_note(drawn_failure(setting.robot, spec.broken, spec.seed), spec.broken)
        if text is not None:
            note(text)
        yield None
        return
    options = BackendOptions.of(
        spec, robot=setting.robot, world=None, failures=(spec.broken,), robot_file=setting.robot_file
    )
    robot = make_servos(spec.backend, options) if given is None else given
    check_stance(robot)
    servos = Guard(robot)
    try:
        servos.connect()
        for text in connection_notes(robot, setting.plan.failures):
            note(text)
        yield servos
    finally:
        # The result comes after the robot is released: a link that fails at that must not cost it.
        with suppress(RobotFaultError):
            servos.close()
