"""Batches of simulated trials on all cores; each equals a single run of the same trial, to the last bit."""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from hexctl.backends.base import as_robot, check_targets
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch, batch_layout
from hexctl.backends.sim.world import World, as_world
from hexctl.control.custom_controller import (
    CONTROLLERS,
    BatchController,
    check_controller,
    controller_name,
    made_controller,
)
from hexctl.control.guard import (
    FALL_TICKS,
    LONGEST_UNSEEN_S,
    MOVES_RAD,
    POSE_LOST,
    Guard,
    StepLimits,
    leaning,
)
from hexctl.control.pose_watch import joined
from hexctl.control.preparation import WalkStart, prepare, ticks_of
from hexctl.control.scoring.cause import WalkSamples
from hexctl.control.scoring.score import score
from hexctl.control.scoring.walk_quality import WalkEffort
from hexctl.control.trace import TrialFrame
from hexctl.control.trial import planned_walk, run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.control.walks.steering import possible_hold
from hexctl.control.walks.turning import check_plan, turn_needed_rad
from hexctl.errors import (
    CommandRefusedError,
    EStopError,
    HexctlError,
    RobotFaultError,
    SimulationDivergedError,
    check_callable,
    check_type,
)
from hexctl.robot.failure import Failure, FailureEvent, Failures, NoticedFailure, checked_failures
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray, JointTargets, RobotState, as_joint_angles

#: Trials from different starts are stepped together up to this number, which shares the cost of a tick.
MOST_TOGETHER = 64


@dataclass(frozen=True, slots=True, kw_only=True, init=False)
class SimTrial:
    """One simulated trial, picklable: evaluating it is a pure function of this value.

    Robot and world may be given by name or path. Raises InputError for invalid input.

    Attributes:
        plan: what the robot does, and the failures its controller knows.
        failures: what the simulation breaks, by leg; given as one failure, several or None.
        facing_rad: yaw in which the robot is put down; the plan's heading counts from there.
        events: failures that come during the walk, and legs that heal.
        trial: number of the trial in its world; sensor noise differs between trials.
    """

    robot: Robot
    plan: TrialPlan
    failures: tuple[Failure, ...]
    world: World
    seed: int
    facing_rad: float
    events: tuple[FailureEvent, ...]
    trial: int

    def __init__(
        self,
        *,
        robot: Robot | str | Path,
        plan: TrialPlan,
        failures: Failures,
        world: World | str | Path | None = None,
        seed: int = 0,
        facing_rad: float = 0.0,
        events: Sequence[FailureEvent] = (),
        trial: int = 0,
    ) -> None:
        check_type(plan, TrialPlan, "trial.plan", "a TrialPlan")
        broken = checked_failures(failures, "trial.failures")
        values = (
            *(as_robot(robot), plan, broken, as_world(world), seed, facing_rad, tuple(events)),
            trial,
        )
        for place, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, place.name, value)

    def servos(self) -> SimServos:
        """Simulated robot of this trial, not yet connected."""
        return SimServos(
            self.robot,
            world=self.world,
            failures=self.failures,
            seed=self.seed,
            facing_rad=self.facing_rad,
            events=self.events,
            trial=self.trial,
        )

    def put_down_turned(self, miss_rad: float = 0.0) -> "SimTrial":
        """The same trial with the robot put down as its self-rotation would leave it, `miss_rad` too far."""
        turn_rad = turn_needed_rad(self.robot, self.plan) + miss_rad
        plan = replace(self.plan, self_rotation="none", heading_rad=self.plan.heading_rad - turn_rad)
        return replace(self, plan=plan, facing_rad=self.facing_rad + turn_rad)

    def shared_start(self) -> tuple[object, ...]:
        """Key of trials that walk from one state, with one kind of walk."""
        plan = self.plan
        start = (self.facing_rad, plan.heading_rad, plan.self_rotation, plan.turn_rad, plan.settle_s)
        failures = (self.failures, self.events, plan.failures)
        return (self.world, self.seed, self.trial, *failures, start, *self.shared_walk())

    def shared_walk(self) -> tuple[object, ...]:
        """Key of trials that one controller can lead."""
        plan, world = self.plan, self.world
        changes = tuple(change.at_s for change in plan.changes)
        ticks = (world.time_step_s, world.latency_steps)
        walk = (plan.hold, plan.level, plan.feet, plan.straight)
        return (self.robot.fingerprint, self.robot.sensors, *ticks, *walk, changes)


