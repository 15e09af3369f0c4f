"""Readings of single servos: as they were appended, the newest in memory."""

from typing import Any

import numpy as np
import pytest

from hexctl.control.table import KEPT_CHUNKS, NUMBERS, ServoRows
from hexctl.types import N_JOINTS, ServoReadings

TICKS = 50


def reading(index: int) -> ServoReadings:
    values: dict[str, Any] = {
        name: np.arange(N_JOINTS) + 100.0 * index + place for place, name in enumerate(NUMBERS)
    }
    values["currents_a"] = np.full(N_JOINTS, np.nan)
    complaint = "overload" if 10 <= index < 20 else ""
    return ServoReadings(**values, errors=("", complaint) + ("",) * (N_JOINTS - 2))


def same(one: ServoReadings, other: ServoReadings) -> bool:
    numbers = (np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True) for name in NUMBERS)
    return one.errors == other.errors and all(numbers)


def check(rows: ServoRows, count: int) -> None:
    found = list(rows)
    assert [row for row, _ in found] == [TICKS * index for index in range(count)]
    assert all(same(servos, reading(index)) for index, (_, servos) in enumerate(found))


def test_readings_are_as_they_were_appended() -> None:
    assert list(ServoRows()) == []
    check(ServoRows((TICKS * index, reading(index)) for index in range(25)), 25)


def test_readings_between_two_rows() -> None:
    rows = ServoRows((TICKS * index, reading(index)) for index in range(25))
    assert [row for row, _ in rows.between(100, 200)] == [100, 150]
    assert [row for row, _ in rows.between(101, 201)] == [150, 200]
    assert same(rows.between(500, 501)[0][1], reading(10))
    assert rows.between(101, 150) == rows.between(2000, 3000) == ServoRows().between(0, 10) == []


@pytest.mark.slow
def test_an_hour_of_readings_is_not_in_memory() -> None:
    rows = ServoRows()
    for index in range(3600):
        rows.append((TICKS * index, reading(index)))
    assert sum(chunk is not None for chunk in rows._numbers._chunks) == KEPT_CHUNKS
    assert len(rows._complaints) == 3
    check(rows, 3600)
