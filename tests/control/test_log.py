"""The log of a trial and its rows: every tick is kept, handed on once and in order; and the trial frame."""

import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from errno import ENOSPC
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import InputError, JointTargets, MissingExtraError, Recorders, RobotState
from hexctl.backends.clock import Tick
from hexctl.columns import READINGS, Column
from hexctl.control.log import TickLog
from hexctl.control.table import CACHED_CHUNKS, CHUNK_ROWS, ServoRows, Table
from hexctl.control.trace import PHASES, TrialFrame
from hexctl.types import JOINT_NAMES, N_JOINTS, ServoReadings
from tests.trials import Calling


def _record(log: TickLog | Recorders, index: int, *, posed: bool = True) -> None:
    state = RobotState(
        np.full(18, index + 0.1),
        0.02 * index,
        measured=True,
        base_position_world=np.full(3, index + 0.2) if posed else None,
        base_quaternion_world=np.array([1.0, 0.0, 0.0, 0.0]) if posed else None,
        foot_contacts=np.arange(6) == index % 6,
    )
    sent = JointTargets(np.full(18, index + 0.4), 0.02 * index)
    log.record(Tick(index, 0.02 * index, 1e-4 * index), state, np.full(18, index + 0.3), sent)
    log.took(2e-5)


def test_every_tick_is_kept_as_it_came_however_many_there_are() -> None:
    log, ticks = TickLog(), 2 * CHUNK_ROWS + 5
    for index in range(ticks):
        _record(log, index)
    expected = np.arange(ticks, dtype=float)
    assert len(log) == ticks
    np.testing.assert_array_equal(log["time_s"], 0.02 * expected)
    np.testing.assert_array_equal(log["late_s"], 1e-4 * expected)
    assert (log["work_s"] == 2e-5).all()
    for column, added in (
        ("measured_rad", 0.1),
        ("base_position_world", 0.2),
        ("requested_rad", 0.3),
        ("commanded_rad", 0.4),
    ):
        np.testing.assert_array_equal(log[column][:, 0], expected + added)
    np.testing.assert_array_equal(log["foot_contacts"].argmax(axis=-1), expected % 6)


def test_what_is_missing_has_no_numbers() -> None:
    log = TickLog()
    for index, known in enumerate((True, False, True)):
        _record(log, index, posed=known)
    for part in ("base_position_world", "base_quaternion_world"):
        assert np.isnan(log[part]).all(axis=-1).tolist() == [False, True, False]
    log, stance = TickLog(), np.zeros(18)
    for touching in (np.ones(6, dtype=bool), None, np.ones(6, dtype=bool)):
        state = RobotState(stance, 0.0, measured=True, foot_contacts=touching)
        log.record(Tick(1, 0.02), state, stance, JointTargets(stance, 0.02))
    for contacts in (log["foot_contacts"][:, 2], log.to_frame()["contact_leg3"]):
        np.testing.assert_array_equal(np.asarray(contacts, float), [1, np.nan, 1])


def test_each_recorder_has_blocks_of_its_own_size() -> None:
    sizes: dict[int, list[int]] = {2: [], 5: []}
    given = [
        Calling(lambda _, first, last, size=size: sizes[size].append(last - first), block_ticks=size)  # type: ignore[misc]
        for size in sizes
    ]
    log = TickLog()
    recorders = Recorders(log, *given)
    for index in range(11):
        _record(recorders, index)
    recorders.flush()
    assert sizes == {2: [2, 2, 2, 2, 2, 1], 5: [5, 5, 1]}
    assert recorders.log is log
    assert len(log) == 11
    with pytest.raises(InputError):
        Recorders(TickLog(), TickLog())


def test_a_log_is_not_changed_by_what_happens_to_the_messages_later() -> None:
    log, wanted = TickLog(), np.zeros(18)
    state = RobotState(wanted, 0.0, measured=True)
    log.record(Tick(1, 0.02), state, wanted, JointTargets(wanted, 0.02))
    wanted[:] = 9
    assert (log["measured_rad"] == 0).all()
    assert (log["requested_rad"] == 0).all()
    assert (log["commanded_rad"] == 0).all()


