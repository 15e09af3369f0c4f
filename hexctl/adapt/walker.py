"""Walk one gait of a session and record it: what the loop calls a trial."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hexctl.adapt.session import SessionSpec
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World
from hexctl.backends.table import BackendOptions, make_servos
from hexctl.control.guard import Guard
from hexctl.control.log import BLOCK_TICKS, PACED_BLOCK_TICKS, TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.result import TrialResult
from hexctl.control.trial import Enough, StopRequested, never, run_trial
from hexctl.gait.encoding import Slots
from hexctl.record.live import LiveView
from hexctl.record.recording import Recording
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot

#: What ends a walk early, for the walk that a log will be of.
EnoughOf = Callable[[TickLog], Enough | None]

#: Puts a result right before it is recorded.
Completed = Callable[[TrialResult], TrialResult]


@dataclass(frozen=True, slots=True, kw_only=True)
class Walker:
    """Walks the gaits of one session in simulation, each from the same start.

    Attributes:
        spec: what the session was asked for.
        robot: who walks.
        world: the simulated world, None on a real robot.
        plan_for: the trial plan for slots.
        folder: where recordings go, or None to leave none.
        stop_requested: asked every tick.
        live: shows the walks while they go on, or None.
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

    def walk(
        self, index: int, code: int, slots: Slots, enough: Enough | None = None
    ) -> tuple[TrialResult, Path | None]:
        """Run one trial on a simulation of its own and return its result and recording."""
        plan = self.plan_for(slots)
        options = BackendOptions(
            robot=self.robot, world=self.world, failure=plan.failure, seed=self.spec.seed, trial=index
        )
        with Guard(make_servos(self.spec.backend, options)) as servos:
            return self.walk_on(servos, plan, index, code, lambda _: enough)

    def walk_on(
        self,
        servos: Guard,
        plan: TrialPlan,
        index: int,
        code: int,
        enough_of: EnoughOf,
        completed: Completed = lambda result: result,
    ) -> tuple[TrialResult, Path | None]:
        """Run one trial on connected servos and return its result, completed, and its recording."""
        recording = self._open_recording(index, code, plan)
        try:
            log = self._open_log(recording, plan, f"trial {index}: gait {code}")
            stop = self.stop_requested
            result = run_trial(servos, plan, log, stop_requested=stop, enough=enough_of(log))
            result = completed(result)
            if recording is not None:
                recording.finish(result, self._facts(index, code))
        finally:
            if recording is not None:
                recording.close()
        return result, recording.path if recording is not None else None

    def _open_log(self, recording: Recording | None, plan: TrialPlan, title: str) -> TickLog:
        """Return a log whose rows are recorded, shown, both or neither."""
        live = self.live
        if live is None:
            at_once = BLOCK_TICKS if self.spec.simulated else PACED_BLOCK_TICKS
            return TickLog(recording.write_block if recording else None, at_once)
        live.begin(self.robot, plan, title=title, looks=self.spec.robot)

        def sink(log: TickLog, start: int, stop: int) -> None:
            if recording is not None:
                recording.write_block(log, start, stop)
            live.write_block(log, start, stop)

        return TickLog(sink, live.block_ticks)

    def _open_recording(self, index: int, code: int, plan: TrialPlan) -> Recording | None:
        if self.folder is None:
            return None
        floor = make_floor(self.world, self.spec.seed) if self.world is not None else None
        path = _new_path(self.folder, index)
        title = f"trial {index}: gait {code}"
        return Recording(path, self.robot, plan, title=title, floor=floor, meshes=self.meshes)

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


def _new_path(folder: Path, index: int) -> Path:
    """Return a path that no recording has; a trial that was cut off keeps its own."""
    folder.mkdir(parents=True, exist_ok=True)
    path, number = folder / f"trial-{index:03d}.rrd", 2
    while path.exists():
        path, number = folder / f"trial-{index:03d}-{number}.rrd", number + 1
    return path
