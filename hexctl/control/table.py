"""Tables that grow, of ticks and of readings of servos: the newest rows in memory, older ones on disk.

An hour of ticks takes 150 MB, and a robot's own computer has a few hundred. Rows are mapped onto a file
without a name, on a disk if there is one (`/var/tmp`, because `/tmp` may be memory). It vanishes with the
process.
"""

import logging
import mmap
import os
import tempfile
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Any, NamedTuple

import numpy as np

from hexctl.types import N_JOINTS, ServoReadings

_LOG = logging.getLogger(__name__)

#: Where the file is if possible; otherwise where temporary files usually are.
FOLDER = "/var/tmp"  # noqa: S108  the file has no name

#: Rows that a table allocates at a time: a fixed number, so that growing never costs a tick more than 2 ms.
CHUNK_ROWS = 2048

#: Chunks that stay in memory: more than a recording that is behind has not read yet.
KEPT_CHUNKS = 2

#: Attributes of `ServoReadings` that are arrays.
NUMBERS = ("ages_s", "efforts", "currents_a", "voltages_v", "temperatures_c")

#: Readings of one chunk: half a minute at one reading a second.
CHUNK_READINGS = 32


class Column(NamedTuple):
    """A column of a table. Unknown values are NaN, 0 or False.

    Attributes:
        name: of the column.
        shape: of one row, () for a number.
        unit: of its values, empty without one.
        meaning: what the values are.
        kind: type of the values.
        fields: names of its numbers in a data frame; empty if the column is a single number of that name.
    """

    name: str
    shape: tuple[int, ...] = ()
    unit: str = ""
    meaning: str = ""
    kind: type = float
    fields: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Rows that were allocated together: an array per column, all in one mapping, or in memory for None."""

    arrays: dict[str, Any]
    mapping: mmap.mmap | None

    def leave_memory(self) -> None:
        """Have the kernel keep the rows on disk only until they are read again."""
        if self.mapping is not None:
            self.mapping.madvise(mmap.MADV_DONTNEED)


class Table:
    """Rows of columns, of which only the newest are in memory.

    If no disk has room for further rows, they stay in memory, with a warning.
    """

    def __init__(self, columns: Sequence[Column], *, chunk_rows: int = CHUNK_ROWS) -> None:
        """Begin without rows."""
        self._columns, self._chunk_rows = tuple(columns), chunk_rows
        self._length = 0
        self._chunks: list[_Chunk] = []
        self._file: IO[bytes] | None = None
        self._on_disk = True

    def __len__(self) -> int:
        return self._length

    def append(self, rows: int = 1) -> tuple[dict[str, Any], int, int]:
        """Allocate rows to be filled in.

        Returns the arrays of a chunk, the index of the first new row in them, and how many rows there are: as
        many of those wanted as fit into the chunk.
        """
        row = self._length % self._chunk_rows
        if row == 0:
            self._grow()
        count = min(rows, self._chunk_rows - row)
        self._length += count
        return self._chunks[-1].arrays, row, count

    def last(self) -> tuple[dict[str, Any], int]:
        """Arrays of the newest chunk, and the index of the last row in them."""
        return self._chunks[-1].arrays, (self._length - 1) % self._chunk_rows

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Rows [start, stop) of a column; those of a single chunk are not copied."""
        size, stop = self._chunk_rows, min(stop, self._length)
        chunks = range(start // size, -(-stop // size))
        parts = [
            self._chunks[index].arrays[name][max(start - index * size, 0) : stop - index * size]
            for index in chunks
        ]
        if len(parts) < 2:
            return parts[0] if parts else self._arrays(None, 0)[name]
        whole = np.concatenate(parts)
        for index in chunks[:-KEPT_CHUNKS]:
            self._chunks[index].leave_memory()
        return whole

    def __getstate__(self) -> dict[str, Any]:
        """Everything, for a copy that is in memory."""
        copies = [
            _Chunk({name: array.copy() for name, array in chunk.arrays.items()}, None)
            for chunk in self._chunks
        ]
        return {**self.__dict__, "_file": None, "_chunks": copies}

    def _grow(self) -> None:
        """Allocate another chunk. The first is in memory: most trials are short, and need no file."""
        mapping = self._mapping() if self._chunks and self._on_disk else None
        self._chunks.append(_Chunk(self._arrays(mapping, self._chunk_rows), mapping))
        if len(self._chunks) > KEPT_CHUNKS:
            self._chunks[-1 - KEPT_CHUNKS].leave_memory()

    def _arrays(self, mapping: mmap.mmap | None, rows: int) -> dict[str, Any]:
        """Empty rows of each column, one column after the other in a mapping, or in memory for None."""
        arrays: dict[str, Any] = {}
        offset = 0
        for column in self._columns:
            shape = (rows, *column.shape)
            if mapping is None:
                arrays[column.name] = np.empty(shape, column.kind)
            else:
                arrays[column.name] = np.ndarray(shape, column.kind, mapping, offset)
                offset += _aligned(arrays[column.name].nbytes, 8)
            arrays[column.name].fill(np.nan if column.kind is float else 0)
        return arrays

    def _mapping(self) -> mmap.mmap | None:
        """Reserved bytes of the file for one chunk; None if the disk has no room."""
        row_bytes = sum(
            int(np.prod(column.shape)) * np.dtype(column.kind).itemsize for column in self._columns
        )
        size = _aligned(self._chunk_rows * row_bytes + 8 * len(self._columns), mmap.ALLOCATIONGRANULARITY)
        try:
            if self._file is None:
                self._file = _nameless_file()
            offset = os.fstat(self._file.fileno()).st_size
            os.posix_fallocate(self._file.fileno(), offset, size)
            return mmap.mmap(self._file.fileno(), size, offset=offset)
        except (OSError, AttributeError) as error:  # macOS cannot reserve room
            _LOG.warning("the log of ticks stays in memory: no disk has room for it (%s)", error)
            self._on_disk = False
            return None


class ServoRows:
    """Readings of single servos and the rows of a log that they belong to, in the order of rows.

    An hour of them takes 8 MB, of which the last minutes are in memory. Iterating gives (row, readings).
    """

    def __init__(self, readings: Iterable[tuple[int, ServoReadings]] = ()) -> None:
        """Begin with rows and what was reported at them."""
        self._rows = array("q")
        columns = [Column(name, (N_JOINTS,)) for name in NUMBERS]
        self._numbers = Table(columns, chunk_rows=CHUNK_READINGS)
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
        arrays, place, _ = self._numbers.append()
        for name in NUMBERS:
            arrays[name][place] = getattr(servos, name)
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


def _aligned(size: int, step: int) -> int:
    return -(-size // step) * step


def _nameless_file() -> IO[bytes]:
    with suppress(OSError):
        return tempfile.TemporaryFile(dir=FOLDER)
    return tempfile.TemporaryFile()
