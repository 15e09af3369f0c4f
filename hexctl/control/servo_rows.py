"""What single servos reported in the course of a trial: the newest in memory, older ones in a file."""

from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator

from hexctl.control.row_store import Column, RowStore
from hexctl.types import N_JOINTS, ServoReadings

#: Attributes of `ServoReadings` that are arrays.
NUMBERS = ("ages_s", "efforts", "currents_a", "voltages_v", "temperatures_c")

COLUMNS: tuple[Column, ...] = tuple((name, N_JOINTS, float) for name in NUMBERS)

#: Readings of one chunk: half a minute, where they come once a second.
CHUNK_READINGS = 32


class ServoRows:
    """Readings of single servos and the rows of a log that they belong to, in the order of rows.

    An hour of them takes 8 MB, of which the last minutes are in memory. Iterating gives (row, readings).
    """

    def __init__(self, readings: Iterable[tuple[int, ServoReadings]] = ()) -> None:
        """Begin with rows and what was reported at them."""
        self._rows = array("q")
        self._numbers = RowStore(COLUMNS, chunk_rows=CHUNK_READINGS)
        #: Complaints, and the index of the first reading with them: they hardly ever change.
        self._complaints: list[tuple[int, tuple[str, ...]]] = []
        for reading in readings:
            self.append(reading)

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[tuple[int, ServoReadings]]:
        return (one for index in range(len(self)) for one in self._readings(index, index + 1))

    def append(self, reading: tuple[int, ServoReadings]) -> None:
        """Add what was reported at a row, which comes after all others."""
        row, servos = reading
        if not self._complaints or self._complaints[-1][1] != servos.errors:
            self._complaints.append((len(self), servos.errors))
        columns, place = self._numbers.append()
        for name in NUMBERS:
            columns[name][place] = getattr(servos, name)
        self._rows.append(row)

    def between(self, start: int, stop: int) -> list[tuple[int, ServoReadings]]:
        """Rows and readings from row `start` on, before row `stop`."""
        return self._readings(bisect_left(self._rows, start), bisect_left(self._rows, stop))

    def _readings(self, first: int, end: int) -> list[tuple[int, ServoReadings]]:
        """Rows and readings with these indices."""
        if first >= end:
            return []
        values = {name: self._numbers.rows(name, first, end) for name in NUMBERS}
        return [
            (
                self._rows[index],
                ServoReadings(
                    **{name: column[index - first] for name, column in values.items()},
                    errors=self._errors(index),
                ),
            )
            for index in range(first, end)
        ]

    def _errors(self, index: int) -> tuple[str, ...]:
        place = bisect_left(self._complaints, index + 1, key=lambda one: one[0])
        return self._complaints[place - 1][1]
