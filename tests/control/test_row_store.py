"""Rows that grow: the newest in memory, older ones in a file, and all of them as they were appended."""

import copy
import pickle
from pathlib import Path

import numpy as np
import pytest

from hexctl.control import row_store
from hexctl.control.row_store import KEPT_CHUNKS, RowStore
from hexctl.waiting import wait_for

COLUMNS = (("time_s", 0, float), ("joints", 3, float), ("feet", 2, bool), ("phase", 0, int))
CHUNK = 8
ROWS = CHUNK * (KEPT_CHUNKS + 5) + 3


def append(store: RowStore, count: int = ROWS) -> None:
    for index in range(len(store), len(store) + count):
        arrays, row = store.append()
        arrays["time_s"][row] = index / 50
        arrays["joints"][row] = index, -index, np.nan
        arrays["feet"][row] = index % 2, index % 3
        arrays["phase"][row] = index


def check(store: RowStore, start: int, stop: int) -> None:
    index = np.arange(start, stop)
    np.testing.assert_array_equal(store.rows("time_s", start, stop), index / 50)
    joints = np.stack([index, -index, np.full(len(index), np.nan)], axis=-1)
    np.testing.assert_array_equal(store.rows("joints", start, stop), joints)
    np.testing.assert_array_equal(
        store.rows("feet", start, stop), np.stack([index % 2, index % 3], axis=-1) > 0
    )
    np.testing.assert_array_equal(store.rows("phase", start, stop), index)


def in_memory(store: RowStore) -> int:
    return sum(isinstance(chunk, dict) for chunk in store._chunks)


def wait_until_written(store: RowStore) -> None:
    """Append until nothing older waits: the disk may have been busy when it was due."""
    wait_for(lambda: store._writer is None or not store._writer.is_alive(), 60, "the writer does not end")
    append(store, CHUNK)
    wait_for(lambda: in_memory(store) <= KEPT_CHUNKS, 60, "older rows stay in memory")


@pytest.mark.parametrize("rows", [0, 1, CHUNK, CHUNK + 1, ROWS])
def test_rows_are_as_they_were_appended(rows: int) -> None:
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    append(store, rows)
    assert len(store) == rows
    check(store, 0, rows)


def test_older_rows_are_in_a_file_and_the_same() -> None:
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    append(store)
    wait_until_written(store)
    assert in_memory(store) <= KEPT_CHUNKS < len(store._chunks)
    for start, stop in (
        (0, 1),
        (CHUNK - 1, CHUNK + 1),
        (3, len(store)),
        (len(store) - 1, len(store)),
        (7, 7),
    ):
        check(store, start, stop)
    assert store.rows("joints", 0, 1).flags.writeable


def test_rows_appended_together_are_those_appended_one_by_one() -> None:
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    done = 0
    while done < ROWS:
        arrays, row, fits = store.append_some(ROWS - done)
        index = np.arange(done, done + fits)
        arrays["time_s"][row : row + fits] = index / 50
        arrays["joints"][row : row + fits, 0] = index
        done += fits
    np.testing.assert_array_equal(store.rows("time_s", 0, ROWS), np.arange(ROWS) / 50)
    np.testing.assert_array_equal(store.rows("joints", 0, ROWS)[:, 0], np.arange(ROWS))
    assert np.isnan(store.rows("joints", 0, ROWS)[:, 1]).all()


@pytest.mark.parametrize("how", [copy.deepcopy, lambda store: pickle.loads(pickle.dumps(store))])  # noqa: S301
def test_a_copy_has_all_rows_and_lives_alone(how: object) -> None:
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    append(store)
    wait_until_written(store)
    rows = len(store)
    again = how(store)  # type: ignore[operator]
    append(store)
    assert len(again) == rows
    append(again)
    check(again, 0, rows + ROWS)
    check(store, 0, rows + ROWS)


def test_what_the_disk_does_not_take_stays_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> object:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(row_store, "_nameless_file", full)
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    append(store)
    assert in_memory(store) == len(store._chunks)
    check(store, 0, ROWS)


def test_a_folder_that_is_not_there_is_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(row_store, "FOLDER", str(tmp_path / "none"))
    store = RowStore(COLUMNS, chunk_rows=CHUNK)
    append(store)
    wait_until_written(store)
    check(store, 0, len(store))
