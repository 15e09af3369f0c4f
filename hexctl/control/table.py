"""Growing tables of ticks and servo readings: the newest rows in memory, older ones on disk.

An hour of ticks takes 171 MB, too much for a robot's computer. Older rows go to a nameless file that vanishes
with the process. It is not mapped: an error of the disk would then end the process.
"""

import logging
import os
import tempfile
from array import array
from bisect import bisect_left
from collections.abc import Sequence
from contextlib import suppress
from errno import EIO, ENOSPC
from typing import IO, Any

import numpy as np

from hexctl.columns import READINGS, Column
from hexctl.types import ServoReadings

_LOG = logging.getLogger(__name__)

#: Preferred folder of the file, because `/tmp` may be memory; else the default of temporary files.
FOLDER = "/var/tmp"  # noqa: S108  the file has no name

#: Rows per chunk. Writing one delays a tick by 0.2 ms for the 240 kB of a log (one server core, page cache).
CHUNK_ROWS = 256

#: Chunks in memory: more than a recording that lags has not read yet.
CACHED_CHUNKS = 16

#: Readings per chunk: half a minute at one reading a second.
CHUNK_READINGS = 32


class Table:
    """Rows of columns, with only the newest in memory, or all if no disk has room; truths are numbers."""

    def __init__(self, columns: Sequence[Column], *, chunk_rows: int = CHUNK_ROWS) -> None:
        self._types = {
            column.name: np.dtype((float if column.kind is bool else column.kind, column.shape))
            for column in columns
        }
        self._chunk_rows, self._chunk_bytes = chunk_rows, 0
        #: Offset of each column in a chunk of the file, in bytes.
        self._starts: dict[str, int] = {}
        for name, kind in self._types.items():
            self._starts[name] = self._chunk_bytes
            self._chunk_bytes += chunk_rows * kind.itemsize
        self._length = 0
        #: An array per column; None once the chunk is in the file.
        self._chunks: list[dict[str, Any] | None] = []
        self._file: IO[bytes] | None = None
        self._on_disk = True

    def __len__(self) -> int:
        return self._length

    def append(self, rows: int = 1) -> tuple[dict[str, Any], int, int]:
        """Allocate rows: the arrays of a chunk, the first new row, and how many of the rows fit."""
        row = self._length % self._chunk_rows
        if row == 0:
            self._grow()
        count = min(rows, self._chunk_rows - row)
        self._length += count
        return self._newest(), row, count

    def last(self) -> tuple[dict[str, Any], int]:
        """Arrays of the newest chunk, and the index of the last row in them."""
        return self._newest(), (self._length - 1) % self._chunk_rows

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Rows [start, stop) of a column, not copied if in a single chunk in memory. Raises OSError."""
        size, stop = self._chunk_rows, min(stop, self._length)
        chunks = range(start // size, -(-stop // size))
        if len(chunks) == 1 and (arrays := self._chunks[chunks[0]]) is not None:
            return arrays[name][start - chunks[0] * size : stop - chunks[0] * size]
        rows = np.empty(max(stop - start, 0), self._types[name])
        for chunk in chunks:
            first, end = max(start, chunk * size), min(stop, (chunk + 1) * size)
            self._copy(name, chunk, first - chunk * size, rows[first - start : end - start])
        return rows

    def __getstate__(self) -> dict[str, Any]:
        size = self._chunk_rows
        copies = [self._empty() for _ in self._chunks]
        for chunk, arrays in enumerate(copies):
            for name, rows in arrays.items():
                self._copy(name, chunk, 0, rows[: self._length - chunk * size])
        return {**self.__dict__, "_file": None, "_chunks": copies}

    def _newest(self) -> dict[str, Any]:
        arrays = self._chunks[-1]
        assert arrays is not None  # noqa: S101  only older chunks are in the file
        return arrays

    def _grow(self) -> None:
        leaving = len(self._chunks) - CACHED_CHUNKS
        if leaving >= 0 and self._on_disk:
            self._write(leaving)
        self._chunks.append(self._empty())

    def _empty(self) -> dict[str, Any]:
        arrays = {name: np.empty(self._chunk_rows, kind) for name, kind in self._types.items()}
        for rows in arrays.values():
            rows.fill(np.nan if rows.dtype == float else 0)
        return arrays

    def _write(self, chunk: int) -> None:
        if (arrays := self._chunks[chunk]) is None:
            return
        try:
            if self._file is None:
                self._file = _nameless_file()
            offset = chunk * self._chunk_bytes
            written = os.pwritev(self._file.fileno(), list(arrays.values()), offset)
            _check_size(written, self._chunk_bytes, ENOSPC)
            self._chunks[chunk] = None
        except (OSError, AttributeError) as error:  # some systems have no pwritev
            _LOG.warning("the log of ticks stays in memory: no disk has room for it (%s)", error)
            self._on_disk = False

    def _copy(self, name: str, chunk: int, first: int, rows: Any) -> None:
        if (arrays := self._chunks[chunk]) is not None:
            rows[:] = arrays[name][first : first + len(rows)]
        elif self._file is not None:
            offset = chunk * self._chunk_bytes + self._starts[name] + first * self._types[name].itemsize
            _check_size(os.preadv(self._file.fileno(), [rows], offset), rows.nbytes, EIO)


class ServoRows:
    """Readings of single servos and their rows in a log; their numbers are in a `Table`."""

    def __init__(self) -> None:
        self._rows = array("q")
        self._numbers = Table(READINGS, chunk_rows=CHUNK_READINGS)
        #: Of each reading; equal ones, as most are, share a tuple.
        self._errors: list[tuple[str, ...]] = []

    def append(self, row: int, servos: ServoReadings) -> None:
        """Add the readings at a row after all others."""
        same = bool(self._errors) and self._errors[-1] == servos.errors
        self._errors.append(self._errors[-1] if same else servos.errors)
        arrays, place, _ = self._numbers.append()
        for column in READINGS:
            arrays[column.name][place] = getattr(servos, column.name)
        self._rows.append(row)

    def between(self, start: int, stop: int) -> list[tuple[int, ServoReadings]]:
        """Rows and readings from row `start` on, before row `stop`."""
        first, end = bisect_left(self._rows, start), bisect_left(self._rows, stop)
        numbers = {column.name: self._numbers.rows(column.name, first, end) for column in READINGS}
        return [
            (
                self._rows[index],
                ServoReadings(
                    **{name: values[index - first] for name, values in numbers.items()},
                    errors=self._errors[index],
                ),
            )
            for index in range(first, end)
        ]


def _check_size(done: int, size: int, error: int) -> None:
    if done < size:
        raise OSError(error, os.strerror(error))


def _nameless_file() -> IO[bytes]:
    with suppress(OSError):
        return tempfile.TemporaryFile(dir=FOLDER)
    return tempfile.TemporaryFile()
