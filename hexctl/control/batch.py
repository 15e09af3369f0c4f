"""Many simulated trials at once: the same trials as alone, to the last bit, on all cores."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hexctl.backends.sim.batch import SimBatch
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.controllers import LOOK_AHEAD_TICKS, joints_of_feet
from hexctl.control.guard import FALL_TICKS, Guard, StepLimits, leaning
from hexctl.control.log import TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult, score
from hexctl.control.trial import StartLine, prepare, run_trial, ticks_of
from hexctl.control.turning import check_plan
from hexctl.errors import EStopError, SimulationDivergedError
from hexctl.gait.foot_trajectory import feet_of_walks, stroke_vectors_m
from hexctl.robot.model import Robot
from hexctl.types import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SimTrial:
    """One simulated trial, picklable: evaluating it is a pure function of this value.

    Attributes:
        robot: who walks.
        plan: what it shall do.
        world: where.
        seed: of the simulation.
        facing_rad: yaw in which the robot is put down; the plan's heading counts from there.
    """

    robot: Robot
    plan: TrialPlan
    world: World = field(default_factory=World)
    seed: int = 0
    facing_rad: float = 0.0

    def servos(self) -> SimServos:
        """Return the simulated robot of this trial, not yet connected."""
        return SimServos(
            self.robot,
            world=self.world,
            failure=self.plan.failure,
            seed=self.seed,
            facing_rad=self.facing_rad,
        )

    def shared_start(self) -> tuple[object, ...]:
        """Return what trials must have in common to start their walks from one state."""
        plan = self.plan
        start = (self.facing_rad, plan.heading_rad, plan.self_rotation, plan.settle_s)
        return (self.robot.fingerprint, self.world, self.seed, plan.failure, start)


def run_sim_trial(trial: SimTrial) -> TrialResult:
    """Return the result of one simulated trial, run alone."""
    with trial.servos() as servos:
        return run_trial(Guard(servos), trial.plan, TickLog(), soft_stop=False)


def run_sim_trials(trials: Sequence[SimTrial], threads: int = 0) -> list[TrialResult]:
    """Return the results of many simulated trials, in their order.

    Trials with the same robot, world, seed, failure and heading settle and turn once and walk together.
    Best for many gaits in few worlds. `threads` 0 uses all cores.
    Raises ReachError or LimitError for a walk that the legs cannot make, before any trial runs.
    """
    for trial in trials:
        check_plan(trial.robot, trial.plan)
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, trial in enumerate(trials):
        groups.setdefault(trial.shared_start(), []).append(index)
    results: dict[int, TrialResult] = {}
    for indices in groups.values():
        together = [trials[index] for index in indices]
        results.update(zip(indices, _run_group(together, threads), strict=True))
    return [results[index] for index in range(len(trials))]


def _run_group(trials: Sequence[SimTrial], threads: int) -> list[TrialResult]:
    """Run trials that share their start."""
    robot, plans = trials[0].robot, [trial.plan for trial in trials]
    with trials[0].servos() as servos:
        guard = Guard(servos)
        try:
            start = prepare(guard, plans[0], TickLog())
        except (EStopError, SimulationDivergedError) as error:
            status = "diverged" if isinstance(error, SimulationDivergedError) else "fell"
            return [_never_walked(robot, plan, status) for plan in plans]
        walks = _Walks(guard, servos, plans, start, threads)
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
    """The walks of a group, from their common start line to their ends."""

    def __init__(
        self, guard: Guard, servos: SimServos, plans: Sequence[TrialPlan], start: StartLine, threads: int
    ) -> None:
        self._robot, self._plans, self._start = servos.robot, plans, start
        self._period_s = servos.clock.period_s
        self._batch = SimBatch(servos, len(plans), threads)
        self._limits = StepLimits.of(servos.robot, self._period_s)
        self._accepted_rad = np.tile(guard.accepted_rad(), (len(plans), 1))
        self._ticks = np.array([ticks_of(guard, plan.duration_s) for plan in plans])
        self._walked = np.zeros(len(plans), dtype=int)
        self._clipped = np.zeros(len(plans), dtype=int)
        self._leaning_ticks = np.full(len(plans), guard.leaning_ticks)
        self._status = np.full(len(plans), "ok", dtype=object)
        self._positions = np.zeros((len(plans), self._ticks.max(), 3))
        self._quaternions = np.zeros((len(plans), self._ticks.max(), 4))

    def run(self) -> None:
        """Walk until every trial is over; each tick is the tick of `hexctl.control.loop` for all at once."""
        for step, wanted_rad in enumerate(self._targets()):
            before = self._batch.running.copy()
            self._batch.tick()
            self._end(before & ~self._batch.running, "diverged")
            state = self._batch.read()
            leans = leaning(state.base_quaternion_world)
            self._leaning_ticks = np.where(leans, self._leaning_ticks + 1, 0)
            self._end(self._batch.running & (self._leaning_ticks >= FALL_TICKS), "fell")
            self._accepted_rad = self._limits.apply(wanted_rad, self._accepted_rad)
            self._batch.write(self._accepted_rad)
            self._clipped += self._batch.running & (self._accepted_rad != wanted_rad).any(axis=-1)
            self._walked += self._batch.running
            self._positions[:, step] = state.base_position_world
            self._quaternions[:, step] = state.base_quaternion_world
            self._batch.running &= step + 1 < self._ticks
            if not self._batch.running.any():
                return

    def results(self) -> list[TrialResult]:
        """Return each walk's result."""
        return [
            score(
                self._robot,
                plan,
                status=str(self._status[index]),
                duration_s=walked * self._period_s,
                turned_rad=self._start.turned_rad,
                clipped_ticks=int(self._clipped[index]),
                frame=self._start.frame,
                positions_world=self._positions[index, :walked],
                quaternions_world=self._quaternions[index, :walked],
            )
            for index, (plan, walked) in enumerate(zip(self._plans, self._walked.tolist(), strict=True))
        ]

    def _end(self, which: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]", status: str) -> None:
        self._status[which] = status
        self._batch.running &= ~which

    def _targets(self) -> Iterator[FloatArray]:
        """Give the joint targets of all walks, (n, 18), tick by tick, planned in blocks."""
        gaits = [plan.gait for plan in self._plans]
        motions = [plan.motion(self._start.turned_rad) for plan in self._plans]
        strokes = np.stack(
            [stroke_vectors_m(self._robot, gait, motion) for gait, motion in zip(gaits, motions, strict=True)]
        )
        for first in range(0, int(self._ticks.max()), LOOK_AHEAD_TICKS):
            ticks = np.arange(first, min(first + LOOK_AHEAD_TICKS, int(self._ticks.max())))
            feet = feet_of_walks(
                self._robot,
                slots=np.array([gait.slots for gait in gaits]),
                stroke_vectors=strokes,
                pace_hz=np.array([gait.pace_hz for gait in gaits]),
                height_m=np.array([gait.height * self._robot.size_m for gait in gaits]),
                time_s=np.asarray(ticks * self._period_s, dtype=float),
            )
            joints = joints_of_feet(self._robot, feet, self._plans[0].held_legs)
            yield from np.ascontiguousarray(joints.swapaxes(0, 1))
