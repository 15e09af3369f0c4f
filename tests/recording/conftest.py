"""A short simulated trial with a failed leg, and a reader of recordings."""

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.terrain import Floor
from hexctl.columns import COLUMN_NAMES
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.recording.recording import Recording
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot


@dataclass
class Trial:
    robot: Robot
    plan: TrialPlan
    floor: Floor
    log: TickLog
    result: TrialResult

    def with_columns(self, **columns: np.ndarray) -> "Trial":
        """The trial with other columns in its log."""
        log = TickLog()
        log.frame = self.log.frame
        log.extend({name: columns.get(name, self.log[name]) for name in COLUMN_NAMES})
        return replace(self, log=log)


def make_plan(robot: Robot, **changes: Any) -> TrialPlan:
    return TrialPlan(gait=make_gait(robot, "demo"), **changes)


@pytest.fixture(scope="session")
def trial() -> Trial:
    robot = load_robot("ant")
    plan = make_plan(robot, failures=(Failure(leg=5),), duration_s=3.0)
    log = TickLog()
    with SimServos(robot, failures=plan.failures) as servos:
        result = run_trial(Guard(servos), plan, recorders=(log,))
        floor = servos.compiled.floor
    return Trial(robot, plan, floor, log, result)


def write(path: Path, trial: Trial, block_ticks: int | None = None) -> Path:
    """Record a finished trial, in blocks or in one piece."""
    ticks = len(trial.log)
    with Recording(path, trial.robot, trial.plan, title="a trial", floor=trial.floor) as recording:
        for start in range(0, ticks, block_ticks or ticks):
            recording.write_block(trial.log, start, min(start + (block_ticks or ticks), ticks))
        recording.finish(trial.result, {"world": "flat", "seed": 0})
    return path


class ReadBack:
    """All columns of a recording, by entity and component, with chunks joined in the order of time."""

    def __init__(self, path: Path) -> None:
        import rerun as rr

        reader = rr.chunk.RrdReader(path)
        self.recordings, self.blueprints = reader.recordings(), reader.blueprints()
        self._chunks: dict[str, list[Any]] = defaultdict(list)
        for chunk in reader.stream().to_chunks():
            self._chunks[chunk.entity_path].append(chunk.to_record_batch())

    @property
    def entities(self) -> set[str]:
        return set(self._chunks)

    def values(self, entity: str, component: str) -> list[Any]:
        """The component's value per row, static ones included."""
        return [value for _, value in self.rows(entity, component)]

    def times_s(self, entity: str, component: str, timeline: str = "trial_time") -> np.ndarray:
        times = [time for time, _ in self.rows(entity, component, timeline) if time is not None]
        return np.array(times, dtype="int64") / 1e9

    def time_type(self, entity: str, timeline: str) -> Any:
        """Type of an entity's times on a timeline."""
        schemas = [batch.schema for batch in self._chunks[entity]]
        return next(schema.field(timeline).type for schema in schemas if timeline in schema.names)

    def rows(self, entity: str, component: str, timeline: str = "trial_time") -> list[tuple[int | None, Any]]:
        """Times, None of static values, and values of a component in the order of time."""
        rows: list[tuple[int | None, Any]] = []
        for batch in self._chunks[entity]:
            if component not in batch.schema.names:
                continue
            values = batch.column(component).to_pylist()
            if timeline in batch.schema.names:
                times = batch.column(timeline).cast("int64").to_pylist()
                rows += zip(times, values, strict=True)
            else:
                rows += [(None, value) for value in values]
        return sorted((row for row in rows if row[1] is not None), key=lambda row: row[0] or 0)

    def temporal(self) -> dict[tuple[str, str], Any]:
        """Times and values of everything that changes over time, by entity and component."""
        found = {}
        for entity, batches in self._chunks.items():
            names = {name for batch in batches for name in batch.schema.names if ":" in name}
            for name in names:
                rows = [row for row in self.rows(entity, name) if row[0] is not None]
                if rows:
                    found[entity, name] = rows
        return found
