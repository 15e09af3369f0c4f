"""The log of a trial: every tick as rows of arrays, in blocks for recorders, and as columns of a table."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from hexctl.backends.base import LegServos, failures_in_force
from hexctl.backends.clock import Tick
from hexctl.columns import COLUMN_NAMES, COLUMNS, SENSED, Column
from hexctl.control.controllers import Controller
from hexctl.control.table import ServoRows, Table
from hexctl.control.telemetry_watch import SeenWarnings
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.errors import InputError, MissingExtraError, check_type
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray, JointTargets, RobotState

#: Ticks of a block in a simulated walk: one second.
BLOCK_TICKS = 50

#: Ticks of a block in a real-time walk: the work of a second is spread over its ticks.
PACED_BLOCK_TICKS = 1

#: Ticks between two recorded readings of single servos: one second.
SERVO_TICKS = 50


@dataclass(frozen=True, slots=True)
class LegChange:
    """A tick in which the set of failed legs changed, in the `world` or in the controller's `belief`."""

    row: int
    by: str
    before: tuple[Failure, ...]
    failures: tuple[Failure, ...]

    @property
    def differences(self) -> list[tuple[int, Failure | None]]:
        """Legs that changed, 1..6, and their failures now; None for an intact leg."""
        before, now = ({one.leg: one for one in failures} for failures in (self.before, self.failures))
        return [(leg, now.get(leg)) for leg in sorted({*before, *now}) if before.get(leg) != now.get(leg)]


