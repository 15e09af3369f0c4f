"""What a simulated robot truly does, written by its own process and read by another one.

The file has its full size from the start and is mapped into memory: no limit on files and no full disk can
keep a twin from writing down what it does.
"""

import mmap
import struct
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from hexctl.types import ArrayFields, FloatArray

#: Rows of a file: half an hour of a rig.
CAPACITY = 300_000

#: Rows: where the joints are and how upright the body is, which angles the servos were told, an injection.
STATE, TOLD, FAULT = 0.0, 1.0, 2.0

_COUNT = struct.Struct("<q")
_ROW = struct.Struct("<21d")
_SIZE = _COUNT.size + CAPACITY * _ROW.size


class TruthWriter:
    """The twin's end of a file.

    Args:
        path: of the file, which is made or overwritten.
    """

    def __init__(self, path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(_SIZE)
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), _SIZE)
        self._count = 0

    def add(self, kind: float, angles_rad: FloatArray | None = None, cos_tilt: float = 1.0) -> None:
        """Write a row with the time now: its kind, angles (18,) and the cosine of the body's tilt."""
        if self._count == CAPACITY:
            return
        values = [0.0] * 18 if angles_rad is None else angles_rad.tolist()
        _ROW.pack_into(
            self._map, _COUNT.size + self._count * _ROW.size, time.monotonic(), kind, *values, cos_tilt
        )
        self._count += 1
        _COUNT.pack_into(self._map, 0, self._count)


@dataclass(frozen=True, slots=True, eq=False)
class Truth(ArrayFields):
    """What a twin wrote down, on time.monotonic.

    Attributes:
        at_s: of each control period, (n,).
        joints_rad: where the joints truly are, (n, 18).
        cos_tilt: cosine of the body's tilt, (n,).
        told_at_s: when servos were told angles, (m,).
        told_rad: which, (m, 18); NaN for servos without torque.
        fault_at_s: when faults of the twin began, (k,).
    """

    at_s: FloatArray
    joints_rad: FloatArray
    cos_tilt: FloatArray
    told_at_s: FloatArray
    told_rad: FloatArray
    fault_at_s: FloatArray

    @classmethod
    def of_rows(cls, rows: FloatArray) -> Self:
        """Truth of rows (n, 21): time, kind, 18 angles, cosine."""
        states, told, faults = (rows[rows[:, 1] == kind] for kind in (STATE, TOLD, FAULT))
        return cls(states[:, 0], states[:, 2:20], states[:, 20], told[:, 0], told[:, 2:20], faults[:, 0])

    @classmethod
    def read(cls, path: Path, from_s: float = -np.inf) -> Self:
        """What a twin has written so far since a moment; the twin may still be running.

        Raises ValueError for a file that is full: what came after is not in it.
        """
        with path.open("rb") as file, mmap.mmap(file.fileno(), _SIZE, access=mmap.ACCESS_READ) as mapped:
            (count,) = _COUNT.unpack_from(mapped, 0)
            if count >= CAPACITY:
                raise ValueError(f"{path} is full")
            # A copy: the map closes.
            rows: Any = np.frombuffer(mapped, "<f8", 21 * count, _COUNT.size).reshape(-1, 21).copy()
        return cls.of_rows(rows[rows[:, 0] >= from_s])
