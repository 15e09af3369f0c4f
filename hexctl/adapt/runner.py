"""Runners of single trials: each in its own simulation, or reset-free on one connected robot."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hexctl.adapt.arena import LEFT_THE_ARENA, Arena, Geofence, aimed, as_placed
from hexctl.adapt.measurement import Operator, measured, not_walked
from hexctl.adapt.objectives import OBJECTIVES
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.session import BASELINE_INDEX, UNWATCHED, SessionSpec
from hexctl.adapt.setting import Note, Setting
from hexctl.backends.base import LegServos, connection_notes
from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World
from hexctl.control.controllers import Controller
from hexctl.control.guard import Guard
from hexctl.control.log import BLOCK_TICKS, PACED_BLOCK_TICKS, Recorders
from hexctl.control.monitor.monitored_walk import watched_walk
from hexctl.control.monitor.recovery import make_policy
from hexctl.control.plan import TrialPlan
from hexctl.control.preparation import StopRequested, WalkStart, never
from hexctl.control.result import TrialResult
from hexctl.control.trial import Enough, ShouldStop, planned_walk, run_trial, stop_when
from hexctl.control.turning import turn_gait
from hexctl.errors import HexctlError, InputError, RobotFaultError, argument
from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import AUTO, NAMED_SLOTS, ideal_speed_m_s
from hexctl.record.live import LiveView
from hexctl.record.recording import Recording
from hexctl.robot.failure import drawn_failure, untold_note
from hexctl.robot.failure_event import NoticedFailure, in_words
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot
from hexctl.types import RobotState
from hexctl.waiting import comes_true


class NotBegunError(HexctlError, RuntimeError):
    """A stop was requested before there was a session."""


def check_not_interrupted(stop_requested: StopRequested) -> None:
    """Raise NotBegunError where a stop was requested before there is a session."""
    if stop_requested():
        raise NotBegunError("interrupted before a session began: nothing was recorded, begin again")


class RobotStoppedError(RobotFaultError):
    """The guard, the robot's or this end's, has latched a stop; the session can be resumed after it.

    Attributes:
        reason: what the guard says.
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class LegFailedError(RobotStoppedError):
    """A leg failed during a trial of which nothing was told; the trial does not count.

    Attributes:
        legs: those that are noticed to have failed, ascending.
    """

    def __init__(self, message: str, reason: str, legs: tuple[int, ...]) -> None:
        super().__init__(message, reason)
        self.legs = legs


def check_not_stopped(servos: Guard) -> None:
    """Raise RobotStoppedError for a robot that must not move before an operator has seen to it."""
    if servos.stopped is not None:
        raise RobotStoppedError(f"the robot is stopped: {servos.stopped}", servos.stopped)


