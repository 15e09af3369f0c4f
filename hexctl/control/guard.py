"""The guard: nothing moves a servo without passing it. It wraps a LegServos and is itself one.

On by default, latched, and with no "off": a stop stays until `clear` is called.
"""

from dataclasses import dataclass

from hexctl.backends.base import LegServos
from hexctl.backends.checks import check_targets
from hexctl.backends.clock import Clock
from hexctl.control.limits import FALL_COS_TILT, FALL_TICKS, StepLimits
from hexctl.errors import CommandRefusedError, EStopError
from hexctl.robot.messages import FloatArray, JointTargets, RobotState
from hexctl.robot.model import Robot

#: A command older than this is not obeyed, and silence longer than this freezes the robot.
COMMAND_EXPIRY_S = 0.2


@dataclass(slots=True)
class GuardCounters:
    """What the guard did so far, in commands.

    Attributes:
        accepted: passed, changed or not.
        clipped: passed after a position or a speed limit changed them.
        refused: not passed: not finite, wrong shape, too old, or stopped.
    """

    accepted: int = 0
    clipped: int = 0
    refused: int = 0


class Guard(LegServos):
    """Limits, freshness, fall detection and a latched stop around any LegServos."""

    def __init__(self, servos: LegServos, *, command_expiry_s: float = COMMAND_EXPIRY_S) -> None:
        self._servos = servos
        self._expiry_s = command_expiry_s
        self._limits = StepLimits.of(servos.robot, servos.clock.period_s)
        self._accepted_rad: FloatArray | None = None
        self._accepted_at_s: float | None = None
        self._leaning_ticks = 0
        self.counters = GuardCounters()
        self.stopped: str | None = None

    @property
    def robot(self) -> Robot:
        """Return the robot behind the guard."""
        return self._servos.robot

    @property
    def clock(self) -> Clock:
        """Return the clock of the servos behind the guard."""
        return self._servos.clock

    @property
    def accepted_rad(self) -> FloatArray:
        """Return the last accepted targets, or where the joints are before the first command, (18,)."""
        if self._accepted_rad is None:
            self._accepted_rad = self._servos.read().joint_positions_rad.copy()
        return self._accepted_rad

    def connect(self) -> None:
        """Connect the servos behind the guard."""
        self._servos.connect()

    def close(self) -> None:
        """Close the servos behind the guard; a stop stays latched."""
        self._servos.close()
        self._forget()

    def read(self) -> RobotState:
        """Return the state, and latch a stop when the robot has fallen, is at fault or hears nothing."""
        state = self._servos.read()
        if self.stopped is None:
            self._watch(state)
        return state

    def write(self, targets: JointTargets) -> JointTargets:
        """Pass targets on, limited in position and speed, and return what was really sent.

        A step is measured from the last accepted targets, so a jump is slewed at the joints' own speed.
        Raises EStopError while stopped, CommandRefusedError for targets that are not finite or too old; then
        nothing is sent and the last accepted targets stay in force.
        """
        if self.stopped is not None:
            self.counters.refused += 1
            raise EStopError(f"stopped: {self.stopped}; clear it explicitly before the robot moves again")
        self._check(targets)
        allowed_rad = self._limits.apply(targets.positions_rad, self.accepted_rad)
        sent = targets
        if (allowed_rad != targets.positions_rad).any():
            self.counters.clipped += 1
            sent = JointTargets(allowed_rad, targets.stamp_s)
        sent = self._servos.write(sent)
        self.counters.accepted += 1
        self._accepted_rad = allowed_rad
        self._accepted_at_s = self.clock.now_s
        return sent

    def stop(self, reason: str) -> None:
        """Latch a stop; the servos hold the last accepted targets."""
        self.stopped = self.stopped or reason

    def clear(self) -> None:
        """Let the robot move again, from where its joints are now; silence counts from the next command."""
        self.stopped = None
        self._forget()

    def _forget(self) -> None:
        """Know of no command and no fall, as before the first one."""
        self._accepted_rad = None
        self._accepted_at_s = None
        self._leaning_ticks = 0

    def _check(self, targets: JointTargets) -> None:
        """Refuse what must not even be limited."""
        try:
            check_targets(targets)
            age_s = self.clock.now_s - targets.stamp_s
            if not age_s <= self._expiry_s:  # a time stamp that is no number has no age
                raise CommandRefusedError(f"targets: got {age_s:.3f} s old; allowed: {self._expiry_s:g} s")
        except CommandRefusedError:
            self.counters.refused += 1
            raise

    def _watch(self, state: RobotState) -> None:
        """Latch a stop for a fall, a fault of the robot, or a controller that has gone silent."""
        if state.base_quaternion_world is not None:
            _, x, y, _ = state.base_quaternion_world.tolist()
            self._leaning_ticks = self._leaning_ticks + 1 if 1 - 2 * (x * x + y * y) < FALL_COS_TILT else 0
            if self._leaning_ticks >= FALL_TICKS:
                self.stop("fell")
        if not state.healthy:
            self.stop("fault")
        if self._accepted_at_s is not None and self.clock.now_s - self._accepted_at_s > self._expiry_s:
            self.stop("expired")