class TickLog:
    """Rows of all ticks of a trial so far; the last minutes are in memory.

    `log[name]` is a column of `COLUMNS`, or one that the controller adds, for all T ticks: (T,) or
    (T, width); unknown values are NaN. Given to `run_trial` as a recorder, a log is filled tick by tick.

    Attributes:
        phase: of the next ticks, one of `PHASES`.
        frame: the trial frame, from the start of the walk on.
        posed_from: the first row with a base position, None before any.
        walk_from: the first row of the walk, None before it.
        notes: rows and texts of events, such as new warnings of the robot.
        servo_rows: rows and reports of single servos, once a second.
        own_columns: those that the controller of a walk adds, from the row `own_from` on.
    """

    def __init__(self) -> None:
        self.controller: Controller | None = None
        self.phase = PHASES[0]
        self.frame: TrialFrame | None = None
        self.posed_from: int | None = None
        self.walked_ticks = 0
        self.walk_from: int | None = None
        self.notes: list[tuple[int, str]] = []
        self._warnings = SeenWarnings()
        self.leg_changes: list[LegChange] = []
        self.servo_rows = ServoRows()
        self._failures_by: dict[str, tuple[Failure, ...]] = {}
        self._rows = Table(COLUMNS)
        self.own_columns: tuple[Column, ...] = ()
        self._own_rows, self.own_from = Table(()), 0

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, name: str) -> Any:
        """All rows of a column; raises KeyError with the allowed names."""
        names = (*COLUMN_NAMES, *(column.name for column in self.own_columns))
        if name not in names:
            raise KeyError(f"{name}; allowed: {', '.join(names)}")
        return self.rows(name, 0, len(self))

    def __repr__(self) -> str:
        times_s = self["time_s"]
        lasted_s = float(times_s[-1] - times_s[0]) if len(self) else 0.0
        return f"TickLog({len(self)} ticks, {lasted_s:.2f} s)"

    def to_frame(self) -> Any:
        """The log as a `pandas.DataFrame`, a row per tick.

        Columns have the names of exported CSV and Parquet files: `time_s` since the first tick, `walk_s`
        since the walk began (0 before), `phase` in words, `commanded_leg1_coxa_rad` (sent),
        `measured_..._rad`, `torque_..._nm`, `velocity_..._rad_s`, `wanted_..._rad` (before the guard),
        `base_x_m`, `base_qw`, `angular_velocity_x_rad_s`, `contact_leg1`, `suspicion_leg1`,
        `commanded_forward_m_s`, `late_s` and `work_s`. Unknown values are NaN, or NA in the `boolean`
        columns of contacts.

        Raises MissingExtraError without pandas (extra `data`).
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise MissingExtraError("a data frame", "data") from error
        values = {name: self[name] for name in COLUMN_NAMES}
        time_s, walk_s = values["time_s"], np.zeros(len(self))
        if self.walk_from is not None:
            walk_s = np.maximum(0.0, time_s - time_s[self.walk_from])
        values |= {"time_s": time_s - time_s[:1], "walk_s": walk_s}
        truths = {name: "boolean" for column in COLUMNS if column.kind is bool for name in column.fields}
        return pandas.DataFrame(frame_columns(values)).astype(truths)

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Rows [start, stop) of a column; NaN in those of a controller's column before its first tick."""
        if name in COLUMN_NAMES:
            return self._rows.rows(name, start, stop)
        own = self._own_rows.rows(name, max(0, start - self.own_from), max(0, stop - self.own_from))
        before = np.full((min(stop, len(self)) - start - len(own), *own.shape[1:]), np.nan)
        return np.concatenate([before, own])

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        """Append one tick."""
        index = len(self)
        if new := self._warnings.take(state.warnings):
            self.note([f"servos: {text}" for text in new])
        columns, row, _ = self._rows.append()
        columns["time_s"][row] = tick.time_s
        columns["late_s"][row] = tick.late_s
        columns["phase"][row] = PHASES.index(self.phase)
        columns["requested_rad"][row] = requested_rad
        columns["commanded_rad"][row] = sent.joint_positions_rad
        for column in SENSED:
            if (values := getattr(state, column.source)) is not None:
                columns[column.name][row] = values
        if state.base_position_world is not None and self.posed_from is None:
            self.posed_from = index
        if state.servos is not None and index % SERVO_TICKS == 0:
            self.servo_rows.append(index, state.servos)
        if self.controller is not None:
            if (velocity_body := self.controller.velocity_body) is not None:
                columns["velocity_body"][row] = velocity_body
            if (leg_suspicion := self.controller.leg_suspicion) is not None:
                columns["leg_suspicion"][row] = leg_suspicion
            if self.controller.own_columns or self.own_columns:
                self._record_own(index, self.controller)
        if self.phase == "walk":
            self.walk_from = index if self.walk_from is None else self.walk_from
            self.walked_ticks += 1

    def _record_own(self, index: int, controller: Controller) -> None:
        if not self.own_columns:
            self.own_columns, self.own_from = controller.own_columns, index
            self._own_rows = Table(self.own_columns)
        arrays, row, _ = self._own_rows.append()
        if controller.own_columns == self.own_columns:
            for name, values in controller.own_values.items():
                arrays[name][row] = values

    def note(self, texts: Sequence[str]) -> None:
        """Note events of the next recorded tick."""
        self.notes += [(len(self), text) for text in texts]

    def note_events(self, servos: LegServos) -> None:
        """Note changes of the failed legs in the world and in the controller's belief, and its news."""
        self.note_failures("world", failures_in_force(servos))
        if self.controller is not None:
            self.note_failures("belief", self.controller.known_failures())
            self.note(self.controller.news())

    def note_failures(self, by: str, failures: tuple[Failure, ...] | None) -> None:
        """Note a change of the failed legs in `world` or `belief` at the next tick; None is unknown."""
        if failures is not None and failures != self._failures_by.get(by):
            before = self._failures_by.get(by, ())
            self._failures_by[by] = failures
            self.leg_changes.append(LegChange(len(self), by, before, failures))

    def extend(self, rows: Mapping[str, Any]) -> None:
        """Append rows that another process recorded, all columns of `COLUMNS`."""
        count, done = len(rows["time_s"]), 0
        posed = np.flatnonzero(np.isfinite(rows["base_position_world"]).all(axis=-1))
        if self.posed_from is None and posed.size:
            self.posed_from = len(self) + int(posed[0])
        while done < count:
            columns, row, fits = self._rows.append(count - done)
            for name in COLUMN_NAMES:
                columns[name][row : row + fits] = rows[name][done : done + fits]
            done += fits
        walked = np.flatnonzero(rows["phase"] == PHASES.index("walk"))
        if self.walk_from is None and walked.size:
            self.walk_from = len(self) - count + int(walked[0])
        self.walked_ticks += walked.size

    def took(self, work_s: float) -> None:
        """Set the duration of the last tick's work, recording included."""
        columns, row = self._rows.last()
        columns["work_s"][row] = work_s

    def rows_of(self, phase: str) -> slice:
        """Rows of a phase; they are always adjacent."""
        rows = np.flatnonzero(self["phase"] == PHASES.index(phase))
        return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)


