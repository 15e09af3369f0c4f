"""The log of a trial: every tick as rows of arrays, in blocks for recorders, and as columns of a table."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.clock import Tick
from hexctl.control.controllers import Controller
from hexctl.control.row_store import Column, RowStore, ServoRows
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.errors import InputError, MissingExtraError, check_type
from hexctl.robot.failure import Failure
from hexctl.types import JOINT_NAMES, N_JOINTS, N_LEGS, BoolArray, FloatArray, JointTargets, RobotState

#: Name, width and type of each column; a width of 0 is a plain value per tick.
COLUMNS: tuple[Column, ...] = (
    ("time_s", 0, float),
    ("late_s", 0, float),
    ("work_s", 0, float),
    ("phase", 0, int),
    ("measured_rad", N_JOINTS, float),
    ("wanted_rad", N_JOINTS, float),
    ("commanded_rad", N_JOINTS, float),
    ("base_position_world", 3, float),
    ("base_quaternion_world", 4, float),
    ("foot_contacts", N_LEGS, bool),
    ("joint_torques_nm", N_JOINTS, float),
    ("velocity_body", 3, float),
    ("leg_suspicion", N_LEGS, float),
)

_NAMES = tuple(name for name, _, _ in COLUMNS)

#: Legs in names of columns.
LEG_NAMES = tuple(f"leg{leg}" for leg in range(1, N_LEGS + 1))

#: Ticks of a block in a walk that runs ahead of time: a second.
BLOCK_TICKS = 50

#: Ticks of a block in a walk that keeps time: the work of a second is then spread over its ticks.
PACED_BLOCK_TICKS = 1

#: Ticks between two readings of single servos that are kept: a second.
SERVO_TICKS = 50


@dataclass(frozen=True, slots=True)
class LegChange:
    """A tick in which legs were found to have failed, or to be whole again.

    Attributes:
        row: of the log. What the world does, it did since the row before.
        by: `world`, what is broken, or `belief`, what the controller takes for broken.
        before: failures until then, by leg.
        failures: failures from then on, by leg.
    """

    row: int
    by: str
    before: tuple[Failure, ...]
    failures: tuple[Failure, ...]

    @property
    def differences(self) -> list[tuple[int, Failure | None]]:
        """Legs that changed, 1..6, and how they have failed now; None for one that is whole again."""
        before, now = ({one.leg: one for one in failures} for failures in (self.before, self.failures))
        return [(leg, now.get(leg)) for leg in sorted({*before, *now}) if before.get(leg) != now.get(leg)]


class TickLog:
    """Rows of all ticks of a trial so far; those of the last minutes are in memory.

    `log[name]` gives a column for all T ticks, and `to_frame` a table of pandas. The columns are

    | name | shape | value |
    |---|---|---|
    | `time_s` | (T,) | time of the tick, on the clock of the servos |
    | `late_s` | (T,) | how much later than planned the tick began |
    | `work_s` | (T,) | how long its work took |
    | `phase` | (T,) | index in `hexctl.control.trace.PHASES` |
    | `measured_rad` | (T, 18) | joint angles that the robot reported |
    | `wanted_rad` | (T, 18) | joint angles that the controller returned |
    | `commanded_rad` | (T, 18) | joint angles that the guard let pass |
    | `base_position_world` | (T, 3) | position of the body in m |
    | `base_quaternion_world` | (T, 4) | its orientation as w, x, y, z |
    | `foot_contacts` | (T, 6) | which feet touch the floor; False if it is not measured |
    | `joint_torques_nm` | (T, 18) | torques of the actuators |
    | `velocity_body` | (T, 3) | commanded velocity: forward and left in m/s, turn in rad/s |
    | `leg_suspicion` | (T, 6) | evidence against each leg, an alarm at 1 |

    What is not known is NaN: a pose or torques that the robot does not measure, a velocity in a walk that is
    not steered, evidence in a walk that does not watch its legs. Given to `run_trial` as a recorder, a log is
    filled tick by tick.

    Attributes:
        controller: walks the next ticks, where it is known.
        phase: the part of the trial that the next ticks belong to, one of `PHASES`.
        frame: the trial frame, from the start of the walk on.
        pose_known: whether the last tick came with a base position.
        posed_from: the first row with a base position, None before any.
        contacts_known: whether the last tick came with foot contacts.
        walked_ticks: how many ticks belong to the walk.
        walk_from: the first row of the walk, None before it.
        notes: rows at which something happened, and what.
        leg_changes: which legs have failed, by the world and by the controller's belief, where that changed.
        servo_rows: what single servos reported, once a second, and the rows of those ticks.
    """

    def __init__(self) -> None:
        self.controller: Controller | None = None
        self.phase = PHASES[0]
        self.frame: TrialFrame | None = None
        self.pose_known = True
        self.posed_from: int | None = None
        self.contacts_known = True
        self.walked_ticks = 0
        self.walk_from: int | None = None
        self.notes: list[tuple[int, str]] = []
        self.leg_changes: list[LegChange] = []
        self.servo_rows = ServoRows()
        self._failures_by: dict[str, tuple[Failure, ...]] = {}
        self._rows = RowStore(COLUMNS)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, name: str) -> Any:
        """All rows of a column; raises KeyError with the names that there are."""
        if name not in _NAMES:
            raise KeyError(f"{name}; allowed: {', '.join(_NAMES)}")
        return self._rows.rows(name, 0, len(self))

    def __repr__(self) -> str:
        times_s = self["time_s"]
        lasted_s = float(times_s[-1] - times_s[0]) if len(self) else 0.0
        return f"TickLog({len(self)} ticks, {lasted_s:.2f} s)"

    def to_frame(self) -> Any:
        """The log as a `pandas.DataFrame`, a row per tick.

        Columns have the names of exported CSV and Parquet files: `time_s` since the first tick, `walk_s`
        since the walk began (0 before it), `phase` in words, and for each joint `commanded_leg1_coxa_rad`
        (sent), `measured_..._rad` and `torque_..._nm`. Body and legs have `base_x_m`, `base_qw`,
        `contact_leg1`, `suspicion_leg1` and `commanded_forward_m_s`. Further columns are `wanted_..._rad`,
        what the controller returned before the guard, `late_s` and `work_s`. What is not known is NaN.

        Raises MissingExtraError without pandas (extra `data`).
        """
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise MissingExtraError("a data frame", "data") from error
        time_s, contacts = self["time_s"], self["foot_contacts"]
        walk_s = np.zeros(len(self))
        if self.walk_from is not None:
            walk_s = np.maximum(0.0, time_s - time_s[self.walk_from])
        columns = tick_columns(
            time_s=time_s - time_s[:1],
            walk_s=walk_s,
            phases=self["phase"],
            commanded_rad=self["commanded_rad"],
            measured_rad=self["measured_rad"],
            base_position_world=self["base_position_world"],
            base_quaternion_world=self["base_quaternion_world"],
            foot_contacts=contacts if self.contacts_known or contacts.any() else None,
            torques_nm=self["joint_torques_nm"],
            velocity_body=self["velocity_body"],
            leg_suspicion=self["leg_suspicion"],
        )
        columns |= joint_columns("wanted", "rad", self["wanted_rad"])
        return pandas.DataFrame({**columns, "late_s": self["late_s"], "work_s": self["work_s"]})

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Rows [start, stop) of a column."""
        return self._rows.rows(name, start, stop)

    def record(self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
        """Append one tick."""
        index = len(self)
        columns, row = self._rows.append()
        columns["time_s"][row] = tick.time_s
        columns["late_s"][row] = tick.late_s
        columns["phase"][row] = PHASES.index(self.phase)
        columns["measured_rad"][row] = state.joint_positions_rad
        columns["wanted_rad"][row] = wanted_rad
        columns["commanded_rad"][row] = sent.joint_positions_rad
        if state.base_quaternion_world is not None:
            columns["base_quaternion_world"][row] = state.base_quaternion_world
        self.pose_known = state.base_position_world is not None
        if self.pose_known:
            columns["base_position_world"][row] = state.base_position_world
            self.posed_from = index if self.posed_from is None else self.posed_from
        self.contacts_known = state.foot_contacts is not None
        if self.contacts_known:
            columns["foot_contacts"][row] = state.foot_contacts
        if state.servos is not None and index % SERVO_TICKS == 0:
            self.servo_rows.append((index, state.servos))
        if state.joint_torques_nm is not None:
            columns["joint_torques_nm"][row] = state.joint_torques_nm
        if self.controller is not None and self.controller.velocity_body is not None:
            columns["velocity_body"][row] = self.controller.velocity_body
        if self.controller is not None and self.controller.leg_suspicion is not None:
            columns["leg_suspicion"][row] = self.controller.leg_suspicion
        if self.phase == "walk":
            self.walk_from = index if self.walk_from is None else self.walk_from
            self.walked_ticks += 1

    def note(self, texts: Sequence[str]) -> None:
        """Note what happened in the tick that is recorded next."""
        self.notes += [(len(self), text) for text in texts]

    def note_failures(self, by: str, failures: tuple[Failure, ...] | None) -> None:
        """Note which legs have failed in the tick that is recorded next, if that has changed.

        Args:
            by: `world` or `belief`, as in `LegChange`.
            failures: by leg; None where nothing is known of them.
        """
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
            columns, row, fits = self._rows.append_some(count - done)
            for name, _, _ in COLUMNS:
                columns[name][row : row + fits] = rows[name][done : done + fits]
            done += fits
        walked = np.flatnonzero(rows["phase"] == PHASES.index("walk"))
        if self.walk_from is None and walked.size:
            self.walk_from = len(self) - count + int(walked[0])
        self.walked_ticks += walked.size

    def took(self, work_s: float) -> None:
        """Set how long the work of the last tick took, its recording included."""
        columns, row = self._rows.newest()
        columns["work_s"][row] = work_s

    def rows_of(self, phase: str) -> slice:
        """Rows of a phase; they are always adjacent."""
        rows = np.flatnonzero(self["phase"] == PHASES.index(phase))
        return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)


