"""Rows that grow, of ticks and of readings of servos: the newest in memory, older ones in a nameless file.

An hour of ticks takes 150 MB, and a robot's own computer has a few hundred. The file is on a disk where there
is one (`/var/tmp`, as `/tmp` may be memory), and vanishes with the process, however that ends.
"""

import os
import tempfile
from array import array
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread
from typing import IO, Any

import numpy as np

from hexctl.types import N_JOINTS, ServoReadings

#: Name, width and type of a column; a width of 0 is a plain value per row.
Column = tuple[str, int, type]

#: Where the file is, if it can be there; otherwise where temporary files are usually.
FOLDER = "/var/tmp"  # noqa: S108  the file has no name

#: Rows of one chunk; a full one is never copied, so that a long walk costs no tick its time.
CHUNK_ROWS = 2048

#: Chunks that stay in memory: more than a recording that is behind has not read yet.
KEPT_CHUNKS = 4

#: Attributes of `ServoReadings` that are arrays.
NUMBERS = ("ages_s", "efforts", "currents_a", "voltages_v", "temperatures_c")

#: Their columns.
SERVO_COLUMNS: tuple[Column, ...] = tuple((name, N_JOINTS, float) for name in NUMBERS)

#: Readings of one chunk: half a minute, where they come once a second.
CHUNK_READINGS = 32


@dataclass(frozen=True, slots=True)
class _Written:
    """A chunk in the file, which begins there at an offset; its columns follow one another."""

    offset: int


class RowStore:
    """Columns of rows, of which only the newest chunks are in memory.

    A thread writes older ones, so that a slow disk costs no tick its time. What a disk does not take stays in
    memory.
    """

    def __init__(self, columns: Sequence[Column], *, chunk_rows: int = CHUNK_ROWS) -> None:
        self._columns, self._chunk_rows = tuple(columns), chunk_rows
        self._length = 0
        self._chunks: list[dict[str, Any] | _Written] = []
        self._written = 0
        self._file: IO[bytes] | None = None
        self._writer: Thread | None = None
        self._full = False

    def __len__(self) -> int:
        return self._length

    @property
    def columns(self) -> tuple[Column, ...]:
        """Name, width and type of each column."""
        return self._columns

    def append(self) -> tuple[dict[str, Any], int]:
        """Arrays and index of one more row, to be filled in; what is left out is NaN, 0 or False."""
        arrays, row, _ = self.append_some(1)
        return arrays, row

    def append_some(self, rows: int) -> tuple[dict[str, Any], int, int]:
        """Arrays, index and number of further rows: as many of those wanted as fit into the chunk."""
        row = self._length % self._chunk_rows
        if row == 0:
            self._chunks.append(_new_chunk(self._columns, self._chunk_rows))
            self._write_older()
        count = min(rows, self._chunk_rows - row)
        self._length += count
        newest = self._chunks[-1]
        assert isinstance(newest, dict)  # noqa: S101  never written
        return newest, row, count

    def newest(self) -> tuple[dict[str, Any], int]:
        """Arrays and index of the last row."""
        newest = self._chunks[-1]
        assert isinstance(newest, dict)  # noqa: S101  never written
        return newest, (self._length - 1) % self._chunk_rows

    def rows(self, name: str, start: int, stop: int) -> Any:
        """Rows [start, stop) of a column; those of one chunk in memory are not copied."""
        size = self._chunk_rows
        stop = min(stop, self._length)
        parts = [
            self._part(index, name, max(start - index * size, 0), min(stop - index * size, size))
            for index in range(start // size, -(-stop // size))
        ]
        if not parts:
            return _new_chunk(self._columns, 0)[name]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def __getstate__(self) -> dict[str, Any]:
        """Everything, for a copy that is all in memory."""
        size = self._chunk_rows
        whole = [
            {name: self._part(index, name, 0, size) for name, _, _ in self._columns}
            for index in range(len(self._chunks))
        ]
        unwritten = {"_written": 0, "_file": None, "_writer": None, "_full": False}
        return {**self.__dict__, **unwritten, "_chunks": whole}

    def _part(self, index: int, name: str, start: int, stop: int) -> Any:
        """Rows of a column in one chunk."""
        chunk = self._chunks[index]
        if isinstance(chunk, dict):
            return chunk[name][start:stop]
        file, offset = self._file, chunk.offset
        assert file is not None  # noqa: S101  something is written
        for each, width, kind in self._columns:
            row_bytes = max(1, width) * np.dtype(kind).itemsize
            if each == name:
                shape = (stop - start, width) if width else (stop - start,)
                data = os.pread(file.fileno(), (stop - start) * row_bytes, offset + start * row_bytes)
                return np.frombuffer(bytearray(data), kind).reshape(shape)
            offset += self._chunk_rows * row_bytes
        raise KeyError(name)

    def _write_older(self) -> None:
        """Write what need not be in memory, unless the disk is still busy with what came before."""
        waiting = range(self._written, len(self._chunks) - KEPT_CHUNKS)
        if waiting and not self._full and (self._writer is None or not self._writer.is_alive()):
            self._writer = Thread(target=self._write, args=(waiting,), name="rows", daemon=True)
            self._writer.start()

    def _write(self, chunks: range) -> None:
        try:
            if self._file is None:
                self._file = _nameless_file()
            for index in chunks:
                chunk = self._chunks[index]
                assert isinstance(chunk, dict)  # noqa: S101  chunks are written in order
                offset = self._file.seek(0, os.SEEK_END)
                for name, _, _ in self._columns:
                    self._file.write(memoryview(chunk[name]).cast("B"))
                self._file.flush()
                self._chunks[index], self._written = _Written(offset), index + 1
        except OSError:
            self._full = True


class ServoRows:
    """Readings of single servos and the rows of a log that they belong to, in the order of rows.

    An hour of them takes 8 MB, of which the last minutes are in memory. Iterating gives (row, readings).
    """

    def __init__(self, readings: Iterable[tuple[int, ServoReadings]] = ()) -> None:
        """Begin with rows and what was reported at them."""
        self._rows = array("q")
        self._numbers = RowStore(SERVO_COLUMNS, chunk_rows=CHUNK_READINGS)
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


def _nameless_file() -> IO[bytes]:
    with suppress(OSError):
        return tempfile.TemporaryFile(dir=FOLDER)
    return tempfile.TemporaryFile()


def _new_chunk(columns: Sequence[Column], rows: int) -> dict[str, Any]:
    """Empty rows; what is not filled in is NaN, 0 or False."""
    return {
        name: np.full((rows, width) if width else rows, np.nan if kind is float else 0, dtype=kind)
        for name, width, kind in columns
    }
