"""A recorded trial, read back from its .rrd file as arrays."""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.clock import PERIOD_S
from hexctl.control.trace import PHASES
from hexctl.errors import HexctlError, InputError
from hexctl.recording import paths
from hexctl.recording.rrd import check_name
from hexctl.recording.rrd_reader import entity_of, read_chunks
from hexctl.recording.series import ACTION, ORIENTATION, SENSORS, SERVOS, SUSPICION, VECTORS, Series
from hexctl.robot.formats.json_model import robot_from_json
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wxyz
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray

Rows = NDArray[np.int64]

#: State of a leg: intact, considered failed only by the walk, failed, or missing.
LEG_CONDITIONS = ("whole", "noticed", "failed", "missing")

#: Entities of a policy, below `policy/`.
POLICY_COLUMNS = ("observation", "action")

#: A body without a known position is drawn at its start, less often than every tick.
UNPOSED_GAP_NS = round(2.5 * PERIOD_S * 1e9)


@dataclass(frozen=True, slots=True, eq=False)
class Samples(ArrayFields):
    """Values at some ticks (`rows`, ascending), (N, width), NaN if unknown."""

    rows: Rows
    values: FloatArray

    def at_every_tick(self, ticks: int) -> FloatArray:
        """The values at their ticks and NaN at the others, (ticks, width)."""
        spread = np.full((ticks, self.values.shape[1]), np.nan)
        spread[self.rows] = self.values
        return spread


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """An event: its tick, its level (`INFO`, `WARN`, `ERROR`), and its text."""

    row: int
    level: str
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class RecordedTrial(ArrayFields):
    """A trial in a recording. Joint angles have an error of at most 0.007 degrees.

    Attributes:
        properties: plan and result, named as by `hexctl run --json`; only `title` for a drive or a truncated
            trial.
        stamps_ns: time of each tick since 1970, (T,).
        time_s: time since the first tick, (T,).
        walk_s: time since the walk began, (T,); 0 before it.
        phases: index in `hexctl.control.trace.PHASES`, (T,).
        commanded_rad: joint angles, (T, 18).
        measured_rad: joint angles, (T, 18).
        base_position_world: (T, 3) in m, NaN if unknown.
        base_quaternion_world: (T, 4) as w, x, y, z, NaN if unknown.
        leg_conditions: index in `LEG_CONDITIONS`, (T, 6); failed as announced to the walk or simulated.
        leg_suspicion: evidence against each leg, 1 is an alarm, 6 wide, at 10 Hz, and at ticks above 1.
        sensors: known columns of the log, by name: `foot_contacts` (0 or 1), `joint_velocities_rad_s` and
            `angular_velocity_body_rad_s` at every tick, `joint_torques_nm` and the commanded `velocity_body`
            at 10 Hz.
        servos: 18 wide, at 1 Hz, by attribute of `ServoReadings`.
        policy: `observation` and `action` of a policy, raw, at the ticks in which it walked.
        policy_names: names of their numbers.
        events: in order of time.
        floor_quaternion: (4,) as w, x, y, z.
        on_stand: whether a stand held the trunk.
        course_world: both ends of the line of travel, just above the floor, (2, 3) in m; None without one.
    """

    path: Path
    robot: Robot
    properties: dict[str, Any]
    stamps_ns: Rows
    time_s: FloatArray
    walk_s: FloatArray
    phases: Rows
    commanded_rad: FloatArray
    measured_rad: FloatArray
    base_position_world: FloatArray
    base_quaternion_world: FloatArray
    leg_conditions: Rows
    leg_suspicion: Samples
    sensors: dict[str, Samples] = field(default_factory=dict)
    servos: dict[str, Samples] = field(default_factory=dict)
    policy: dict[str, Samples] = field(default_factory=dict)
    policy_names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    events: tuple[RecordedEvent, ...] = ()
    floor_quaternion: FloatArray = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    on_stand: bool = False
    course_world: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def noticed(self) -> list[dict[str, Any]]:
        """Failures that the walk detected, named as by `hexctl run --json`."""
        return list(json.loads(self.properties.get("noticed", "[]")))

    @property
    def floor_normal_world(self) -> FloatArray:
        """Unit normal of the floor, (3,)."""
        w, x, y, z = self.floor_quaternion
        return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)])

    @property
    def posed(self) -> BoolArray:
        """Whether the position of the base is known, (T,)."""
        return np.asarray(np.isfinite(self.base_position_world).all(axis=-1))

    def row_at(self, time_s: float) -> int:
        """Last tick at or before a time of the recording; the first one before it begins."""
        return max(int(np.searchsorted(self.time_s, time_s + 1e-6, side="right")) - 1, 0)