#: Adds to a result before it is recorded.
Completed = Callable[[TrialResult], TrialResult]


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkedTrial:
    """A trial that was walked.

    Attributes:
        result: its outcome.
        recording: the file of its recording, or None.
        recording_error: why the recording is not whole, or None.
    """

    result: TrialResult
    recording: Path | None = None
    recording_error: Exception | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialRunner:
    """Walks the gaits of one session in simulation, each from the same start.

    Attributes:
        spec: of the session.
        robot: the robot that walks.
        world: the simulated world, None on a real robot.
        plan_for: the trial plan for slots.
        folder: where recordings go, or None to leave none.
        stop_requested: asked every tick.
        live: shows the walks while they run, or None.
        meshes: what the robot looks like in recordings.
    """

    spec: SessionSpec
    robot: Robot
    world: World | None
    plan_for: Callable[[Slots], TrialPlan]
    folder: Path | None
    stop_requested: StopRequested = never
    live: LiveView | None = None
    meshes: Meshes = field(default_factory=dict)

    def walk(self, index: int, code: int, slots: Slots, should_stop: Enough | None = None) -> WalkedTrial:
        """Run one trial in a simulation of its own."""
        plan = self.plan_for(slots)
        # What the simulation breaks; the plan has what the controller is told.
        broken = self.spec.broken
        options = BackendOptions.of(
            self.spec, robot=self.robot, world=self.world, failure=broken, trial=index
        )
        with Guard(make_servos(self.spec.backend, options)) as servos:
            return self.walk_on(servos, plan, index, code, stop_when(should_stop))

    def walk_on(
        self,
        servos: Guard,
        plan: TrialPlan,
        index: int,
        code: int,
        should_stop: ShouldStop | None = None,
        completed: Completed = lambda result: result,
    ) -> WalkedTrial:
        """Run one trial on connected servos; `completed` adds to the result before it is recorded.

        A recording that fails costs neither the walk nor its result.
        """
        recording = self._open_recording(index, code, plan)
        try:
            recorders = self._recorders(recording, plan, title_of(index, code, plan))
            result = run_trial(
                servos,
                plan,
                self._made_walk(),
                recorders=recorders,
                stop_requested=self.stop_requested,
                should_stop=should_stop,
            )
            result = without_count(completed(result))
            if recording is None:
                return WalkedTrial(result=result)
            trouble = recorders.error_of(recording) or _finished(recording, result, self._facts(index, code))
            return WalkedTrial(result=result, recording=recording.path, recording_error=trouble)
        finally:
            if recording is not None:
                recording.close()

    @property
    def _watched(self) -> bool:
        """Whether the legs of a trial are watched."""
        return self.spec.policy != UNWATCHED

    def _made_walk(self) -> Callable[[WalkStart], Controller]:
        """What makes the walk of a trial: as planned, or watching its legs."""
        if not self._watched:
            return planned_walk
        return watched_walk(make_policy(self.spec.policy))

    def _recorders(self, recording: Recording | None, plan: TrialPlan, title: str) -> Recorders:
        """The recording, the live view, both or neither."""
        if self.live is not None:
            self.live.begin(self.robot, plan, title=title, looks=self.spec.robot, watched=self._watched)
        given = [recorder for recorder in (recording, self.live) if recorder is not None]
        return Recorders(*given, block_ticks=BLOCK_TICKS if self.spec.simulated else PACED_BLOCK_TICKS)

    def _open_recording(self, index: int, code: int, plan: TrialPlan) -> Recording | None:
        if self.folder is None:
            return None
        floor = make_floor(self.world, self.spec.seed) if self.world is not None else None
        stem = f"trial-{index:03d}" if index != BASELINE_INDEX else f"baseline-{_name_of(plan)}"
        path, title = _new_path(self.folder, stem), title_of(index, code, plan)
        return Recording(
            path, self.robot, plan, title=title, floor=floor, meshes=self.meshes, watched=self._watched
        )

    def _facts(self, index: int, code: int) -> dict[str, Any]:
        spec = self.spec
        return {
            "trial": index,
            "code": code,
            "optimizer": spec.optimizer,
            "backend": spec.backend,
            "world": spec.world,
            "seed": spec.seed,
        }


def without_count(result: TrialResult) -> TrialResult:
    """A result that does not count where another leg failed meanwhile and is not whole again."""
    failed = noticed_legs(result)
    if not failed or (result.status == "aborted" and result.stopped == "requested"):
        return result
    words = (
        f"leg {one.failure.leg} {in_words(one.failure)}, noticed {one.at_s:.1f} s into it" for one in failed
    )
    return replace(result, status="aborted", stopped=", ".join(words))


def noticed_legs(result: TrialResult) -> list[NoticedFailure]:
    """Failures that were noticed during a walk, of legs that are not whole again, by leg."""
    last = {one.failure.leg: one for one in result.noticed}
    return [last[leg] for leg in sorted(last) if not last[leg].healed]


def _finished(recording: Recording, result: TrialResult, facts: dict[str, Any]) -> Exception | None:
    """Finish a recording; returns what went wrong, or None."""
    try:
        recording.finish(result, facts)
    except Exception as error:  # noqa: BLE001  the walk is done, whether or not its recording is whole
        return error
    return None