@runtime_checkable
class Recorder(Protocol):
    """Takes the ticks of a trial in blocks.

    Attributes:
        block_ticks: ticks between two calls, or None to leave it to the trial's pace.
    """

    @property
    def block_ticks(self) -> int | None:
        """Ticks between two calls."""

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Take rows [start, stop) of the log; blocks come in order and without gaps."""


@dataclass(frozen=True, slots=True)
class RecorderFailure:
    """A recorder that raised, and what it raised. It was left out from then on."""

    recorder: Recorder
    error: Exception


class Recorders:
    """The recorders of one trial. Each fails alone: it neither silences another nor stops the robot.

    Attributes:
        log: the rows that the recorders are given.
        failures: the recorders that raised, in the order in which they did.
    """

    def __init__(self, *recorders: "Recorder | TickLog", block_ticks: int = BLOCK_TICKS) -> None:
        """Take recorders and at most one log of the caller's own.

        Args:
            recorders: what is told of the ticks; a `TickLog` keeps them all.
            block_ticks: ticks of a block for recorders that leave it open.
        """
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
        """The recorders given; None without any, so that no rows are kept unread."""
        if isinstance(recorders, Recorders):
            return recorders
        check_type(recorders, Sequence, "recorders", "a sequence of recorders, or Recorders")
        return cls(*recorders) if recorders else None

    def begin_phase(self, phase: str, frame: TrialFrame | None) -> None:
        """Count the next ticks to a phase; the frame is known from the walk on."""
        self.log.phase, self.log.frame = phase, frame

    def record(self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
        """Append a tick to the log, and hand on the blocks that are full."""
        self.log.record(tick, state, wanted_rad, sent)
        if len(self.log) >= self._due_at:
            self._hand_on(whole_blocks=True)

    def took(self, work_s: float) -> None:
        """Set how long the work of the last tick took."""
        self.log.took(work_s)

    def flush(self) -> None:
        """Hand on what each recorder has not seen yet."""
        self._hand_on(whole_blocks=False)

    def error_of(self, recorder: "Recorder | None") -> Exception | None:
        """What a recorder raised, or None."""
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
    """A recorder that still works, its block size, and the rows that it has seen."""

    recorder: Recorder
    block_ticks: int
    done: int


def tick_columns(
    *,
    time_s: FloatArray,
    walk_s: FloatArray,
    phases: NDArray[np.int64],
    commanded_rad: FloatArray,
    measured_rad: FloatArray,
    base_position_world: FloatArray,
    base_quaternion_world: FloatArray,
    foot_contacts: BoolArray | None,
    torques_nm: FloatArray,
    velocity_body: FloatArray,
    leg_suspicion: FloatArray,
) -> dict[str, Any]:
    """Columns (T,) by name, in the order of a table; NaN where a value is not known.

    Args:
        time_s: since the first tick.
        walk_s: since the walk began; 0 before it.
        phases: indices in `hexctl.control.trace.PHASES`.
        commanded_rad: joint angles that were sent, (T, 18).
        measured_rad: joint angles that came back, (T, 18).
        base_position_world: (T, 3) in m.
        base_quaternion_world: (T, 4) as w, x, y, z.
        foot_contacts: which feet touch the floor, (T, 6); None if it is not measured.
        torques_nm: of the joints, (T, 18).
        velocity_body: commanded, forward and left in m/s, turn in rad/s, (T, 3).
        leg_suspicion: evidence against each leg, (T, 6).
    """
    contacts = np.full((len(time_s), N_LEGS), np.nan) if foot_contacts is None else foot_contacts
    columns: dict[str, Any] = {"time_s": time_s, "walk_s": walk_s, "phase": np.array(PHASES)[phases]}
    columns |= joint_columns("commanded", "rad", commanded_rad)
    columns |= joint_columns("measured", "rad", measured_rad)
    columns |= {f"base_{axis}_m": base_position_world[:, place] for place, axis in enumerate("xyz")}
    columns |= {f"base_q{axis}": base_quaternion_world[:, place] for place, axis in enumerate("wxyz")}
    columns |= _named("contact", LEG_NAMES, "", contacts)
    columns |= joint_columns("torque", "nm", torques_nm)
    columns |= _named("commanded", ("forward_m_s", "left_m_s", "turn_rad_s"), "", velocity_body)
    return columns | _named("suspicion", LEG_NAMES, "", leg_suspicion)


def joint_columns(what: str, unit: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Columns of the 18 joints, such as `measured_leg1_coxa_rad`, of values (T, 18)."""
    return _named(what, JOINT_NAMES, unit, values)


def _named(what: str, names: Sequence[str], unit: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {"_".join(filter(None, (what, name, unit))): values[:, place] for place, name in enumerate(names)}
