"""The guard: every command to a servo passes it. It wraps a LegServos and is one itself.

It cannot be switched off, and its stops are latched until `clear`. Its limits are array functions, shared
with batches of simulated robots.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from threading import Lock
from types import TracebackType

import numpy as np

from hexctl.backends.base import LegServos, ServosWrapper, check_targets
from hexctl.backends.clock import Standstill
from hexctl.control.pose_watch import PoseAges, RepeatedAngles, WalkedPosition, joined
from hexctl.control.stop_reason import reason_in_words
from hexctl.control.telemetry_watch import HOT, BatteryWatch, PositionCheck, Temperatures
from hexctl.errors import (
    CommandRefusedError,
    EStopError,
    HexctlError,
    InputError,
    RobotFaultError,
    check_type,
)
from hexctl.robot.model import Robot
from hexctl.robot.rotations import cos_tilt
from hexctl.types import (
    TOO_HOT_C,
    ArrayFields,
    BoolArray,
    FloatArray,
    JointTargets,
    RobotState,
    all_finite,
    joint_in_words,
)

#: A body that leans further than this, for this long, has fallen.
FALL_COS_TILT = float(np.cos(np.radians(50)))
FALL_TICKS = 10


@dataclass(frozen=True, slots=True, eq=False)
class StepLimits(ArrayFields):
    """Joint ranges, (18,), and the maximum step of one control period, (18,)."""

    lower_rad: FloatArray
    upper_rad: FloatArray
    max_step_rad: FloatArray

    @classmethod
    def of(cls, robot: Robot, period_s: float) -> "StepLimits":
        """Limits of a robot with one command per period."""
        return cls(robot.joint_lower_rad, robot.joint_upper_rad, robot.joint_max_speed_rad_s * period_s)

    def apply(self, requested_rad: FloatArray, accepted_rad: FloatArray) -> FloatArray:
        """Nearest targets, leading shape + (18,), within speed and, with lower priority, range."""
        return self.stepped(
            np.minimum(np.maximum(requested_rad, self.lower_rad), self.upper_rad), accepted_rad
        )

    def stepped(self, requested_rad: FloatArray, accepted_rad: FloatArray) -> FloatArray:
        """Nearest targets within speed; arguments as of `apply`."""
        slowest, fastest = accepted_rad - self.max_step_rad, accepted_rad + self.max_step_rad
        return np.minimum(np.maximum(requested_rad, slowest), fastest)


def leaning(base_quaternion_world: FloatArray) -> BoolArray:
    """Whether a body leans too far, for orientations leading shape + (4,)."""
    x, y = base_quaternion_world[..., 1], base_quaternion_world[..., 2]
    return np.asarray(cos_tilt(x, y) < FALL_COS_TILT)


def base_orientation(state: RobotState) -> FloatArray | None:
    """Orientation (4,) of the base in a state, or None: used to detect falls."""
    return state.base_quaternion_world


#: Older commands are refused, longer silence freezes the robot, and an older state stops it.
EXPIRY_S = 0.2

#: Maximum gap in the measured pose, or repetition of it; meanwhile steering continues without it.
POSE_EXPIRY_S = 5.0
POSE_LOST = "pose lost"

#: With room for rounding, so that a batch ends as a single robot does.
LONGEST_UNSEEN_S = POSE_EXPIRY_S + 1e-6

#: Maximum expiry of any link.
MAX_EXPIRY_S = 1.0

#: Targets that changed by more than this in the last control period belong to a motion.
MOVES_RAD = 0.001

#: Prefix of a stop after which the robot sits down, as after `HOT`, for a servo of `TOO_HOT_C`.
LOW_BATTERY = "low battery"

#: Rounding of a time to a control period, as a share of one.
ROUNDING = 1e-6


@dataclass(slots=True)
class GuardCounters:
    """Numbers of commands; clipped ones were passed after a limit changed them."""

    accepted: int = 0
    clipped: int = 0
    refused: int = 0


class _OSErrorsAre:
    """Context that turns an OSError of the servos into a RobotFaultError that begins with a text."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, OSError) and not isinstance(error, HexctlError):
            raise RobotFaultError(f"{self._text}: {error}") from error


_UNREACHABLE = _OSErrorsAre("the robot cannot be reached")
_LINK_FAILED = _OSErrorsAre("the link to the robot failed")


