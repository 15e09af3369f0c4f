"""Rows that grow: the newest in memory, older ones in a file, and all of them as they were appended."""

import copy
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from errno import ENOSPC
from typing import Any

import numpy as np
import pytest

from hexctl.control.table import KEPT_CHUNKS, NUMBERS, Column, ServoRows, Table
from hexctl.types import N_JOINTS, ServoReadings

COLUMNS = (
    Column("time_s"),
    Column("joints", (3,)),
    Column("feet", (2,), kind=bool),
    Column("phase", kind=int),
)


CHUNK = 8


ROWS = CHUNK * (KEPT_CHUNKS + 5) + 3


def append(store: Table, count: int = ROWS) -> None:
    for index in range(len(store), len(store) + count):
        arrays, row, _ = store.append()
        arrays["time_s"][row] = index / 50
        arrays["joints"][row] = index, -index, np.nan
        arrays["feet"][row] = index % 2, index % 3
        arrays["phase"][row] = index


def check(store: Table, start: int, stop: int) -> None:
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
        append(store, rows - len(store))
        assert len(store) == rows
        check(store, 0, rows)
    assert on_disk(store) == len(store._chunks) - KEPT_CHUNKS
    for start, stop in (
        (0, 1),
        (CHUNK - 1, CHUNK + 1),
        (3, len(store)),
        (len(store) - 1, len(store)),
        (7, 7),
    ):
        check(store, start, stop)
    assert store.rows("joints", 0, 1).flags.writeable


@pytest.mark.parametrize("how", [copy.deepcopy, lambda store: pickle.loads(pickle.dumps(store))])  # noqa: S301
def test_a_copy_has_all_rows_and_lives_alone(how: object) -> None:
    store = Table(COLUMNS, chunk_rows=CHUNK)
    append(store)
    rows = len(store)
    again = how(store)  # type: ignore[operator]
    append(store)
    assert len(again) == rows
    append(again)
    check(again, 0, rows + ROWS)
    check(store, 0, rows + ROWS)


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
    append(store)
    in_file = on_disk(store)
    monkeypatch.setattr(os, "pwritev", write)
    append(store)
    assert on_disk(store) == in_file > 0
    check(store, 0, 2 * ROWS)
    assert [record.levelname for record in caplog.records] == ["WARNING"]


BROKEN_DISK = """
import os
from hexctl.control.table import Column, Table

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
        name: np.arange(N_JOINTS) + 100.0 * index + place for place, name in enumerate(NUMBERS)
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
    assert on_disk(rows._numbers) == len(rows._numbers._chunks) - KEPT_CHUNKS > 0
    assert len({id(errors) for errors in rows._errors}) == 3