def read_trial(path: Path | str, robot: Robot | None = None) -> RecordedTrial:
    """Trial of a recording (.rrd) of `hexctl run` or `hexctl adapt`.

        trial = hexctl.read_trial(hexctl.run(duration_s=2, record="walk.rrd").recording)
        print(trial.measured_rad[-1])

    Args:
        robot: None takes it from the recording.

    Raises InputError for a file without an intact trial, MissingExtraError without Rerun.
    """
    path = Path(path)
    check_name(path)
    columns = _Columns(path)
    times_ns, joints_rad = _joints(columns, path)
    title = columns.static("__properties", "RecordingInfo:name") or [""]
    policy_names = {name: columns.names(f"policy/{name}") for name in POLICY_COLUMNS}
    position_m, quaternion = _pose(columns)
    return RecordedTrial(
        path=path,
        robot=robot or _robot(columns, path),
        properties=columns.properties("trial") or {"title": str(title[0])},
        stamps_ns=columns.times_ns(paths.WALL_TIMELINE),
        time_s=times_ns / 1e9,
        walk_s=columns.times_ns(paths.WALK_TIMELINE) / 1e9,
        phases=columns.filled_forward(*columns.texts(paths.PHASE, "StateChange:state"), PHASES),
        commanded_rad=joints_rad[:, 0],
        measured_rad=joints_rad[:, 1],
        base_position_world=position_m,
        base_quaternion_world=quaternion,
        leg_conditions=_leg_conditions(columns),
        leg_suspicion=_without_alarm(columns.samples(SUSPICION)),
        sensors=columns.known(SENSORS),
        servos=columns.known(SERVOS),
        policy={
            name: columns.samples(Series(f"policy/{name}", "", names, ()))
            for name, names in policy_names.items()
            if names
        },
        policy_names={name: names for name, names in policy_names.items() if names},
        events=tuple(_events(columns)),
        floor_quaternion=_floor_quaternion(columns),
        on_stand=bool(columns.properties("robot").get("on_stand")),
        course_world=_course(columns),
    )


def _joints(columns: "_Columns", path: Path) -> tuple[Rows, FloatArray]:
    """Times of the ticks in ns, (T,), and commanded and measured angles of the joints, (T, 2, 18).

    Ticks without both, as after a kill or in damage, are left out, and so are other columns there.
    """
    series = [columns.numbers(one.path, "Scalars:scalars", len(one.names)) for one in VECTORS]
    ticks_ns = reduce(np.intersect1d, (times_ns for times_ns, _ in series))
    if not len(ticks_ns):
        raise InputError(f"recording: {path} has no ticks; allowed: a recording with at least one")
    columns.ticks_ns = ticks_ns
    angles_rad = [found_rad[np.searchsorted(times_ns, ticks_ns)] for times_ns, found_rad in series]
    return ticks_ns, np.stack(angles_rad, axis=1)


