"""A batch of simulated trials over bare stepping of the same physics on the same number of threads.

The controls that the guard accepted are recorded in a run of its own. The reference replays them: plain
Python threads that each take one trial after another and loop over `mj_step`, which releases the GIL.
"""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np

import hexctl.control.batch
from benchmarks.physics import STATE, Start, bare_steps, controls_of, require_same_end, state_of
from benchmarks.plans import ant, recovery_plans
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.timing import alternate, median_ratio, spread
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.preparation import prepare
from hexctl.control.trial_plan import TrialPlan
from hexctl.types import FloatArray

#: The failed leg of the demonstration.
FAILED_LEG = 5

#: What the ratio shall reach one day; its bar is lower.
STRETCH = 0.97

THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def batch_rows(scale: Scale) -> Iterator[Row]:
    """Physics steps per second of a batch of trials over bare mj_step on as many threads."""
    plans = recovery_plans(FAILED_LEG, scale.codes, scale.batch_walk_s, "rear")
    yield from _held_rows(plans, scale)
    work = BatchWork([SimTrial(robot=ant(), plan=plan, failures=plan.failures) for plan in plans])
    pairs = alternate(work.ours, work.bare, scale.rounds)
    walks = [(bare.walk_s, ours.walk_s) for ours, bare in pairs]
    what = f"{scale.codes} walks of {scale.batch_walk_s:g} s on {THREADS} threads"
    note = f"{what}; {spread(walks)}; stretch {STRETCH:g}"
    yield Row("batch.steps_per_s", median_ratio(walks), "ratio", Bar(low=0.9), note)


def _held_rows(plans: list[TrialPlan], scale: Scale) -> Iterator[Row]:
    """The walks of a batch that hold their line."""
    trials = [
        SimTrial(robot=ant(), plan=replace(plan, hold="line"), failures=plan.failures) for plan in plans
    ]
    work = BatchWork(trials)
    pairs = alternate(work.ours, work.bare, scale.rounds)
    walks = [(bare.walk_s, ours.walk_s) for ours, bare in pairs]
    note = f"{scale.codes} walks that hold their line; {spread(walks)}"
    yield Row("batch.held", median_ratio(walks), "ratio", Bar(low=0.85), note)


@dataclass(frozen=True, slots=True)
class _Times:
    """Wall times in s: of everything, and of the walks, which begin when the shared start is over."""

    whole_s: float
    walk_s: float


class _Keeping(SimBatch):
    """A batch that keeps what its simulations were told and where they ended."""

    def __init__(self, servos: SimServos, n: int, threads: int = 0) -> None:
        super().__init__(servos, n, threads)
        self.first_state = self._batch.state[0].copy()
        self.ticks = np.zeros(n, dtype=int)
        self.controls = [self._ctrl.copy()]

    def tick(self) -> None:
        self.ticks += self.running
        super().tick()

    def write(self, joint_positions_rad: FloatArray) -> None:
        super().write(joint_positions_rad)
        self.controls.append(self._ctrl.copy())

    def positions(self) -> FloatArray:
        """Return where the simulations are, generalised positions (n, nq)."""
        return np.asarray(self._qpos.copy())


class BatchWork:
    """The trials and their controls, recorded once and checked against the reference."""

    def __init__(self, trials: list[SimTrial]) -> None:
        self._trials = trials
        kept: list[_Keeping] = []
        self._run_with(lambda *given: kept.append(_Keeping(*given)) or kept[0])  # type: ignore[func-returns-value]
        each = np.stack(kept[0].controls, axis=1)  # (n, ticks + 1, 18)
        self._controls = [list(row[:ticks]) for row, ticks in zip(each, kept[0].ticks, strict=True)]
        with trials[0].servos() as servos:
            self._start = Start.of(servos)
            log = TickLog()
            prepare(Guard(servos), trials[0].plan, (log,))
            self._start_controls = controls_of(log, servos)
        require_same_end(kept[0].first_state, self._start_line(), "start of the batch")
        require_same_end(kept[0].positions(), np.stack(self._walk(self._start_line())), "batch")

    def ours(self) -> _Times:
        """Return the wall times of `run_sim_trials`."""
        marks: list[float] = []
        began_s = time.perf_counter()
        self._run_with(lambda *given: marks.append(time.perf_counter()) or SimBatch(*given))  # type: ignore[func-returns-value]
        ended_s = time.perf_counter()
        return _Times(ended_s - began_s, ended_s - marks[0])

    def bare(self) -> _Times:
        """Return the wall times of the same physics steps with the same controls."""
        began_s = time.perf_counter()
        start_line = self._start_line()
        walking_s = time.perf_counter()
        self._walk(start_line)
        ended_s = time.perf_counter()
        return _Times(ended_s - began_s, ended_s - walking_s)

    def _run_with(self, make_batch: Callable[..., SimBatch]) -> None:
        """Run the trials with another way to make the batch once their shared start is over."""
        with patch.object(hexctl.control.batch, "SimBatch", make_batch):
            run_sim_trials(self._trials, THREADS)

    def _start_line(self) -> FloatArray:
        """Return the state in which all walks begin, stepped from the start of the simulation."""
        data = self._start.data()
        bare_steps(self._start.model, data, self._start_controls)
        return state_of(self._start.model, data)

    def _walk(self, start_line: FloatArray) -> list[FloatArray]:
        """Step all walks on threads and return where each ended."""
        model = self._start.model

        def walk(controls: list[FloatArray]) -> Any:
            data = mujoco.MjData(model)
            mujoco.mj_setState(model, data, start_line, STATE)
            bare_steps(model, data, controls)
            return data.qpos.copy()

        with ThreadPoolExecutor(THREADS) as pool:
            return list(pool.map(walk, self._controls))