def title_of(index: int, code: int, plan: TrialPlan) -> str:
    """Title of a trial, or of a walk with a gait that the robot would use anyway."""
    return f"baseline: gait {_name_of(plan)}" if index == BASELINE_INDEX else f"trial {index}: gait {code}"


def _name_of(plan: TrialPlan) -> str:
    """Name of a plan's gait in a baseline, where the one without a name of its own is `auto`."""
    slots = tuple(plan.gait.slots)
    named = (name for name, own in NAMED_SLOTS.items() if own == slots)
    return next(named, AUTO)


def _new_path(folder: Path, stem: str) -> Path:
    """Path that no recording has; a trial that was cut off keeps its own."""
    folder.mkdir(parents=True, exist_ok=True)
    path, number = folder / f"{stem}.rrd", 2
    while path.exists():
        path, number = folder / f"{stem}-{number}.rrd", number + 1
    return path


#: How long a robot that has connected may take to tell its yaw.
YAW_COMES_S = 1.0

#: Ticks in which a robot must report its position and be upright.
READY_TICKS = 50

#: Attempts to reach a better start before the trial begins at the present position.
APPROACHES = 2

#: Time limit of a walk to a start, in multiples of its duration without slip.
APPROACH_TIMEOUT = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetFreeRunner:
    """Walks the gaits of one session on one connected robot, through one guard: a stop stays latched.

    Attributes:
        runner: makes plans and recordings.
        servos: the robot, connected.
        arena: circle in which it is kept, or None to let it wander.
        operator: places the robot and measures; None where the robot knows its position.
    """

    runner: TrialRunner
    servos: Guard
    arena: Arena | None = None
    operator: Operator | None = None

    def walk(self, index: int, code: int, slots: Slots, should_stop: Enough | None = None) -> WalkedTrial:
        """Run one trial from where the robot is.

        Raises RobotStoppedError for a robot that is stopped before it begins, RobotFaultError for one that
        does not know where it is or has gone.
        """
        plan = self.runner.plan_for(slots)
        if self.operator is not None:
            return self._walk_and_ask(self.operator, index, code, as_placed(plan, self.runner.robot))
        if self.arena is not None:
            return self._walk_inside(self.arena, index, code, plan, should_stop)
        await_ready(self.servos)
        return self.runner.walk_on(self.servos, plan, index, code, stop_when(should_stop))

    def _walk_and_ask(self, operator: Operator, index: int, code: int, plan: TrialPlan) -> WalkedTrial:
        """Walk a gait that an operator measures, as often as the operator asks for."""
        robot, again = self.runner.robot, False

        def completed(result: TrialResult) -> TrialResult:
            nonlocal again
            if result.status not in ("ok", "no_progress"):
                return result
            answer = operator.measure(index, at_most_m=2 * result.ideal_distance_m)
            again = answer.word == "again"
            return measured(result, answer, robot, plan)

        check_not_stopped(self.servos)
        if not operator.place(index, code):
            return WalkedTrial(result=not_walked(robot, plan))
        await_ready(self.servos, needs_pose=False)
        walked = self.runner.walk_on(self.servos, plan, index, code, completed=completed)
        return self._walk_and_ask(operator, index, code, plan) if again else walked

    def _walk_inside(
        self, arena: Arena, index: int, code: int, plan: TrialPlan, should_stop: Enough | None
    ) -> WalkedTrial:
        """Walk through the middle of the arena, from a better start if need be, and end at its edge."""
        hindered = self._come_to_start(arena)
        if hindered is not None:
            return WalkedTrial(result=hindered)
        geofence = Geofence(arena, stop_when(should_stop))

        def completed(result: TrialResult) -> TrialResult:
            at_edge = result.status == "cut_short" and geofence.reached
            return replace(result, stopped=LEFT_THE_ARENA) if at_edge else result

        state = await_ready(self.servos)
        here = aimed(plan, self.runner.robot, state, arena)
        return self.runner.walk_on(self.servos, here, index, code, geofence, completed)

    def _come_to_start(self, arena: Arena) -> TrialResult | None:
        """Walk away from the middle while a walk has no room; return what stopped the robot there, if any.

        It walks with the gait of self-rotations, not with an untested one.
        """
        robot = self.runner.robot
        plan = self.runner.plan_for(turn_gait(robot).slots)
        speed_m_s = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
        reach_m = speed_m_s * plan.duration_s
        start = arena.start(reach_m)
        for _ in range(APPROACHES):
            state = await_ready(self.servos)
            position = state.base_position_world
            if position is None or not arena.too_near(position, reach_m):
                return None
            missing_m = start.radius_m - start.distance_m(position)
            timeout_s = APPROACH_TIMEOUT * (RAMP_DURATION_S + missing_m / speed_m_s)
            there = replace(aimed(plan, robot, state, arena, outward=True), duration_s=timeout_s)
            result = run_trial(
                self.servos,
                there,
                stop_requested=self.runner.stop_requested,
                should_stop=Geofence(start),
            )
            if result.status == "fell":
                # The gait of the trial is not at fault: nothing is stored.
                return replace(result, status="aborted", stopped="fell")
            if result.status == "aborted":
                return result
        return None


