"""Detects whether a robot is at rest: its joints have not moved for a while."""

from collections import deque

import numpy as np

from hexctl.types import FloatArray

#: A robot at rest moves less than this in this time: 0.1 rad/s, above the 0.005 rad resolution of servos.
STILL_RAD, STILL_S = 0.02, 0.2


class RestWatch:
    """Checks the joint angles of each control period; too few, unknown or old ones are not at rest."""

    def __init__(self) -> None:
        self.at_rest = False
        self._seen: deque[tuple[float, FloatArray]] = deque()

    def note(self, joint_positions_rad: FloatArray, at_s: float, *, reached: bool = True) -> None:
        """Take joint angles, (18,), of a time on any monotonic clock, and whether servos were reached."""
        if not reached:
            self._seen.clear()
            self.at_rest = False
            return
        self._seen.append((at_s, joint_positions_rad.copy()))  # custom servos may reuse an array
        while len(self._seen) > 1 and self._seen[1][0] <= at_s - STILL_S:
            self._seen.popleft()
        self.at_rest = self._still()

    def _still(self) -> bool:
        if self._seen[-1][0] - self._seen[0][0] < STILL_S:
            return False
        angles = np.stack([positions for _, positions in self._seen])
        return bool(np.ptp(angles, axis=0).max() < STILL_RAD)  # false for nan too