def test_a_frame_has_a_row_per_tick_and_a_column_per_joint() -> None:
    log = TickLog()
    for index in range(4):
        log.phase = PHASES[0] if index < 2 else "walk"
        _record(log, index + 10, posed=index != 1)
    frame = log.to_frame()
    assert frame["time_s"].tolist() == pytest.approx([0.0, 0.02, 0.04, 0.06])
    assert frame["walk_s"].tolist() == pytest.approx([0.0, 0.0, 0.0, 0.02])
    assert frame["phase"].tolist() == [PHASES[0]] * 2 + ["walk"] * 2
    for column, name in (
        ("measured_rad", "measured"),
        ("commanded_rad", "commanded"),
        ("requested_rad", "requested"),
    ):
        for joint in ("leg1_coxa", "leg4_tibia"):
            place = JOINT_NAMES.index(joint)
            np.testing.assert_array_equal(frame[f"{name}_{joint}_rad"], log[column][:, place])
    assert frame["base_y_m"].isna().tolist() == [False, True, False, False]
    assert frame["contact_leg6"].tolist() == [(index + 10) % 6 == 5 for index in range(4)]
    assert frame["torque_leg2_femur_nm"].isna().all()
    assert list(TickLog().to_frame().columns) == list(frame.columns)


def test_an_empty_log_has_columns_without_rows_and_only_the_known_ones() -> None:
    log = TickLog()
    assert log["commanded_rad"].shape == (0, 18)
    assert log.rows_of("walk") == slice(0, 0)
    assert len(log.to_frame()) == 0
    with pytest.raises(KeyError, match="time_s"):
        log["measured"]


def test_a_frame_without_pandas_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError):
        TickLog().to_frame()


near = st.floats(-20, 20)


@given(heading=st.floats(-7, 7), progress=near, left=near, x=near, y=near)
def test_a_point_ahead_and_to_the_left_has_those_coordinates(
    heading: float, progress: float, left: float, x: float, y: float
) -> None:
    frame = TrialFrame(np.array([x, y, 0.1]), heading, 0.0)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-math.sin(heading), math.cos(heading)])
    point = np.array([x, y]) + progress * ahead + left * aside
    path = frame.path(np.array([[*point, 5.0]]))
    assert path.shape == (1, 2)
    assert path[0].tolist() == pytest.approx([progress, left], abs=1e-9)


# Rows that grow: the newest in memory, older ones in a file


COLUMNS = (
    Column("time_s"),
    Column("joints", (3,)),
    Column("feet", (2,), kind=bool),
    Column("phase", kind=int),
)


CHUNK = 8


ROWS = CHUNK * (CACHED_CHUNKS + 5) + 3


def append_rows(store: Table, count: int = ROWS) -> None:
    for index in range(len(store), len(store) + count):
        arrays, row, _ = store.append()
        arrays["time_s"][row] = index / 50
        arrays["joints"][row] = index, -index, np.nan
        arrays["feet"][row] = index % 2 > 0, index % 3 > 0
        arrays["phase"][row] = index


def check_rows(store: Table, start: int, stop: int) -> None:
    index = np.arange(start, stop)
    np.testing.assert_array_equal(store.rows("time_s", start, stop), index / 50)
    joints = np.stack([index, -index, np.full(len(index), np.nan)], axis=-1)
    np.testing.assert_array_equal(store.rows("joints", start, stop), joints)
    np.testing.assert_array_equal(
        store.rows("feet", start, stop), np.stack([index % 2, index % 3], axis=-1) > 0
    )
    np.testing.assert_array_equal(store.rows("phase", start, stop), index)


def on_disk(store: Table) -> int:
    """Chunks that are in the file."""
    return store._chunks.count(None)