@runtime_checkable
class Recorder(Protocol):
    """Takes the ticks of a trial in blocks."""

    @property
    def block_ticks(self) -> int | None:
        """Ticks between two calls, or None to leave it to the trial's pace."""

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Take rows [start, stop) of the log; blocks come in order and without gaps."""


@dataclass(frozen=True, slots=True)
class RecorderFailure:
    """A recorder that raised, and its error; it gets no further ticks."""

    recorder: Recorder
    error: Exception


class Recorders:
    """The recorders of one trial. A failed one affects neither the others nor the robot."""

    def __init__(self, *recorders: "Recorder | TickLog", block_ticks: int = BLOCK_TICKS) -> None:
        """Take recorders, at most one `TickLog` to fill, and the default size of a block."""
        for recorder in recorders:
            check_type(recorder, (TickLog, Recorder), "recorders", "TickLogs and Recorders")
        logs = [recorder for recorder in recorders if isinstance(recorder, TickLog)]
        if len(logs) > 1:
            raise InputError(f"recorders: got {len(logs)} logs; allowed: one")
        self.log = logs[0] if logs else TickLog()
        self.failures: list[RecorderFailure] = []
        self._active = [
            _Active(recorder, recorder.block_ticks or block_ticks, len(self.log))
            for recorder in recorders
            if not isinstance(recorder, TickLog)
        ]
        self._due_at = self._next_due()

    @classmethod
    def of(cls, recorders: "Recorders | Sequence[Recorder | TickLog]") -> "Recorders | None":
        """The recorders given, or None without any."""
        if isinstance(recorders, Recorders):
            return recorders
        check_type(recorders, Sequence, "recorders", "a sequence of recorders, or Recorders")
        return cls(*recorders) if recorders else None

    def begin_phase(self, phase: str, frame: TrialFrame | None) -> None:
        """Assign the next ticks to a phase; the frame is known from the walk on."""
        self.log.phase, self.log.frame = phase, frame

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        """Append a tick to the log, and pass full blocks on."""
        self.log.record(tick, state, requested_rad, sent)
        if len(self.log) >= self._due_at:
            self._hand_on(whole_blocks=True)

    def took(self, work_s: float) -> None:
        """Set the duration of the last tick's work."""
        self.log.took(work_s)

    def flush(self) -> None:
        """Pass on what each recorder has not seen yet."""
        self._hand_on(whole_blocks=False)

    def error_of(self, recorder: "Recorder | None") -> Exception | None:
        """The error of a recorder, or None."""
        return next((failure.error for failure in self.failures if failure.recorder is recorder), None)

    def _hand_on(self, *, whole_blocks: bool) -> None:
        stop = len(self.log)
        for active in list(self._active):
            waiting = stop - active.done
            if waiting == 0 or (whole_blocks and waiting < active.block_ticks):
                continue
            start, active.done = active.done, stop
            try:
                active.recorder.write_block(self.log, start, stop)
            except Exception as error:  # noqa: BLE001  whatever it is, the robot must come to a stand
                self.failures.append(RecorderFailure(active.recorder, error))
                self._active.remove(active)
        self._due_at = self._next_due()

    def _next_due(self) -> float:
        """Length of the log at which the next block is full."""
        return min((active.done + active.block_ticks for active in self._active), default=math.inf)


@dataclass(slots=True)
class _Active:
    recorder: Recorder
    block_ticks: int
    done: int


def frame_columns(values: Mapping[str, Any]) -> dict[str, Any]:
    """Columns (T,) of a data frame by name, in the order of `COLUMNS`; missing optional ones are NaN.

    Truths are masked arrays of bools, so that their type does not depend on what is unknown.
    """
    ticks, frame = len(values["time_s"]), dict[str, Any]()
    for column in COLUMNS:
        each = values.get(column.name)
        if each is None and not column.optional:
            continue
        if each is None:
            each = np.full((ticks, *column.shape), np.nan)
        if column.name == "phase":
            each = np.array(PHASES)[each]
        if column.kind is bool:
            each = np.ma.array(each > 0, mask=np.isnan(each))
        frame |= dict(zip(column.fields, each.reshape(ticks, len(column.fields)).T, strict=True))
        if column.name == "time_s":
            frame["walk_s"] = values["walk_s"]
    return frame
