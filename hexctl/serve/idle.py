"""What a robot does that nobody commands any more: it holds, after a while sits down, and goes limp."""

from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.errors import CommandRefusedError, EStopError, RobotFaultError
from hexctl.types import FloatArray, JointTargets

#: A robot without commands for this long sits down.
SIT_AFTER_S = 10.0


class IdleSupervisor:
    """Follows the silence after the last command; any stop but silence makes it hold the pose.

    After such a stop it moves no more until the next command, whenever the stop is cleared: whoever clears it
    may have their hands on the robot.

    Attributes:
        name: `idle` before the first command, then `commanded`, `holding`, `sitting` or `limp`.
    """

    def __init__(self, guard: Guard, *, sit_after_s: float = SIT_AFTER_S) -> None:
        self.name = "idle"
        self._guard = guard
        self._sit_after_s = sit_after_s
        self._end_rad = sitting_angles_rad(guard.robot)
        self._start_rad: FloatArray = self._end_rad
        self._commanded_at_s = 0.0
        self._held = False
        self._sitting_since_s = 0.0

    def commanded(self, now_s: float) -> None:
        """Say that a command reached the servos."""
        self.name, self._commanded_at_s, self._held = "commanded", now_s, False

    def tick(self, now_s: float) -> None:
        """Do what the silence asks for; times are on the clock of the servos."""
        if self.name in ("idle", "limp"):
            return
        if self._guard.stopped not in (None, "expired"):
            self.name, self._held = "holding", True
        elif self._held:
            self.name = "idle"
        elif self.name == "sitting":
            self._sit(now_s)
        elif now_s - self._commanded_at_s > self._sit_after_s:
            self._begin_to_sit(now_s)
        elif self._guard.stopped is not None:
            self.name = "holding"

    def _begin_to_sit(self, now_s: float) -> None:
        try:
            self._start_rad = self._guard.accepted_rad()
        except RobotFaultError:
            self.name = "holding"  # nobody knows where the joints are
        else:
            self.name, self._sitting_since_s = "sitting", now_s

    def _sit(self, now_s: float) -> None:
        """Come a tick nearer to the floor; on it, let the joints go."""
        share = (now_s - self._sitting_since_s) / SITTING_S
        if share > 1:
            self.name = "limp"
            self._guard.disable_torque()
            self._guard.pause_watchdog()
            return
        pose = (1 - share) * self._start_rad + share * self._end_rad
        try:
            self._guard.write_while_timed_out(JointTargets(pose, now_s))
        except (EStopError, CommandRefusedError):
            self.name = "holding"