def run_sim_trial(trial: SimTrial, make_controller: BatchController = planned_walk) -> TrialResult:
    """Result of one simulated trial."""
    check_type(trial, SimTrial, "trial", "a SimTrial")
    with trial.servos() as servos:
        return run_trial(Guard(servos), trial.plan, make_controller, soft_stop=False)


def run_sim_trials(
    trials: Sequence[SimTrial],
    threads: int = 0,
    make_controller: BatchController = planned_walk,
    *,
    apart: bool = False,
) -> list[TrialResult]:
    """Results of many simulated trials in their order, each as in a single run to the last bit.

        robot = hexctl.load_robot("ant")
        plan = hexctl.TrialPlan(gait=hexctl.make_gait(robot, "wave"), duration_s=2)
        trials = [hexctl.SimTrial(robot=robot, plan=plan, failures=None, world=w) for w in ("flat", "slope")]
        print(hexctl.run_sim_trials(trials))

    Trials that begin alike (robot, world, seed, failure, heading, turn) settle, turn and walk together.

    Args:
        threads: threads that simulate; 0 uses all cores.
        make_controller: of each group, for states and targets of leading shape (n,); or a function of step
            and such a state that returns joint angles.
        apart: whether the controller leads trials from different starts; turn and frame of its `WalkStart`
            then have the leading shape (n,).

    Raises ReachError or LimitError before any trial runs; InputError for targets of another shape than (n,
    18).
    """
    check_type(trials, Sequence, "trials", "a sequence of SimTrials")
    check_callable(make_controller, "make_controller", CONTROLLERS)
    check_controller(make_controller)
    for trial in trials:
        check_type(trial, SimTrial, "trials", "SimTrials")
        check_plan(trial.robot, trial.plan)
    results: dict[int, TrialResult] = {}
    for starts in _groups(trials, mixed=apart or make_controller is planned_walk):
        flat = [index for indices in starts for index in indices]
        together = [[trials[index] for index in indices] for indices in starts]
        results.update(zip(flat, _run_group(together, threads, make_controller), strict=True))
    return [results[index] for index in range(len(trials))]


def _groups(trials: Sequence[SimTrial], *, mixed: bool) -> Iterator[list[list[int]]]:
    starts: dict[tuple[object, ...], list[int]] = {}
    for index, trial in enumerate(trials):
        starts.setdefault(trial.shared_start(), []).append(index)
    if not mixed:
        yield from ([indices] for indices in starts.values())
        return
    walks: dict[tuple[object, ...], list[list[int]]] = {}
    for indices in starts.values():
        walks.setdefault(trials[indices[0]].shared_walk(), []).append(indices)
    for alike in walks.values():
        group: list[list[int]] = []
        for indices in alike:
            if group and sum(map(len, group)) + len(indices) > MOST_TOGETHER:
                yield group
                group = []
            group.append(indices)
        yield group


def _run_group(
    starts: Sequence[Sequence[SimTrial]], threads: int, make_controller: BatchController
) -> list[TrialResult]:
    """Results of the trials of each start, in order; trials of one start share its preparation."""
    results: dict[int, list[TrialResult]] = {}
    with ExitStack() as stack:
        ready: dict[tuple[object, ...], dict[int, _Ready]] = {}
        for number, trials in enumerate(starts):
            servos = stack.enter_context(trials[0].servos())
            plans, guard = tuple(trial.plan for trial in trials), Guard(servos)
            try:
                start = prepare(guard, plans[0])
            except (EStopError, SimulationDivergedError, RobotFaultError) as error:
                status, name = _status_of(error), controller_name(make_controller)
                results[number] = [
                    score(servos.robot, plan, status=status, controller=name) for plan in plans
                ]
                continue
            alike = (possible_hold(plans[0], start.frame), start.frame is None, *batch_layout(servos))
            one = _Ready(guard, servos, replace(start, plans=plans, batch_shape=(len(plans),)))
            ready.setdefault(alike, {})[number] = one
        for group in ready.values():
            walks = _Walks(list(group.values()), make_controller, threads)
            walks.run()
            found = iter(walks.results())
            for number, one in group.items():
                results[number] = [next(found) for _ in one.start.plans]
    return [result for number in range(len(starts)) for result in results[number]]


