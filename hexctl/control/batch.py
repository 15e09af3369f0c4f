"""Batches of simulated trials on all cores; each equals the same trial run alone, to the last bit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from hexctl.backends.base import as_robot, check_targets
from hexctl.backends.sim.batch import SimBatch
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World, as_world
from hexctl.control.assessment.cause import WalkSamples
from hexctl.control.assessment.walk_quality import WalkEffort
from hexctl.control.guard import FALL_TICKS, Guard, StepLimits, leaning
from hexctl.control.plan import TrialPlan
from hexctl.control.preparation import WalkStart, prepare, ticks_of
from hexctl.control.result import TrialResult, score
from hexctl.control.trial import CONTROLLERS, MakeController, made_controller, planned_walk, run_trial
from hexctl.control.turning import check_plan, turn_needed_rad
from hexctl.errors import (
    CommandRefusedError,
    EStopError,
    RobotFaultError,
    SimulationDivergedError,
    check_callable,
    check_type,
)
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray, JointTargets, RobotState, check_shape


@dataclass(frozen=True, slots=True, kw_only=True, init=False)
class SimTrial:
    """One simulated trial, picklable: evaluating it is a pure function of this value.

    Robot and world may be given by name or path. Raises InputError for what is not allowed.

    Attributes:
        robot: who walks.
        plan: what the robot does, and what its controller was told.
        failure: the leg that the simulation breaks, or None.
        world: where.
        seed: of the simulation.
        facing_rad: yaw in which the robot is put down; the plan's heading counts from there.
    """

    robot: Robot
    plan: TrialPlan
    failure: Failure | None
    world: World
    seed: int
    facing_rad: float

    def __init__(
        self,
        *,
        robot: Robot | str | Path,
        plan: TrialPlan,
        failure: Failure | None,
        world: World | str | Path | None = None,
        seed: int = 0,
        facing_rad: float = 0.0,
    ) -> None:
        check_type(plan, TrialPlan, "trial.plan", "a TrialPlan")
        check_type(failure, (Failure, type(None)), "trial.failure", "a Failure, as Failure(leg=5), or None")
        check_type(seed, int, "trial.seed")
        check_type(facing_rad, float, "trial.facing_rad")
        values = (as_robot(robot), plan, failure, as_world(world), seed, facing_rad)
        for place, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, place.name, value)

    def servos(self) -> SimServos:
        """Simulated robot of this trial, not yet connected."""
        return SimServos(
            self.robot,
            world=self.world,
            failure=self.failure,
            seed=self.seed,
            facing_rad=self.facing_rad,
        )

    def put_down_turned(self, miss_rad: float = 0.0) -> "SimTrial":
        """The same trial, the robot put down as its self-rotation would leave it, instead of turning.

        `miss_rad` is the yaw by which that self-rotation would have turned too far.
        """
        turn_rad = turn_needed_rad(self.robot, self.plan) + miss_rad
        plan = replace(self.plan, self_rotation="none", heading_rad=self.plan.heading_rad - turn_rad)
        return replace(self, plan=plan, facing_rad=self.facing_rad + turn_rad)

    def shared_start(self) -> tuple[object, ...]:
        """Key that trials must have in common to walk together, from one state and with one kind of walk."""
        plan = self.plan
        start = (self.facing_rad, plan.heading_rad, plan.self_rotation, plan.turn_rad, plan.settle_s)
        walk = (plan.hold, plan.straight, tuple(change.at_s for change in plan.changes))
        return (self.robot.fingerprint, self.world, self.seed, self.failure, plan.belief, start, walk)


def run_sim_trial(trial: SimTrial, make_controller: MakeController = planned_walk) -> TrialResult:
    """Result of one simulated trial, run alone."""
    check_type(trial, SimTrial, "trial", "a SimTrial")
    with trial.servos() as servos:
        return run_trial(Guard(servos), trial.plan, make_controller, soft_stop=False)


def run_sim_trials(
    trials: Sequence[SimTrial], threads: int = 0, make_controller: MakeController = planned_walk
) -> list[TrialResult]:
    """Results of many simulated trials, in their order: each as if run alone, to the last bit.

    Trials with the same robot, world, seed, failure, heading and turn settle and turn once and walk together.
    Best for many gaits in few worlds.

    Args:
        trials: what to walk.
        threads: threads that simulate; 0 uses all cores.
        make_controller: makes the controller of each group, for states and targets of leading shape (n,).

    Raises ReachError or LimitError for a walk that the legs cannot make, before any trial runs; InputError
    for targets of another shape than (n, 18).
    """
    check_type(trials, Sequence, "trials", "a sequence of SimTrials")
    check_type(threads, int, "threads", "a whole number, 0 for all cores")
    check_callable(make_controller, "make_controller", CONTROLLERS)
    for trial in trials:
        check_type(trial, SimTrial, "trials", "SimTrials")
        check_plan(trial.robot, trial.plan)
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, trial in enumerate(trials):
        groups.setdefault(trial.shared_start(), []).append(index)
    results: dict[int, TrialResult] = {}
    for indices in groups.values():
        together = [trials[index] for index in indices]
        results.update(zip(indices, _run_group(together, threads, make_controller), strict=True))
    return [results[index] for index in range(len(trials))]


def _run_group(
    trials: Sequence[SimTrial], threads: int, make_controller: MakeController
) -> list[TrialResult]:
    """Run trials that share their start."""
    robot, plans = trials[0].robot, tuple(trial.plan for trial in trials)
    with trials[0].servos() as servos:
        guard = Guard(servos)
        try:
            first = prepare(guard, plans[0])
        except (EStopError, SimulationDivergedError, RobotFaultError) as error:
            status = "diverged" if isinstance(error, SimulationDivergedError) else "fell"
            if isinstance(error, RobotFaultError):
                status = "aborted"
            return [_never_walked(robot, plan, status) for plan in plans]
        start = replace(first, plans=plans, batch_shape=(len(plans),))
        walks = _Walks(guard, servos, start, make_controller, threads)
        walks.run()
        return walks.results()


def _never_walked(robot: Robot, plan: TrialPlan, status: str) -> TrialResult:
    nothing = np.zeros((0, 4))
    return score(
        robot,
        plan,
        status=status,
        duration_s=0.0,
        turned_rad=0.0,
        clipped_ticks=0,
        frame=None,
        positions_world=nothing[:, :3],
        quaternions_world=nothing,
    )


class _Walks:
    """The walks of a group, from their common start line to their ends.

    Each tick is the tick of `hexctl.control.loop`, for all robots together.
    """

    def __init__(
        self, guard: Guard, servos: SimServos, start: WalkStart, make_controller: MakeController, threads: int
    ) -> None:
        n = len(start.plans)
        self._start = start
        self._controller = made_controller(make_controller, start)
        self._batch = SimBatch(servos, n, threads)
        self._limits = StepLimits.of(start.robot, start.period_s)
        self._accepted_rad = np.tile(guard.accepted_rad(), (n, 1))
        self._ticks = np.array([ticks_of(guard, plan.duration_s) for plan in start.plans])
        self._walked = np.zeros(n, dtype=int)
        self._clipped = np.zeros(n, dtype=int)
        self._limited = np.zeros(n, dtype=int)
        self._leaning_ticks = np.full(n, guard.leaning_ticks)
        self._status = np.full(n, "ok", dtype=object)
        self._stopped: list[str | None] = [None] * n
        self._samples = WalkSamples(int(self._ticks.max()), (n,))
        self._effort = WalkEffort((n,))
        self._positions = np.full((n, self._ticks.max(), 3), np.nan)
        self._quaternions = np.full((n, self._ticks.max(), 4), np.nan)
        self._true_positions = np.full((n, self._ticks.max(), 3), np.nan)

    def run(self) -> None:
        """Walk until every trial is over."""
        running = self._batch.running
        for step in range(int(self._ticks.max())):
            before = running.copy()
            self._batch.tick()
            self._end(before & ~running, "diverged")
            state = self._batch.read()
            asked = running.copy()
            self._watch(state)
            wanted_rad = self._controller.targets_rad(step, state)
            self._limited[asked] = np.broadcast_to(self._controller.limited_steps, asked.shape)[asked]
            self._refuse(wanted_rad)
            self._accepted_rad = self._limits.apply(wanted_rad, self._accepted_rad)
            self._batch.write(self._accepted_rad)
            self._samples.add(state, self._accepted_rad)
            self._effort.add(state, self._accepted_rad, running)
            self._clipped += running & (self._accepted_rad != wanted_rad).any(axis=-1)
            self._walked += running
            if state.base_position_world is not None:
                self._positions[:, step] = state.base_position_world
            if state.base_quaternion_world is not None:
                self._quaternions[:, step] = state.base_quaternion_world
            self._true_positions[:, step] = self._batch.true_pose[0]
            running &= (step + 1 < self._ticks) & ~np.asarray(self._controller.done(step, state))
            if not running.any():
                return

    def results(self) -> list[TrialResult]:
        """Result of each walk."""
        return [
            score(
                self._start.robot,
                plan,
                status=str(self._status[index]),
                stopped=self._stopped[index],
                duration_s=walked * self._start.period_s,
                turned_rad=self._start.turned_rad,
                clipped_ticks=int(self._clipped[index]),
                hold=self._controller.hold,
                limited_ticks=int(self._limited[index]),
                frame=self._start.frame,
                positions_world=self._positions[index, :walked],
                true_positions_world=self._true_positions[index, :walked],
                quaternions_world=self._quaternions[index, :walked],
                samples=self._samples.of(walked, (index,)),
                energy_j=self._effort.energy_j((index,)),
            )
            for index, (plan, walked) in enumerate(zip(self._start.plans, self._walked.tolist(), strict=True))
        ]

    def _watch(self, state: RobotState) -> None:
        """End the walks of robots that have fallen."""
        if state.base_quaternion_world is None:
            return
        leans = leaning(state.base_quaternion_world)
        self._leaning_ticks = np.where(leans, self._leaning_ticks + 1, 0)
        self._end(self._batch.running & (self._leaning_ticks >= FALL_TICKS), "fell")

    def _refuse(self, wanted_rad: FloatArray) -> None:
        """End the walks whose targets a guard refuses: those that are not finite."""
        check_shape(wanted_rad, self._accepted_rad.shape, "controller: targets")
        if math.isfinite(np.add.reduce(wanted_rad, axis=None)):
            return
        for index in np.flatnonzero(self._batch.running).tolist():
            try:
                check_targets(JointTargets(wanted_rad[index], 0.0))
            except CommandRefusedError as error:
                self._stopped[index], self._status[index] = str(error), "aborted"
                self._batch.running[index] = False

    def _end(self, which: BoolArray, status: str) -> None:
        self._status[which] = status
        self._batch.running &= ~which