def test_rows_are_as_they_were_appended_and_older_ones_in_a_file() -> None:
    store = Table(COLUMNS, chunk_rows=CHUNK)
    for rows in (0, 1, CHUNK, CHUNK + 1, ROWS):
        append_rows(store, rows - len(store))
        assert len(store) == rows
        check_rows(store, 0, rows)
    assert on_disk(store) == len(store._chunks) - CACHED_CHUNKS
    for start, stop in ((0, 1), (CHUNK - 1, CHUNK + 1), (3, ROWS), (ROWS - 1, ROWS), (7, 7)):
        check_rows(store, start, stop)
    assert store.rows("joints", 0, 1).flags.writeable


def test_a_copy_has_all_rows_and_lives_alone() -> None:
    store = Table(COLUMNS, chunk_rows=CHUNK)
    append_rows(store)
    again = pickle.loads(pickle.dumps(store))  # noqa: S301  deep copies are made alike
    append_rows(store)
    assert len(again) == ROWS
    append_rows(again)
    check_rows(again, 0, 2 * ROWS)
    check_rows(store, 0, 2 * ROWS)


def no_room(*_: object) -> int:
    raise OSError(ENOSPC, os.strerror(ENOSPC))


def no_call(*_: object) -> int:
    raise AttributeError("pwritev")


def room_for_a_part(file: int, arrays: Sequence[Any], offset: int) -> int:
    return os.pwrite(file, arrays[0], offset)


@pytest.mark.parametrize("write", [no_room, no_call, room_for_a_part])
def test_what_the_disk_does_not_take_stays_in_memory_with_one_warning(
    write: Callable[..., int], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    store = Table(COLUMNS, chunk_rows=CHUNK)
    append_rows(store)
    in_file = on_disk(store)
    monkeypatch.setattr(os, "pwritev", write)
    append_rows(store)
    assert on_disk(store) == in_file > 0
    check_rows(store, 0, 2 * ROWS)
    assert [record.levelname for record in caplog.records] == ["WARNING"]


BROKEN_DISK = """
import os
from hexctl.columns import Column
from hexctl.control.table import Table

store = Table([Column("time_s")], chunk_rows=1024)
for row in range(100 * 1024 - 10):
    arrays, place, _ = store.append()
    arrays["time_s"][place] = row
os.ftruncate(store._file.fileno(), 0)
arrays, place, _ = store.append()
arrays["time_s"][place] = 1.0
assert store.rows("time_s", len(store) - 2, len(store)).tolist() == [row, 1.0]
try:
    store.rows("time_s", 0, len(store))
except OSError:
    print("lost")
"""


def test_a_disk_that_loses_rows_raises_and_does_not_end_the_process() -> None:
    """A file that was cut stands for any failure of a disk after it had taken the rows."""
    done = subprocess.run([sys.executable, "-c", BROKEN_DISK], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "lost\n"), done.stderr


def reading(index: int) -> ServoReadings:
    values: dict[str, Any] = {
        column.name: np.arange(N_JOINTS) + 100.0 * index + place for place, column in enumerate(READINGS)
    }
    error = "overload" if 10 <= index < 20 else ""
    return ServoReadings(**values, errors=("", error) + ("",) * (N_JOINTS - 2))


def test_readings_of_servos_are_as_they_were_appended_and_mostly_not_in_memory() -> None:
    rows = ServoRows()
    for index in range(600):
        rows.append(50 * index, reading(index))
    assert rows.between(0, 30_000) == [(50 * index, reading(index)) for index in range(600)]
    assert [row for row, _ in rows.between(100, 200)] == [100, 150]
    assert [row for row, _ in rows.between(101, 201)] == [150, 200]
    assert rows.between(101, 150) == rows.between(40_000, 50_000) == ServoRows().between(0, 9) == []
    assert on_disk(rows._numbers) == len(rows._numbers._chunks) - CACHED_CHUNKS > 0
    assert len({id(errors) for errors in rows._errors}) == 3