def await_ready(servos: Guard, *, needs_pose: bool = True) -> RobotState:
    """State of a robot once it is upright and, if needed, knows its position.

    Raises RobotStoppedError for one that is stopped, RobotFaultError for one that never says where it is:
    without a pose there is nothing to score.
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
    """Spec of a session that begins where the robot is now.

    Raises RobotStoppedError for a robot that is stopped, RobotFaultError for one that does not know its
    position and must, InputError for one without the joint torques that the objective needs.
    """
    if servos is None or spec.ask:
        return spec
    state = await_ready(servos)
    objective = OBJECTIVES.get(spec.objective)
    if objective is not None and objective.needs_torques and state.joint_torques_nm is None:
        usable = [name for name, shipped in OBJECTIVES.items() if not shipped.needs_torques]
        raise InputError(
            f"{argument('objective')}: got {spec.objective} with a robot that does not tell its joint "
            f"torques; allowed: {', '.join(usable)}"
        )
    position = state.base_position_world
    if spec.arena_m is None or position is None:
        return spec
    return replace(spec, home_m=[float(position[0]), float(position[1])])


def yaw_note(spec: SessionSpec, servos: Guard | None) -> str | None:
    """That walks will not hold the heading they are asked to, as the robot tells no yaw; None where they can.

    Raises RobotFaultError for a robot that has gone.
    """
    wanted = spec.hold == "heading" or (spec.hold == "auto" and spec.ask)
    if servos is None or not wanted:
        return None
    if comes_true(lambda: servos.peek().base_quaternion_world is not None, YAW_COMES_S):
        return None
    said = "this robot tells no yaw, so that its walks cannot hold their heading"
    instead = "; --optimizer trim --hold none learns a turn from the ends alone"
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
    """Keep the robot of a session connected; None where each trial makes a simulation of its own.

    Args:
        spec: of the session.
        setting: what the spec names.
        given: the robot, where it is not made by `spec.backend`.
        note: is told what an operator should know about it.

    Raises RobotFaultError for a robot that cannot be reached.
    """
    if spec.simulated:
        text = untold_note(drawn_failure(setting.robot, spec.broken, spec.seed), spec.broken)
        if text is not None:
            note(text)
        yield None
        return
    request_realtime_priority()
    options = BackendOptions.of(
        spec, robot=setting.robot, world=None, failure=spec.broken, robot_file=setting.robot_file
    )
    robot = make_servos(spec.backend, options) if given is None else given
    servos = Guard(robot)
    try:
        servos.connect()
        for text in connection_notes(robot, setting.plan.belief):
            note(text)
        yield servos
    finally:
        # The result comes after the robot is released: a link that fails at that must not cost it.
        with suppress(RobotFaultError):
            servos.close()