def _status_of(error: HexctlError) -> str:
    if isinstance(error, SimulationDivergedError):
        return "diverged"
    return "aborted" if isinstance(error, RobotFaultError) else "fell"


@dataclass(frozen=True, slots=True)
class _Ready:
    guard: Guard
    servos: SimServos
    start: WalkStart


def _start_together(starts: Sequence[WalkStart]) -> WalkStart:
    if len(starts) == 1:
        return starts[0]
    counts = [len(start.plans) for start in starts]
    plans = tuple(plan for start in starts for plan in start.plans)
    frames = [start.frame for start in starts if start.frame is not None]
    frame = None
    if frames:
        frame = TrialFrame(
            np.repeat([each.origin_world for each in frames], counts, axis=0),
            np.repeat([each.heading_rad for each in frames], counts),  # type: ignore[arg-type]
            np.repeat([each.yaw_rad for each in frames], counts),  # type: ignore[arg-type]
        )
    turned_rad = np.repeat([start.turned_rad for start in starts], counts)
    return replace(
        starts[0],
        plans=plans,
        batch_shape=(len(plans),),
        turned_rad=turned_rad,  # type: ignore[arg-type]
        frame=frame,
    )


class _Walks:
    """The walks of a group; each tick equals that of `hexctl.control.loop`, for all robots together."""

    def __init__(self, ready: Sequence[_Ready], make_controller: BatchController, threads: int) -> None:
        counts = [len(one.start.plans) for one in ready]
        self._starts = [one.start for one in ready for _ in one.start.plans]
        start = _start_together([one.start for one in ready])
        n, self._plans = len(start.plans), start.plans
        self._controller = made_controller(make_controller, start)
        self._name = controller_name(make_controller)
        self._batch = SimBatch([one.servos for one in ready], counts, threads)
        self._limits = StepLimits.of(start.robot, start.period_s)
        self._accepted_rad = np.repeat([one.guard.accepted_rad() for one in ready], counts, axis=0)
        self._ticks = np.array([ticks_of(ready[0].guard, plan.duration_s) for plan in start.plans])
        self._walked = np.zeros(n, dtype=int)
        self._clipped = np.zeros(n, dtype=int)
        self._limited = np.zeros(n, dtype=int)
        self._leaning_ticks = np.repeat([one.guard.leaning_ticks for one in ready], counts)
        self._unseen_s = np.repeat([one.guard.poses.oldest_s(one.guard.clock.now_s) for one in ready], counts)
        self._moving = np.repeat([one.guard.in_motion for one in ready], counts)
        shown = [one.guard.poses.shown("position") for one in ready]
        self._shown = np.repeat([np.full(7, np.nan) if one is None else one for one in shown], counts, axis=0)
        self._status = np.full(n, "ok", dtype=object)
        self._stopped: list[str | None] = [None] * n
        self._noticed: list[tuple[NoticedFailure, ...]] = [()] * n
        self._samples = WalkSamples(int(self._ticks.max()), (n,))
        self._effort = WalkEffort((n,))
        self._positions = np.full((n, self._ticks.max(), 3), np.nan)
        self._quaternions = np.full((n, self._ticks.max(), 4), np.nan)
        self._true_positions = np.full((n, self._ticks.max(), 3), np.nan)

    def run(self) -> None:
        running = self._batch.running
        for step in range(int(self._ticks.max())):
            before = running.copy()
            self._batch.tick()
            self._end(before & ~running, "diverged")
            state = self._batch.read()
            asked = running.copy()
            self._watch(state)
            requested_rad = self._controller.targets_rad(step, state)
            requested_rad = as_joint_angles(requested_rad, "controller", leading_shape=running.shape)
            self._limited[asked] = np.broadcast_to(self._controller.limited_steps, asked.shape)[asked]
            self._refuse(requested_rad)
            before_rad, self._accepted_rad = (
                self._accepted_rad,
                self._limits.apply(requested_rad, self._accepted_rad),
            )
            self._moving = np.abs(self._accepted_rad - before_rad).max(axis=-1) > MOVES_RAD
            self._batch.write(self._accepted_rad)
            self._samples.add(state, self._accepted_rad)
            self._effort.add(state, self._accepted_rad, running)
            self._clipped += running & (self._accepted_rad != requested_rad).any(axis=-1)
            self._walked += running
            if state.base_position_world is not None:
                self._positions[:, step] = state.base_position_world
            if state.base_quaternion_world is not None:
                self._quaternions[:, step] = state.base_quaternion_world
            self._true_positions[:, step] = self._batch.true_pose[0]
            self._end_done(running & self._controller.done(step, state))
            running &= step + 1 < self._ticks
            # Ended robots are led until the batch ends; failures detected after the end do not count.
            for index in np.flatnonzero(asked & ~running).tolist():
                self._noticed[index] = self._controller.noticed_failures(index)
            if not running.any():
                return

    def _end_done(self, done: BoolArray) -> None:
        if not done.any():
            return
        self._batch.running &= ~done
        for index in np.flatnonzero(done).tolist():
            if (why := self._controller.why_stopped(index)) is not None:
                self._status[index], self._stopped[index] = "aborted", why

    def results(self) -> list[TrialResult]:
        return [
            score(
                start.robot,
                plan,
                status=str(self._status[index]),
                stopped=self._stopped[index],
                duration_s=walked * start.period_s,
                turned_rad=start.turned_rad,
                clipped_ticks=int(self._clipped[index]),
                hold=self._controller.hold,
                limited_ticks=int(self._limited[index]),
                frame=start.frame,
                true_frame=start.true_frame,
                positions_world=self._positions[index, :walked],
                true_positions_world=self._true_positions[index, :walked],
                quaternions_world=self._quaternions[index, :walked],
                samples=self._samples.of(walked, (index,)),
                energy_j=self._effort.energy_j((index,)),
                noticed=self._noticed[index],
                controller=self._name,
            )
            for index, (plan, walked, start) in enumerate(
                zip(self._plans, self._walked.tolist(), self._starts, strict=True)
            )
        ]

    def _watch(self, state: RobotState) -> None:
        quaternion = state.base_quaternion_world
        self._watch_position(state.base_position_world, quaternion)
        if quaternion is None:
            return
        counted = np.where(leaning(quaternion), self._leaning_ticks + 1, 0)
        self._leaning_ticks = np.where(np.isnan(quaternion[:, 0]), self._leaning_ticks, counted)
        self._end(self._batch.running & (self._leaning_ticks >= FALL_TICKS), "fell")

    def _watch_position(self, position: FloatArray | None, quaternion: FloatArray | None) -> None:
        """Stop robots whose position, (n, 3), is missing, or repeats itself while they move, for too long."""
        shown = np.full_like(self._shown, np.nan) if position is None else joined(position, quaternion)
        missing, known = np.isnan(shown[:, 0]), np.isfinite(self._shown[:, 0])
        new = ~missing & (shown != self._shown).any(axis=-1)
        self._unseen_s = np.where(new, 0.0, self._unseen_s + PERIOD_S * (known & (missing | self._moving)))
        self._shown = np.where(new[:, np.newaxis], shown, self._shown)
        lost = self._batch.running & (self._unseen_s > LONGEST_UNSEEN_S)
        for index in np.flatnonzero(lost).tolist():
            self._stopped[index] = POSE_LOST
        self._end(lost, "aborted")

    def _refuse(self, requested_rad: FloatArray) -> None:
        if math.isfinite(np.add.reduce(requested_rad, axis=None)):
            return
        for index in np.flatnonzero(self._batch.running).tolist():
            try:
                check_targets(JointTargets(requested_rad[index], 0.0))
            except CommandRefusedError as error:
                self._stopped[index], self._status[index] = str(error), "aborted"
                self._batch.running[index] = False

    def _end(self, which: BoolArray, status: str) -> None:
        self._status[which] = status
        self._batch.running &= ~which
