"""The log of a trial: every tick as rows of arrays, handed on in blocks."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hexctl.backends.clock import Tick
from hexctl.control.frame import TrialFrame
from hexctl.robot.joints import N_JOINTS, N_LEGS
from hexctl.robot.messages import FloatArray, JointTargets, RobotState

#: The parts of a trial, in the order in which they come.
PHASES = ("settle", "turn", "walk", "stop")

#: Name, width and type of each column; a width of 0 is a plain value per tick.
COLUMNS: tuple[tuple[str, int, type], ...] = (
    ("time_s", 0, float),
    ("late_s", 0, float),
    ("work_s", 0, float),
    ("phase", 0, int),
    ("measured_rad", N_JOINTS, float),
    ("wanted_rad", N_JOINTS, float),
    ("sent_rad", N_JOINTS, float),
    ("base_position_world", 3, float),
    ("base_quaternion_world", 4, float),
    ("foot_contacts", N_LEGS, bool),
)

FIRST_CAPACITY = 2048
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
NO_CONTACTS = np.zeros(N_LEGS, dtype=bool)


class TickLog:
    """Rows of all ticks so far; implements `hexctl.control.loop.Recorder`.

    The columns are arrays of at least `len(log)` rows; rows beyond that are not yet written.

    Attributes:
        phase: the part of the trial that the next ticks belong to, one of `PHASES`.
        frame: the trial frame, from the start of the walk on.
        pose_known: False once a tick came without a base pose; its pose columns then mean nothing.
    """

    def __init__(
        self, sink: Callable[["TickLog", int, int], None] | None = None, block_ticks: int = 500
    ) -> None:
        self.phase = PHASES[0]
        self.frame: TrialFrame | None = None
        self.pose_known = True
        self._sink = sink
        self._block_ticks = block_ticks
        self._handed_on = 0
        self._length = 0
        self._capacity = FIRST_CAPACITY
        self.columns: dict[str, Any] = {
            name: np.zeros((FIRST_CAPACITY, width) if width else FIRST_CAPACITY, dtype=kind)
            for name, width, kind in COLUMNS
        }

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, name: str) -> Any:
        """Return the written rows of a column of `COLUMNS`."""
        return self.columns[name][: self._length]

    def record(
        self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets, work_s: float
    ) -> None:
        """Keep one tick, and hand a block on when it is full."""
        row = self._length
        if row == self._capacity:
            self._grow()
        columns = self.columns
        columns["time_s"][row] = tick.time_s
        columns["late_s"][row] = tick.late_s
        columns["work_s"][row] = work_s
        columns["phase"][row] = PHASES.index(self.phase)
        columns["measured_rad"][row] = state.joint_positions_rad
        columns["wanted_rad"][row] = wanted_rad
        columns["sent_rad"][row] = sent.positions_rad
        if state.base_position_world is None or state.base_quaternion_world is None:
            self.pose_known = False
            columns["base_quaternion_world"][row] = UPRIGHT
        else:
            columns["base_position_world"][row] = state.base_position_world
            columns["base_quaternion_world"][row] = state.base_quaternion_world
        columns["foot_contacts"][row] = NO_CONTACTS if state.foot_contacts is None else state.foot_contacts
        self._length += 1
        if self._sink is not None and self._length - self._handed_on >= self._block_ticks:
            self.flush()

    def flush(self) -> None:
        """Hand on what the sink has not seen yet."""
        if self._sink is not None and self._length > self._handed_on:
            self._sink(self, self._handed_on, self._length)
            self._handed_on = self._length

    def rows_of(self, phase: str) -> slice:
        """Return where the rows of a phase lie; they are always adjacent."""
        rows = np.flatnonzero(self["phase"] == PHASES.index(phase))
        return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)

    def _grow(self) -> None:
        self._capacity *= 2
        for name, column in self.columns.items():
            self.columns[name] = np.concatenate([column, np.zeros_like(column)])