def _is_judged_elsewhere(servos: LegServos) -> bool:
    """Whether servos are simulated, or on a link whose server has a guard."""
    return servos.simulation is not None or (servos.remote is not None and not servos.remote.link.plain)


class Guard(ServosWrapper):
    """Limits, freshness, fall detection and a latched stop around any LegServos.

    Attributes:
        stopped: why the robot is stopped, or None: `fell`; `fault`, with the robot's report; `state` (not
            finite or too old); `pose lost` (longer than `POSE_EXPIRY_S`); `expired` (no command); `hot` and
            `low battery`, with the reading; the reason of the robot's own guard; or of `stop`. A pose that
            repeats itself while the legs move ages as if it were missing; joint angles that do are a `state`.
        leaning_ticks: consecutive ticks in which the body leans too far.
        positions: plausibility check; a state with an implausible position reports None, as does one whose
            position stands while the legs walk.
        poses: ages of the parts of the pose.
        standstill: this program's own delay that caused a stop or refusal, or None.
    """

    def __init__(
        self,
        servos: LegServos,
        *,
        expiry_s: float = EXPIRY_S,
        tilt_of: Callable[[RobotState], FloatArray | None] = base_orientation,
        trusts_position: Callable[[], bool] | None = None,
    ) -> None:
        """Guard servos.

        Args:
            expiry_s: maximum age of commands and states, and maximum silence of a controller.
            tilt_of: orientation (4,) for judging falls of the newest state, or None.
            trusts_position: whether a position may stand while the legs walk; by default that of a
                simulation, where legs may slip, or of a robot on a link, whose own guard judges it.

        Raises InputError for an expiry outside 0 (exclusive) to `MAX_EXPIRY_S`.
        """
        check_type(expiry_s, float, "expiry")
        if not 0 < expiry_s <= MAX_EXPIRY_S:
            raise InputError(f"expiry: got {expiry_s:g} s; allowed: above 0 up to {MAX_EXPIRY_S:g} s")
        super().__init__(servos)
        self._expiry_s = expiry_s
        self._period_s = servos.clock.period_s
        self._limits = StepLimits.of(servos.robot, self._period_s)
        self.counters = GuardCounters()
        self.stopped: str | None = None
        self._latch = Lock()
        self._accepted_rad: FloatArray | None = None
        self._accepted_at_s: float | None = None
        self._baseline_rad: FloatArray | None = None
        self._baseline_period = 0
        self._tilt_of = tilt_of
        self.positions = PositionCheck()
        self._walked = WalkedPosition(servos.robot)
        self._trusts_position = trusts_position or partial(_is_judged_elsewhere, servos)
        self.poses = PoseAges()
        self._joints = RepeatedAngles()
        self._temperatures, self._battery = Temperatures(), BatteryWatch()
        self.leaning_ticks = 0
        self.standstill: Standstill | None = None

    @property
    def expects_commands(self) -> bool:
        """Whether silence now is a failure: a command has come, and no pause since."""
        return self._accepted_at_s is not None

    @property
    def in_motion(self) -> bool:
        """Whether a command is due and the last one moved a joint: silence now interrupts a motion."""
        accepted_rad, baseline_rad = self._accepted_rad, self._baseline_rad
        if not self.expects_commands or accepted_rad is None or baseline_rad is None:
            return False
        return bool(np.abs(accepted_rad - baseline_rad).max() > MOVES_RAD)

    @property
    def hot(self) -> bool:
        """Whether the stop is for hot servos: the robot should sit down to cool them."""
        return self.stopped is not None and self.stopped.startswith(HOT)

    @property
    def stop_allows_sitting(self) -> bool:
        """Whether the stop is for hot servos or a low battery: the robot should sit down."""
        return self.stopped is not None and self.stopped.startswith((HOT, LOW_BATTERY))

    def accepted_rad(self) -> FloatArray:
        """Last accepted targets, (18,), initially the joint positions; raises RobotFaultError."""
        if self._accepted_rad is None:
            positions = self._read().joint_positions_rad
            if not np.isfinite(positions).all():
                raise RobotFaultError("the robot reports joint angles that are not finite; check its sensors")
            self._accepted_rad = positions.copy()
        return self._accepted_rad

    def connect(self) -> None:
        """Connect the servos behind the guard; raises RobotFaultError if they cannot be reached."""
        with _UNREACHABLE:
            self.wrapped.connect()

    def close(self) -> None:
        """Close the servos behind the guard; a stop stays latched. Raises RobotFaultError."""
        self._forget()
        with _LINK_FAILED:
            self.wrapped.close()

    def read(self) -> RobotState:
        """Newest state; latches a stop for a fall, a fault, or missing commands. Raises RobotFaultError."""
        state = self._read()
        if self.stopped in (None, "expired") or self.stop_allows_sitting:  # graver reasons outweigh these
            self._watch(state)
        return state

    def peek(self) -> RobotState:
        """Newest state without the checks of `read`, between two ticks. Raises RobotFaultError."""
        return self._read()

    def write(self, targets: JointTargets) -> JointTargets:
        """Pass targets on, limited in position and speed, and return the targets sent.

        A step is measured from the target at the beginning of the control period: jumps are slewed at joint
        speed, and several commands within a period together move no further than one.

        Raises EStopError while stopped, CommandRefusedError for targets that are non-finite, too old or from
        the future: nothing is sent then, and the last accepted targets stay in force. Raises RobotFaultError
        when the link fails.
        """
        if self.stopped is not None:
            self.counters.refused += 1
            why = reason_in_words(self.stopped)
            raise EStopError(f"stopped: {why}; clear it (Guard.clear) before the robot moves again")
        return self._pass(targets)

    def write_while_timed_out(self, targets: JointTargets) -> JointTargets:
        """Write as `write` does, but also with expired commands, hot servos or a low battery: to sit down.

        Raises EStopError for any other stop.
        """
        if self.stopped not in (None, "expired") and not self.stop_allows_sitting:
            raise EStopError(f"stopped: {reason_in_words(self.stopped)}; the robot holds its pose")
        return self._pass(targets)

    def stop(self, reason: str) -> None:
        """Latch a stop; the servos hold the last accepted targets. Thread-safe.

        Any reason replaces a stop for silence. Any but silence, heat and a low battery replaces one for
        heat or a low battery.
        """
        if reason in ("expired", "state"):
            self._note_standstill()
        with self._latch:
            silence, sits = self.stopped == "expired", reason.startswith((HOT, LOW_BATTERY))
            outweighs = reason != "expired" and (silence or (self.stop_allows_sitting and not sits))
            if self.stopped is None or outweighs:
                self.stopped = reason

    def clear(self) -> None:
        """Let the robot move again, from its current joint angles; silence counts from the next command."""
        with self._latch:
            self.stopped = None
        self._forget()

    def forget_pose(self) -> None:
        """Expect no position and orientation until the next ones; falls are still detected."""
        self.poses.forget("position", "orientation")
        self._walked.forget()
        self.positions.forget()

    def lift_silence(self) -> bool:
        """Clear a stop for silence, and no other, also in a race; return whether the robot may move."""
        with self._latch:
            if self.stopped not in (None, "expired"):
                return False
            self.stopped = None
        self._forget()
        return True

    def disable_torque(self) -> bool:
        """Let the joints go limp; False if the servos cannot. Raises RobotFaultError when the link fails."""
        with _LINK_FAILED:
            limp = super().disable_torque()
        if limp:
            self._accepted_rad = self._baseline_rad = None
        return limp

    def pause_watchdog(self) -> None:
        """Expect no command until the next one; a stop stays latched. Raises RobotFaultError."""
        self._accepted_at_s = None
        self.poses.renew(self.clock.now_s)
        self.positions.forget()
        with _LINK_FAILED:
            super().pause_watchdog()
        self.clock.pause()

    def _pass(self, targets: JointTargets) -> JointTargets:
        now_s = self.clock.now_s
        self._check(targets, now_s)
        allowed_rad = self._limits.apply(targets.joint_positions_rad, self._baseline(now_s))
        if self._accepted_rad is not None and self._accepted_rad is not self._baseline_rad:
            # Another command within a period: from the last one, it is a step like any other.
            allowed_rad = self._limits.stepped(allowed_rad, self._accepted_rad)
        sent = targets
        if allowed_rad.tolist() != targets.joint_positions_rad.tolist():
            self.counters.clipped += 1
            sent = JointTargets(allowed_rad, targets.stamp_s)
        with _LINK_FAILED:
            sent = self.wrapped.write(sent)
        self.counters.accepted += 1
        self._accepted_rad = allowed_rad
        self._accepted_at_s = now_s
        return sent

    def _note_standstill(self) -> None:
        self.standstill = self.clock.standing_still() or self.standstill

    def _forget(self) -> None:
        self._accepted_rad = self._accepted_at_s = self._baseline_rad = None
        self.poses, self._joints = PoseAges(), RepeatedAngles()
        self._walked.forget()
        self._temperatures, self._battery = Temperatures(), BatteryWatch()
        self.positions.forget()
        self.leaning_ticks = 0

    def _baseline(self, now_s: float) -> FloatArray:
        """Target from which this period's steps are measured."""
        period = math.floor(now_s / self._period_s + ROUNDING)
        if self._baseline_rad is None or period > self._baseline_period:
            self._baseline_rad, self._baseline_period = self.accepted_rad(), period
        return self._baseline_rad

    def _read(self) -> RobotState:
        with _LINK_FAILED:
            state = self.wrapped.read()
        position, now_s, trusted = state.base_position_world, self.clock.now_s, self._trusts_position()
        if not trusted and self.in_motion:  # it takes time, and legs at rest walk nowhere
            self._walked.walk(state, now_s)
        if position is None or not all_finite(position):
            return state
        accepted = self.positions.accepts(position, now_s) and (trusted or self._walked.follows(position))
        return state if accepted else replace(state, base_position_world=None)

    def _check(self, targets: JointTargets, now_s: float) -> None:
        try:
            check_targets(targets)
            age_s = now_s - targets.stamp_s
            if not -self._period_s <= age_s <= self._expiry_s:  # false for nan too
                self._note_standstill()
                raise CommandRefusedError(
                    f"targets: got {age_s:.3f} s old; allowed: 0 to {self._expiry_s:g} s"
                )
        except CommandRefusedError:
            self.counters.refused += 1
            raise

    def _watch(self, state: RobotState) -> None:
        """Latch a stop for a fall, a fault, a state without information, or a silent controller."""
        now_s = self.clock.now_s
        self._watch_pose(state, now_s)
        repeated = self._joints.look(state, self._accepted_rad, now_s)
        if repeated or not (all_finite(state.joint_positions_rad) and state.age_s <= self._expiry_s):
            self.stop("state" if state.fault is None else f"fault: {state.fault}")
        if state.stopped is not None:
            self.stop(state.stopped)
        if not state.healthy:
            self.stop("fault" if state.fault is None else f"fault: {state.fault}")
        if state.servos is not None:
            self._watch_temperatures(state.servos.temperatures_c, now_s)
        if self._battery.low(state.battery_v, state.low_battery_v, now_s):
            self.stop(f"{LOW_BATTERY}: {self._battery.voltage_v:.1f} V")
        if self._accepted_at_s is not None and now_s - self._accepted_at_s > self._expiry_s:
            self.stop("expired")

    def _watch_temperatures(self, reported_c: FloatArray, now_s: float) -> None:
        temperatures_c = self._temperatures.take(reported_c, now_s)
        hottest = int(np.argmax(np.nan_to_num(temperatures_c, nan=-np.inf)))
        if temperatures_c[hottest] >= TOO_HOT_C:
            self.stop(f"{HOT}: {joint_in_words(hottest)} {temperatures_c[hottest]:.0f} C")

    def _watch_pose(self, state: RobotState, now_s: float) -> None:
        orientation, tilt = state.base_quaternion_world, self._tilt_of(state)
        position, moving = state.base_position_world, self.in_motion
        place = None if position is None else joined(position, orientation)
        for part, value in (("position", place), ("orientation", orientation), ("tilt", tilt)):
            self.poses.look(part, value, now_s, moving=moving)
            if value is None:
                continue
            checked_already = part == "tilt" and value is orientation
            if not checked_already and not all_finite(value[:3] if part == "position" else value):
                self.stop("state")
        if self.poses.oldest_s(now_s) > LONGEST_UNSEEN_S:
            self.stop(POSE_LOST)
        if tilt is None:
            return
        _, x, y, _ = tilt.tolist()
        self.leaning_ticks = self.leaning_ticks + 1 if cos_tilt(x, y) < FALL_COS_TILT else 0
        if self.leaning_ticks >= FALL_TICKS:
            self.stop("fell")