class _Columns:
    """The content of a file. Once its ticks are known, later rows are dropped."""

    def __init__(self, path: Path) -> None:
        self._chunks: dict[str, list[Any]] = defaultdict(list)
        self.ticks_ns: Rows = np.empty(0, dtype=np.int64)
        for batch in read_chunks(path):
            self._chunks[entity_of(batch)].append(batch)

    def rows(self, times_ns: Rows) -> Rows:
        """Row of the tick at or before each time."""
        found = np.searchsorted(self.ticks_ns, times_ns, side="right") - 1
        return np.asarray(np.clip(found, 0, len(self.ticks_ns) - 1), dtype=np.int64)

    def samples(self, series: Series) -> Samples:
        times_ns, values = self.numbers(series.path, "Scalars:scalars", len(series.names))
        there = self.of_ticks(times_ns)
        return Samples(self.rows(times_ns[there]), values[there])

    def known(self, several: Sequence[Series]) -> dict[str, Samples]:
        """Series with samples, by source."""
        found = {series.source: self.samples(series) for series in several}
        return {name: samples for name, samples in found.items() if samples.rows.size}

    def names(self, entity: str) -> tuple[str, ...]:
        """Names of the numbers of an entity, empty without it."""
        found = self.static(entity, "SeriesLines:names")
        return () if found is None else tuple(map(str, found))

    def of_ticks(self, times_ns: Rows) -> BoolArray:
        """Which times are those of ticks, and not of ticks that damage has taken."""
        return np.isin(times_ns, self.ticks_ns)

    def filled_forward(self, times_ns: Rows, states: list[str], names: tuple[str, ...]) -> Rows:
        """Index of the state at each tick, from states recorded on change, (T,)."""
        indices = np.array([names.index(state) if state in names else 0 for state in states], dtype=np.int64)
        return self.last(times_ns, indices)

    def last(self, times_ns: Rows, values: Rows) -> Rows:
        """Value at each tick, 0 before the first one, (T,)."""
        found = np.searchsorted(times_ns, self.ticks_ns, side="right")
        return np.asarray(np.concatenate([[0], values])[found])

    def numbers(self, entity: str, component: str, width: int) -> tuple[Rows, FloatArray]:
        """Times in ns, (N,), and values, (N, width), of a numeric component; damaged chunks are left out."""
        parts = [
            (times_ns, flat.reshape(-1, width))
            for times_ns, values in self._rows(entity, component)
            if (flat := np.asarray(_flat(values), dtype=float)).size == width * len(times_ns)
        ]
        return _joined(parts, np.empty((0, width)))

    def texts(self, entity: str, component: str) -> tuple[Rows, list[str]]:
        """Times in ns, (N,), and texts of a component with at most one per row; empty without one."""
        rows = [
            (int(time), next(iter(texts), ""))
            for times, values in self._rows(entity, component)
            for time, texts in zip(times, values.to_pylist(), strict=True)
        ]
        rows.sort(key=lambda row: row[0])
        return np.array([time for time, _ in rows], dtype=np.int64), [text for _, text in rows]

    def properties(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for batch in self._chunks.get(f"/__properties/{name}", ()):
            for column in set(batch.schema.names) - {"rerun.controls.RowId"}:
                for value in filter(None, batch.column(column).to_pylist()):
                    found[column] = value[0] if len(value) == 1 else value
        return dict(sorted(found.items()))

    def static(self, entity: str, component: str) -> Any:
        """Value of a static component, or None."""
        batches = [one for one in self._chunks.get(f"/{entity}", ()) if component in one.schema.names]
        return batches[0].column(component).to_pylist()[0] if batches else None

    def times_ns(self, timeline: str) -> Rows:
        """Times of all ticks on a timeline, as the commanded angles have them."""
        parts = [
            (times, np.asarray(others.cast("int64"))) for times, others in self._rows(ACTION.path, timeline)
        ]
        times_ns, others_ns = _joined(parts, np.empty(0, dtype=np.int64))
        return np.asarray(others_ns[self.of_ticks(times_ns)])

    def _rows(self, entity: str, column: str) -> Iterator[tuple[Rows, Any]]:
        for batch in self._chunks.get(f"/{entity}", ()):
            if {column, paths.TIMELINE} <= set(batch.schema.names):
                values = batch.column(column)
                times_ns = np.asarray(batch.column(paths.TIMELINE).cast("int64"))
                there = np.asarray(values.is_valid())
                if len(self.ticks_ns):
                    there &= times_ns <= self.ticks_ns[-1]
                yield times_ns[there], values.filter(there)


def _robot(columns: _Columns, path: Path) -> Robot:
    try:
        return robot_from_json(str(columns.properties("robot")["model"]))
    except (HexctlError, KeyError) as error:
        raise InputError(
            f"recording: {path} does not hold its robot; allowed: --robot FILE with it"
        ) from error


def _floor_quaternion(columns: _Columns) -> FloatArray:
    values = columns.static(paths.GROUND, "Transform3D:quaternion")
    return wxyz(np.array(values[0] if values else [0.0, 0.0, 0.0, 1.0]))


def _pose(columns: _Columns) -> tuple[FloatArray, FloatArray]:
    """Position (T, 3) and orientation (T, 4) of the base, NaN if unknown."""
    ticks = len(columns.ticks_ns)
    position_m, quaternion = np.full((ticks, 3), np.nan), np.full((ticks, 4), np.nan)
    times_ns, places_m = columns.numbers(paths.ROBOT, "Transform3D:translation", 3)
    _, quaternions = columns.numbers(paths.ROBOT, "Transform3D:quaternion", 4)
    known = _posed(times_ns, places_m) & columns.of_ticks(times_ns)
    rows = columns.rows(times_ns[known])
    position_m[rows], quaternion[rows] = places_m[known], wxyz(quaternions[known])
    alone = columns.samples(ORIENTATION)
    quaternion[alone.rows] = alone.values
    return position_m, quaternion


def _posed(times_ns: Rows, places_m: FloatArray) -> BoolArray:
    """A body without a known position is drawn at its start."""
    if not len(times_ns):
        return np.zeros(0, dtype=bool)
    rare = np.diff(times_ns, append=times_ns[-1:]) > UNPOSED_GAP_NS
    rare[-1] = rare[-2] if len(rare) > 1 else True
    at_start = (places_m[:, 0] == 0) & (places_m[:, 1] == 0)
    return np.asarray(~np.logical_and.accumulate(rare & at_start))


def _course(columns: _Columns) -> FloatArray | None:
    """Both ends of the line of travel, (2, 3); None for a trial that had none or did not begin to walk."""
    _, lines = columns.numbers(paths.COURSE, "LineStrips3D:strips", 6)
    return lines[-1].reshape(2, 3) if len(lines) else None


def _leg_conditions(columns: _Columns) -> Rows:
    """Index of the condition of each leg, (T, 6), from the labels at its foot and its hip."""
    indices = np.zeros((len(columns.ticks_ns), N_LEGS), dtype=np.int64)
    for leg in paths.LEGS:
        for entity, condition in (
            (paths.noticed_path(leg), _noticed_condition),
            (paths.foot_path(leg), _failed_condition),
        ):
            times_ns, labels = columns.texts(entity, "Points3D:labels")
            shown = columns.filled_forward(times_ns, [condition(label) for label in labels], LEG_CONDITIONS)
            indices[:, leg - 1] = np.maximum(indices[:, leg - 1], shown)
    return indices


def _noticed_condition(label: str) -> str:
    return "noticed" if label else "whole"


def _failed_condition(label: str) -> str:
    if not label:
        return "whole"
    return "missing" if label.endswith(" missing") else "failed"


def _without_alarm(samples: Samples) -> Samples:
    return Samples(samples.rows, samples.values[:, :N_LEGS])


def _events(columns: _Columns) -> Iterator[RecordedEvent]:
    times_ns, texts = columns.texts(paths.EVENTS, "TextLog:text")
    _, levels = columns.texts(paths.EVENTS, "TextLog:level")
    for row, level, text in zip(columns.rows(times_ns).tolist(), levels, texts, strict=True):
        yield RecordedEvent(row, level, text)


def _flat(values: Any) -> Any:
    while hasattr(values, "flatten") and hasattr(values.type, "value_type"):
        values = values.flatten()
    return values


def _joined(parts: list[tuple[Rows, Any]], empty: Any) -> tuple[Rows, Any]:
    if not parts:
        return np.empty(0, dtype=np.int64), empty
    times, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(times, kind="stable")
    return times[order], values[order]
