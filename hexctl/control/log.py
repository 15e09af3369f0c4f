"""The log of a trial: every tick as rows of arrays, handed on in blocks."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hexctl.backends.clock import Tick
from hexctl.control.trace import TrialFrame
from hexctl.types import N_JOINTS, N_LEGS, FloatArray, JointTargets, RobotState

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

#: Rows that are handed on together: a second.
BLOCK_TICKS = 50

#: A walk that keeps time hands on every tick: what is to be done for a second is then done bit by bit.
PACED_BLOCK_TICKS = 1

#: Rows of one chunk; a full one is never copied, so that a long walk costs no tick its time.
CHUNK_ROWS = 2048


class TickLog:
    """Rows of all ticks so far; implements `hexctl.control.loop.Recorder`.

    `log[name]` gives all rows of a column of `COLUMNS`; positions and orientations are nan where the robot
    did not know them.

    Attributes:
        phase: the part of the trial that the next ticks belong to, one of `PHASES`.
        frame: the trial frame, from the start of the walk on.
        pose_known: whether the last tick came with a base pose.
        posed_from: the first row with a base pose, None before any.
        contacts_known: whether the last tick came with foot contacts.
        walked_ticks: how many ticks belong to the walk.
        sink_error: what went wrong in the sink, which is then left alone: a robot in mid-stride comes first.
    """

    def __init__(
        self, sink: Callable[["TickLog", int, int], None] | None = None, block_ticks: int = BLOCK_TICKS
    ) -> None:
        self.phase = PHASES[0]
        self.frame: TrialFrame | None = None
        self.pose_known = True
        self.posed_from: int | None = None
        self.contacts_known = True
        self.walked_ticks = 0
        self.sink_error: Exception | None = None
        self._sink = sink
        self._block_ticks = block_ticks
        self._handed_on = 0
        self._length = 0
        self._chunks: list[dict[str, Any]] = []

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, name: str) -> Any:
        """Return the rows of a column."""
        return self.rows(name, 0, self._length)

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Return rows [start, stop) of a column."""
        if not self._chunks:
            return _new_chunk()[name][:0]
        first = min(start // CHUNK_ROWS, len(self._chunks) - 1)
        last = min(max(stop - 1, start) // CHUNK_ROWS, len(self._chunks) - 1)
        parts = [chunk[name] for chunk in self._chunks[first : last + 1]]
        joined = parts[0] if len(parts) == 1 else np.concatenate(parts)
        return joined[start - first * CHUNK_ROWS : stop - first * CHUNK_ROWS]

    def record(self, tick: Tick, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
        """Keep one tick, and hand a block on when it is full."""
        row = self._length % CHUNK_ROWS
        if row == 0:
            self._chunks.append(_new_chunk())
        columns = self._chunks[-1]
        columns["time_s"][row] = tick.time_s
        columns["late_s"][row] = tick.late_s
        columns["phase"][row] = PHASES.index(self.phase)
        columns["measured_rad"][row] = state.joint_positions_rad
        columns["wanted_rad"][row] = wanted_rad
        columns["sent_rad"][row] = sent.positions_rad
        self.pose_known = state.base_position_world is not None and state.base_quaternion_world is not None
        if self.pose_known:
            columns["base_position_world"][row] = state.base_position_world
            columns["base_quaternion_world"][row] = state.base_quaternion_world
            self.posed_from = self._length if self.posed_from is None else self.posed_from
        self.contacts_known = state.foot_contacts is not None
        if self.contacts_known:
            columns["foot_contacts"][row] = state.foot_contacts
        self.walked_ticks += self.phase == "walk"
        self._length += 1
        if self._length - self._handed_on >= self._block_ticks:
            self.flush()

    def extend(self, rows: Mapping[str, Any]) -> None:
        """Keep rows that another process recorded, all columns of `COLUMNS`, and hand them on."""
        count, done = len(rows["time_s"]), 0
        posed = np.flatnonzero(np.isfinite(rows["base_position_world"]).all(axis=-1))
        if self.posed_from is None and posed.size:
            self.posed_from = self._length + int(posed[0])
        while done < count:
            row = self._length % CHUNK_ROWS
            if row == 0:
                self._chunks.append(_new_chunk())
            fits = min(count - done, CHUNK_ROWS - row)
            for name, _, _ in COLUMNS:
                self._chunks[-1][name][row : row + fits] = rows[name][done : done + fits]
            self._length += fits
            done += fits
        self.walked_ticks += int((rows["phase"] == PHASES.index("walk")).sum())
        self.flush()

    def took(self, work_s: float) -> None:
        """Keep how long the last tick's work took, its recording included."""
        last = self._length - 1
        self._chunks[-1]["work_s"][last % CHUNK_ROWS] = work_s

    def flush(self) -> None:
        """Hand on what the sink has not seen yet."""
        if self._sink is None or self._length == self._handed_on:
            return
        try:
            self._sink(self, self._handed_on, self._length)
        except Exception as error:  # noqa: BLE001  whatever it is, the robot must come to a stand
            self.sink_error, self._sink = error, None
        self._handed_on = self._length

    def rows_of(self, phase: str) -> slice:
        """Return where the rows of a phase lie; they are always adjacent."""
        rows = np.flatnonzero(self["phase"] == PHASES.index(phase))
        return slice(int(rows[0]), int(rows[-1]) + 1) if rows.size else slice(0, 0)


def _new_chunk() -> dict[str, Any]:
    """Return empty rows; what a tick does not fill in is nan or False."""
    return {
        name: np.full(
            (CHUNK_ROWS, width) if width else CHUNK_ROWS, np.nan if kind is float else 0, dtype=kind
        )
        for name, width, kind in COLUMNS
    }
