"""Servos that write down what they were told, for tests that look at another process's robot."""

import os
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hexctl.backends.mock import MockServos
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, JointTargets

VARIABLE = "HEXCTL_TEST_SERVO_LOG"

_ROW = struct.Struct("<19d")


class RecordedServos(MockServos):
    """A mock robot that appends every write and every relaxing to a file, with the time."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._log = open(os.environ[VARIABLE], "ab", buffering=0)  # noqa: SIM115  for as long as it lives

    def write(self, targets: JointTargets) -> JointTargets:
        """Take the targets over and write them down."""
        sent = super().write(targets)
        self._log.write(_ROW.pack(time.monotonic(), *sent.joint_positions_rad))
        return sent

    def disable_torque(self) -> bool:
        """Go limp and write that down."""
        self._log.write(_ROW.pack(time.monotonic(), *self._positions_rad))
        return super().disable_torque()


@dataclass(frozen=True)
class ServoLog:
    """What the servos were told.

    Attributes:
        times_s: on time.monotonic, (n,).
        joint_positions_rad: (n, 18).
    """

    times_s: FloatArray
    joint_positions_rad: FloatArray

    @classmethod
    def read(cls, path: Path) -> "ServoLog":
        """Read the log of a robot that may still be running."""
        data = path.read_bytes()
        rows = np.array(list(_ROW.iter_unpack(data[: len(data) // _ROW.size * _ROW.size]))).reshape(-1, 19)
        return cls(rows[:, 0], rows[:, 1:])

    def moved_after(self, time_s: float) -> float:
        """How long after a moment the servos were last told to go elsewhere; 0 if never."""
        changed = np.flatnonzero((np.diff(self.joint_positions_rad, axis=0) != 0).any(axis=1)) + 1
        last_s = self.times_s[changed[-1]] if changed.size else time_s
        return max(0.0, float(last_s - time_s))
