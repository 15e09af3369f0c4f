"""Supervision of a robot without commands: it holds its pose, sits down, goes limp. Detection of rest."""

from collections import deque

import numpy as np

from hexctl.control.guard import Guard
from hexctl.control.sit_down import SittingMotion
from hexctl.errors import CommandRefusedError, EStopError, RobotFaultError
from hexctl.options import Range
from hexctl.types import FloatArray

#: Default and possible times without commands until the robot sits down.
SIT_AFTER_S = 10.0
SIT_AFTER_RANGE_S = Range(low=1, high=3600, unit="s")


class IdleSupervisor:
    """Lets a robot whose commands have ended sit down after a while, then disables its torque.

    With hot servos or a low battery it sits down immediately. After any stop except for an expired command it
    holds its pose until the next command, even if the stop is cleared: the operator may be touching the
    robot.

    Attributes:
        name: `idle` before the first command, then `commanded`, `holding`, `sitting` or `limp`.
        sit_after_s: time without commands until it sits down; may be set.
    """

    def __init__(self, guard: Guard, *, sit_after_s: float = SIT_AFTER_S) -> None:
        self.name = "idle"
        self._guard = guard
        self.sit_after_s = sit_after_s
        self._motion: SittingMotion | None = None
        self._commanded_at_s = 0.0
        self._held = False

    @property
    def holds_after_stop(self) -> bool:
        """Whether the robot holds its pose after a stop, until its next command."""
        stopped = self._guard.stopped not in (None, "expired")
        return (self._held or stopped) and not self._guard.stop_allows_sitting

    def commanded(self, now_s: float) -> None:
        """Note that a command reached the servos at `now_s` on their clock."""
        self.name, self._commanded_at_s, self._held = "commanded", now_s, False

    def controlled(self, now_s: float) -> None:
        """Note a new lease: it interrupts sitting down, and restarts the time without commands."""
        self._commanded_at_s = now_s
        if self.name == "sitting" and not self._guard.stop_allows_sitting:
            self.name = "holding"

    def tick(self, now_s: float) -> None:
        """Advance by one tick; `now_s` is on the clock of the servos."""
        if self.name in ("idle", "limp"):
            return
        if self._guard.stop_allows_sitting:
            self._sit(now_s) if self.name == "sitting" else self._begin_to_sit(now_s)
        elif self._guard.stopped not in (None, "expired"):
            self.name, self._held = "holding", True
        elif self._held:
            self.name = "idle"
        elif self.name == "sitting":
            self._sit(now_s)
        elif now_s - self._commanded_at_s > self.sit_after_s:
            self._begin_to_sit(now_s)
        elif self._guard.stopped is not None:
            self.name = "holding"

    def sit(self, now_s: float) -> None:
        """Sit down from the current joint angles; `now_s` is on the clock of the servos."""
        self._held = False
        self._begin_to_sit(now_s)

    def go_limp(self) -> None:
        """Disable the torque of a robot that sits."""
        self.name = "limp"
        self._guard.disable_torque()
        self._guard.pause_watchdog()

    def _begin_to_sit(self, now_s: float) -> None:
        try:
            self._motion = SittingMotion(self._guard, now_s)
        except RobotFaultError:
            self.name = "holding"  # the joint angles are unknown
        else:
            self.name = "sitting"

    def _sit(self, now_s: float) -> None:
        try:
            sits = self._motion is not None and self._motion.step(now_s)
        except (EStopError, CommandRefusedError):
            self.name = "holding"
        else:
            if sits:
                self.go_limp()


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
