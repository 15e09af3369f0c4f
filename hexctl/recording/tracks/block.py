"""Rows of a tick log as Rerun columns: times, numbers, and joint angles in Arrow's layout."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.columns import SPARSE_TICKS
from hexctl.control.log import LegChange, TickLog
from hexctl.control.trace import PHASES
from hexctl.ik.support_polygon import foot_heights_body
from hexctl.recording import paths
from hexctl.recording.rrd import load_rerun
from hexctl.recording.scene import Subject
from hexctl.recording.series import Series, rounded
from hexctl.types import BoolArray, FloatArray

Rows = NDArray[np.int64] | slice

#: Resolution of the wall clock: half a second keeps its column small.
WALL_STEP_NS = 500_000_000

#: Quaternion (w, x, y, z) of a level body that faces along the x axis.
LEVEL_AHEAD = np.array([1.0, 0.0, 0.0, 0.0])

#: How long a body without an orientation is drawn in its last one: longer than a guard lets it walk.
REMEMBERED_TICKS = 300

#: A foot commanded higher than this above its stance position is in swing.
LIFTED_M = 1e-5


class Block:
    """Rows [start, stop) of a log, counted from `start`, with their times and derived quantities."""

    def __init__(
        self, stream: Any, subject: Subject, log: TickLog, start: int, stop: int, began_at_s: float
    ) -> None:
        """Take rows of a log; `began_at_s` is the wall clock at its first tick, in s since 1970."""
        self.subject, self.log, self.start, self.stop = subject, log, start, stop
        self._stream, self._rr, self._began_at_s = stream, load_rerun(), began_at_s
        self._times = self._time_columns(self.column("time_s"))

    def column(self, name: str) -> Any:
        """Rows of a column in this block."""
        return self.log.rows(name, self.start, self.stop)

    def leg_changes(self) -> list[LegChange]:
        """Changes of failed legs in this block."""
        return [change for change in self.log.leg_changes if self.start <= change.row < self.stop]

    def led(self, name: str, lead: int = 1) -> Any:
        """Rows of a column in this block, preceded by up to `lead` earlier rows."""
        return self.log.rows(name, max(self.start - lead, 0), self.stop)

    def changes(self, led: Any) -> NDArray[np.int64]:
        """Rows at which values (scalars or vectors, preceded by one row) change, and the first tick."""
        changed = led[1:] != led[:-1]
        rows = np.flatnonzero(changed if changed.ndim == 1 else changed.any(axis=-1))
        return rows if self.start else np.concatenate([[0], rows + 1])

    def without_lead(self, led: Any) -> Any:
        """Values of this block from those with earlier rows before it."""
        return led[len(led) - (self.stop - self.start) :]

    def in_walk(self) -> BoolArray:
        """Whether each row belongs to the walk, (rows,)."""
        return np.asarray(self.column("phase") == PHASES.index("walk"))

    def sparse(self, ticks: int = SPARSE_TICKS) -> NDArray[np.int64]:
        """Rows whose tick is a multiple of some ticks."""
        return np.arange(-self.start % ticks, self.stop - self.start, ticks)

    @cached_property
    def posed(self) -> BoolArray:
        """Whether the base position is known, (rows,)."""
        return posed_rows(self.log, self.start, self.stop)

    def swing(self, lead: int) -> BoolArray:
        """Whether each foot is commanded to swing, preceded by `lead` rows; none while settling."""
        robot = self.subject.robot
        height = foot_heights_body(robot, self.led("requested_rad", lead)) - robot.stance_feet_body[:, 2]
        moving = self.led("phase", lead) != PHASES.index("settle")
        return np.asarray((height > LIFTED_M) & moving[:, np.newaxis])

    @cached_property
    def standing(self) -> BoolArray:
        """Feet in contact, or commanded to stance where contacts are unknown, (rows, 6)."""
        contacts = self.column("foot_contacts")
        unknown = np.isnan(contacts)
        return np.where(unknown, ~self.swing(0), contacts > 0) if unknown.any() else contacts > 0

    @cached_property
    def quaternions(self) -> FloatArray:
        """Orientations for drawing the body, (rows, 4): if unknown the last known one, else level ahead."""
        lead = min(self.start, REMEMBERED_TICKS)
        led = self.led("base_quaternion_world", lead)
        known = np.isfinite(led[:, 0])
        last = np.maximum.accumulate(np.where(known, np.arange(len(led)), -1))
        return np.asarray(np.where((last < 0)[:, np.newaxis], LEVEL_AHEAD, led[last])[lead:])

    def send(self, path: str, rows: Rows, columns: Any) -> None:
        """Send columns for rows."""
        self._send(path, {name: times[rows] for name, times in self._times.items()}, columns)

    def plot(self, series: Series, rows: NDArray[np.int64], values: FloatArray) -> None:
        """Send numbers of a series for rows, (rows,) or (rows, numbers), except for rows without a known one.

        Other unknown numbers leave a gap in their line.
        """
        known = np.isfinite(values).reshape(rows.size, len(series.names))
        there = known.any(axis=-1)
        self.send_numbers(series, rows[there], np.where(known, values.reshape(known.shape), np.nan)[there])

    def send_numbers(self, series: Series, rows: NDArray[np.int64], values: FloatArray) -> None:
        """Send numbers of a series for rows, (rows, numbers), NaN for unknown ones; nothing for no rows."""
        if rows.size:
            scalars = self._rr.Scalars.columns(scalars=rounded(values, series.bits).ravel())
            self.send(series.path, rows, scalars.partition(np.full(rows.size, len(series.names))))

    def send_vectors(self, series: Series, values: FloatArray) -> None:
        """Send numbers of a series for all rows, with the time of day of each tick to the nanosecond."""
        times = self._time_columns(self.column("time_s"), wall_step_ns=1)
        scalars = self._rr.Scalars.columns(scalars=rounded(values, series.bits).ravel())
        self._send(series.path, times, scalars.partition(np.full(len(values), len(series.names))))

    def send_names(self, path: str, names: Sequence[str]) -> None:
        """Name the numbers of an entity; a reader finds there how many they are."""
        self._stream.log(path, self._rr.SeriesLines(names=list(names)), static=True)

    def send_states(self, path: str, led: NDArray[np.int64], names: Sequence[str]) -> None:
        """Send changes of a state, given as indices of names that are preceded by one row."""
        rows = self.changes(led)
        if rows.size:
            states = np.array(names)[self.without_lead(led)[rows]]
            self.send(path, rows, self._rr.StateChange.columns(state=states))

    def send_at(self, path: str, log_rows: Sequence[int], columns: Any) -> None:
        """Send columns for rows counted from the start of the log, even before the block."""
        times_s = np.array([self.log.rows("time_s", row, row + 1)[0] for row in log_rows])
        self._send(path, self._time_columns(times_s), columns)

    def _send(self, path: str, times: Mapping[str, Any], columns: Any) -> None:
        rr = self._rr
        indexes = [
            rr.TimeColumn(paths.WALK_TIMELINE, duration=times[paths.WALK_TIMELINE]),
            rr.TimeColumn(paths.TIMELINE, duration=times[paths.TIMELINE]),
            rr.TimeColumn(paths.WALL_TIMELINE, timestamp=times[paths.WALL_TIMELINE]),
        ]
        self._stream.send_columns(path, indexes, columns, strict=True)

    def _time_columns(self, times_s: FloatArray, wall_step_ns: int = WALL_STEP_NS) -> dict[str, Any]:
        """Times of the log's clock, (rows,), on all timelines; the walk's time is 0 before it."""
        log = self.log
        elapsed_ns = _ns(times_s - log.rows("time_s", 0, 1))
        walk_ns = np.zeros_like(elapsed_ns)
        if log.walk_from is not None:
            walk_ns = np.maximum(0, _ns(times_s - log.rows("time_s", log.walk_from, log.walk_from + 1)))
        wall_ns = (elapsed_ns + round(self._began_at_s * 1e9)) // wall_step_ns * wall_step_ns
        return {
            paths.WALK_TIMELINE: walk_ns.astype("timedelta64[ns]"),
            paths.TIMELINE: elapsed_ns.astype("timedelta64[ns]"),
            paths.WALL_TIMELINE: wall_ns.astype("datetime64[ns]"),
        }


def _ns(times_s: FloatArray) -> NDArray[np.int64]:
    return np.asarray(np.round(times_s * 1e9).astype(np.int64))


def posed_rows(log: TickLog, start: int, stop: int) -> BoolArray:
    """Whether the base position is known in rows [start, stop) of a log, (rows,)."""
    return np.asarray(np.isfinite(log.rows("base_position_world", start, stop)).all(axis=-1))


def compact(points_m: FloatArray) -> NDArray[np.float32]:
    """Points rounded to half a millimetre, which compress well."""
    return rounded(points_m, 10).astype(np.float32)


#: A positive coxa turns counter-clockwise from above; a positive femur or tibia lifts its link along x.
AXES = {"coxa": (0.0, 0.0, 1.0), "femur": (0.0, -1.0, 0.0), "tibia": (0.0, -1.0, 0.0)}


#: Binary places of drawn angles: an error of a tenth of a degree at most, less than half a step of servos.
DRAWN_BITS = 8

#: Ticks between drawn angles: 25 pictures a second.
DRAWN_TICKS = 2


@dataclass(frozen=True, slots=True)
class ArrowBatch:
    """Component values in Arrow's layout."""

    array: Any

    def as_arrow_array(self) -> Any:
        """The values, for Rerun."""
        return self.array


def turn_column(kind: str, angles_rad: FloatArray) -> Any:
    """Column of the rotation of a link of a kind in `JOINT_KINDS` by angles, (N,)."""
    import pyarrow as pa

    axes = pa.array(np.tile(np.asarray(AXES[kind], dtype=np.float32), len(angles_rad)))
    item = pa.field("item", pa.float32(), nullable=False)
    axis = pa.FixedSizeListArray.from_arrays(axes, type=pa.list_(item, 3))
    fields = [pa.field("axis", axis.type, nullable=False), pa.field("angle", pa.float32(), nullable=False)]
    turn = pa.StructArray.from_arrays([axis, pa.array(angles_rad.astype(np.float32))], fields=fields)
    rr, offsets = load_rerun(), np.arange(len(angles_rad) + 1, dtype=np.int32)
    return rr.ComponentColumn(
        rr.Transform3D.descriptor_rotation_axis_angle(), ArrowBatch(turn), offsets=offsets
    )
