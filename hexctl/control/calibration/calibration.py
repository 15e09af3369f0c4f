"""A calibration: where the joints are, what their servo map says, and what of it is saved, joint by joint.

The console and the page are its two faces: they ask and show, and this changes the map and moves joints.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hexctl.backends.base import CalibratedServos
from hexctl.control.calibration.operator import CalibrationResult, EndedError
from hexctl.control.calibration.reference_pose import leg_pose_deg
from hexctl.control.guard import Guard
from hexctl.errors import EStopError, InputError, RobotFaultError
from hexctl.robot.servos.raw_map import RawMap, joints_without_stance, stance_problems
from hexctl.types import JOINT_NAMES, JOINTS_PER_LEG, FloatArray, JointTargets

#: Joint speed while an operator has fingers near it.
SPEED_DEG_S = 20.0

#: Distance within which a joint has reached its target.
NEAR_DEG = 0.05

#: Number of averaged measurements of a joint.
READS = 8

#: A joint moves if its measurements differ by more; hands shake by about a third of that.
STILL_DEG = 1.0

#: How long to wait for enough measurements of a resting joint.
PATIENCE_S = 4.0

#: Minimum time between two measurements.
AGAIN_S = 0.003

#: Minimum movement that shows the direction of the counts.
LEAST_MOVE_DEG = 5.0

#: Reason of a stop after which a calibration may go on.
STOP_BUTTON = "stop button"


@dataclass(eq=False)
class Calibration(ABC):
    """Servos of a robot while their map is changed; a requested stop ends it.

    Attributes:
        by_hand: whether limp joints are moved by hand, and read; else their motors move them.
        result: what is saved.
    """

    by_hand: ClassVar[bool]

    guard: Guard
    servos: CalibratedServos
    result: CalibrationResult
    stop_requested: Callable[[], bool]

    def __post_init__(self) -> None:
        self.robot = self.guard.robot
        self._earlier: list[tuple[int, RawMap, dict[int, float]]] = []
        self._references: dict[int, float] = {}  # raw positions of joints in the reference pose, by hand

    @property
    @abstractmethod
    def map(self) -> RawMap:
        """The servo map, as changed so far."""

    @property
    @abstractmethod
    def raw(self) -> FloatArray:
        """Raw position of each joint, (18,)."""

    @abstractmethod
    def begin(self) -> None:
        """Power the joints, or let them go limp; raises RobotFaultError."""

    @abstractmethod
    def tick(self) -> None:
        """Wait for the next tick and read the robot; raises EndedError or RobotFaultError."""

    @abstractmethod
    def measured(self, joints: Sequence[int]) -> FloatArray:
        """Raw positions (18,) of joints at rest; raises InputError for one that moves or is not heard."""

    @abstractmethod
    def _replace(self, servo_map: RawMap) -> None:
        """Continue with another servo map; nothing moves."""

    @property
    def angles_deg(self) -> FloatArray:
        """Angle of each joint, (18,), by the map."""
        return np.degrees(self.map.angles_rad(self.raw))

    def angle_deg(self, joint: int) -> float:
        """Angle of a joint, 0..17, by the map."""
        return float(self.angles_deg[joint])

    def flip(self, joint: int, at_raw: float | None = None) -> None:
        """Reverse the direction of a joint; its angle at a raw position, or where it is, stays the same."""
        self._change(joint, self.map.flipped(joint, self.angle_at(joint, at_raw)))

    def reference(self, joints: Sequence[int], true_deg: float | None = None) -> None:
        """Set the angles of joints of one leg where they are: its reference pose, or one joint's true angle.

        Raises InputError for an angle beyond the joint's range, and what `measured` raises.
        """
        self._check_angle(joints[0], true_deg)
        raw, servo_map = self.measured(joints), self.map
        pose_deg = leg_pose_deg(self.robot, joints[0] // JOINTS_PER_LEG)
        assumed_deg = np.degrees(servo_map.angles_rad(raw))
        for joint in joints:
            true = pose_deg[joint % JOINTS_PER_LEG] if true_deg is None else true_deg
            servo_map = servo_map.referenced(joint, float(assumed_deg[joint]), true)
        self._change(joints[0], servo_map)
        self._references = self._references | {joint: float(raw[joint]) for joint in joints}

    def limits(self, joint: int) -> tuple[float, float]:
        """Raw positions of the lower and the upper end of a joint's travel."""
        least, most = float(self.map.least[joint]), float(self.map.most[joint])
        return (least, most) if self.map.signs[joint] > 0 else (most, least)

    def limit(self, joint: int, lower: float, upper: float) -> None:
        """Set the raw positions of both ends of a joint's travel.

        Raises InputError for ends too near to each other, and for ends that exclude the stance.
        """
        limited = self.map.limited(joint, (lower, upper))
        check_joint(self, joint, limited)
        self._change(joint, limited)

    def undo(self) -> int | None:
        """Take the last change back; its joint, 0..17, or None without one."""
        if not self._earlier:
            return None
        joint, servo_map, self._references = self._earlier.pop()
        self._replace(servo_map)
        return joint

    @property
    def changed(self) -> bool:
        """Whether there is a change to undo."""
        return bool(self._earlier)

    def save(self, joint: int) -> None:
        """Write the map of a joint, 0..17; raises InputError for limits that exclude its stance."""
        check_joint(self, joint, self.map)
        self.result.save(joint, self.map)

    def resume(self) -> None:
        """Clear a latched stop."""
        self.guard.clear()

    def _change(self, joint: int, servo_map: RawMap) -> None:
        before = joint, self.map, self._references
        self._replace(servo_map)
        self._earlier.append(before)

    def angle_at(self, joint: int, raw: float | None) -> float:
        """Angle in deg of a joint, 0..17, at a raw position, or where it is."""
        at = self.raw.copy()
        if raw is not None:
            at[joint] = raw
        return math.degrees(self.map.angles_rad(at)[joint])

    def _check_angle(self, joint: int, true_deg: float | None) -> None:
        lower, upper = (
            float(np.degrees(ends[joint]))
            for ends in (self.robot.joint_lower_rad, self.robot.joint_upper_rad)
        )
        if not self.by_hand and true_deg is not None and not lower <= true_deg <= upper:
            raise InputError(f"got {true_deg:g}; allowed: {lower:g} to {upper:g} deg")

    def _check_running(self, stopped: str | None) -> None:
        if self.stop_requested():
            raise EndedError
        if stopped not in (None, STOP_BUTTON):
            raise RobotFaultError(f"stopped: {stopped}; every joint done is saved; run it again for the rest")


def check_joint(calibration: Calibration, joint: int, servo_map: RawMap) -> None:
    """Raise InputError for limits of a joint, 0..17, that exclude its stance."""
    name = JOINT_NAMES[joint]
    excluded = joints_without_stance(servo_map, calibration.robot)
    if name in excluded:
        raise InputError(stance_problems({name: excluded[name]})[0])


class JoggedCalibration(Calibration):
    """Servos without position feedback: all joints are held, and motors move one at a time."""

    by_hand = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._targets_rad: FloatArray = self.guard.accepted_rad().copy()
        self._holds = False
        self._assume_in_range()

    @property
    def map(self) -> RawMap:
        """The servo map that the servos have."""
        return self.servos.servo_map

    @property
    def raw(self) -> FloatArray:
        """The pulse or count that each servo gets, (18,)."""
        return self.map.raw(self._targets_rad)

    def begin(self) -> None:
        """Hold all joints from the next tick on."""
        self._holds = True

    def tick(self) -> None:
        """Send the targets for one tick, once begun; while a stop is latched only read."""
        self._check_running(None)
        tick = self.guard.clock.tick()
        self.guard.read()
        if self.guard.stopped == "expired" and self.guard.lift_silence():  # a busy moment: the joints rested
            self._targets_rad = self.guard.accepted_rad().copy()
        self._check_running(self.guard.stopped)
        if self._holds and self.guard.stopped is None:
            try:
                sent = self.guard.write(JointTargets(self._targets_rad, tick.time_s))
            except EStopError:
                return  # stopped in this moment
            self._targets_rad = sent.joint_positions_rad.copy()

    def measured(self, joints: Sequence[int]) -> FloatArray:
        """Raw positions (18,) that the servos get."""
        return self.raw

    def jog(self, joint: int, share: float) -> None:
        """Move a joint for one tick, by a share -1..1 of the speed."""
        if self._holds and self.guard.stopped is None:
            step_rad = math.radians(SPEED_DEG_S * self.guard.clock.period_s)
            self._targets_rad[joint] += step_rad * max(-1.0, min(1.0, share))

    def move(self, joint: int, to_deg: float) -> bool:
        """Move a joint slowly; True once it is there, False if a limit is nearer."""
        step_deg = SPEED_DEG_S * self.guard.clock.period_s
        while True:
            before_deg = math.degrees(self._targets_rad[joint])
            missing_deg = to_deg - before_deg
            if abs(missing_deg) < NEAR_DEG:
                return True
            self.jog(joint, missing_deg / step_deg)
            self.tick()
            if abs(math.degrees(self._targets_rad[joint]) - before_deg) < NEAR_DEG / 10:
                return False

    def resume(self) -> None:
        """Clear a latched stop; the joints are held where they are."""
        super().resume()
        self._targets_rad = self.guard.accepted_rad().copy()

    def _assume_in_range(self) -> None:
        """Begin with a map in which every joint is within its range.

        The guard would otherwise move a joint back into its range at full speed, by an uncalibrated angle.
        """
        servo_map = self.map
        within_rad = np.clip(self._targets_rad, self.robot.joint_lower_rad, self.robot.joint_upper_rad)
        for joint in np.flatnonzero(within_rad != self._targets_rad).tolist():
            assumed_deg, true_deg = math.degrees(self._targets_rad[joint]), math.degrees(within_rad[joint])
            servo_map = servo_map.referenced(joint, assumed_deg, true_deg)
        if servo_map is not self.map:
            self._replace(servo_map)

    def _replace(self, servo_map: RawMap) -> None:
        raw = self.raw
        self.servos.remap(servo_map)
        self._targets_rad = servo_map.angles_rad(raw)
        if self.guard.stopped is None:
            self.guard.clear()


class BackdrivenCalibration(Calibration):
    """Servos with position feedback: torque is off, hands move the joints, and nothing is commanded."""

    by_hand = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._read_map = self._map = self.servos.servo_map
        self._raw = self._read_map.raw(self.guard.read().joint_positions_rad)
        self._at_s: FloatArray = np.full(len(JOINT_NAMES), -np.inf)

    @property
    def map(self) -> RawMap:
        """The servo map; that of the servos stays as it was."""
        return self._map

    @property
    def raw(self) -> FloatArray:
        """The newest count of each joint, (18,)."""
        return self._raw

    def begin(self) -> None:
        """Let the joints go limp; raises RobotFaultError if they do not."""
        if not self.guard.disable_torque():
            raise RobotFaultError("the servos did not let go; joints cannot be moved by hand")

    def tick(self) -> None:
        """Read the counts of a tick."""
        self._check_running(None)
        self.guard.clock.tick()
        state = self.guard.read()
        self._check_running(None if self.guard.hot else self.guard.stopped)  # a limp servo cools
        ages_s = np.full(len(JOINT_NAMES), state.age_s) if state.servos is None else state.servos.ages_s
        self._raw, self._at_s = self._read_map.raw(state.joint_positions_rad), self.guard.clock.now_s - ages_s

    def measured(self, joints: Sequence[int]) -> FloatArray:
        """Mean counts (18,) of joints that do not move; takes up to `PATIENCE_S`.

        A measurement counts once: a bus reads only some of its servos in a tick.
        """
        taken: dict[int, list[float]] = {joint: [] for joint in joints}
        measured_at_s = dict.fromkeys(joints, -math.inf)
        begin_s = self.guard.clock.now_s
        while self.guard.clock.now_s - begin_s < PATIENCE_S:
            self.tick()
            for joint in joints:
                if self._at_s[joint] > measured_at_s[joint] + AGAIN_S:
                    measured_at_s[joint] = self._at_s[joint]
                    taken[joint] = [*taken[joint], float(self._raw[joint])][-READS:]
            if all(len(values) == READS for values in taken.values()) and not self._moving(taken):
                means = self._raw.copy()
                means[list(joints)] = [float(np.mean(taken[joint])) for joint in joints]
                return means
        unheard = [joint for joint, values in taken.items() if len(values) < READS]
        names = ", ".join(JOINT_NAMES[joint] for joint in unheard or self._moving(taken))
        why = "is not heard; are its cable and its power in?" if unheard else "moves; hold it still"
        raise InputError(f"{names} {why}")

    def limit(self, joint: int, lower: float, upper: float) -> None:
        """Set both ends of a joint's travel; their order shows its direction."""
        self._check_moved(joint, lower, upper)
        reference = self._references.get(joint)
        if reference is not None and not min(lower, upper) < reference < max(lower, upper):
            raise InputError(
                f"got counts {lower:.0f} and {upper:.0f}, and {reference:.0f} in the pose; allowed: the pose "
                "between both ends. Was it moved the other way? Else its counts start again within its "
                "travel: take the horn off, turn the servo by a quarter, and pose the leg again"
            )
        turned = self._turned(joint, upper > lower, lower if reference is None else reference)
        limited = turned.limited(joint, (lower, upper))
        check_joint(self, joint, limited)
        self._change(joint, limited)

    def turn(self, joint: int, before: float, after: float) -> None:
        """Set the direction of a joint that was moved to larger angles, between two counts."""
        self._check_moved(joint, before, after)
        self._change(joint, self._turned(joint, after > before, self._references.get(joint, before)))

    def _turned(self, joint: int, rises: bool, reference: float) -> RawMap:
        """Map with the sign of a direction; the angle at the count `reference` stays the same."""
        if rises == (self.map.signs[joint] > 0):
            return self.map
        return self.map.flipped(joint, self.angle_at(joint, reference))

    def _check_moved(self, joint: int, before: float, after: float) -> None:
        moved_deg = abs(after - before) / self.map.per_deg[joint]
        if moved_deg < LEAST_MOVE_DEG:
            raise InputError(f"it moved by {moved_deg:.1f} deg; allowed: {LEAST_MOVE_DEG:g} or more")

    def _moving(self, taken: dict[int, list[float]]) -> list[int]:
        per_deg = self.map.per_deg
        return [
            joint
            for joint, values in taken.items()
            if max(values) - min(values) > max(STILL_DEG * per_deg[joint], 2.0)  # AX and LX: two counts
        ]

    def _replace(self, servo_map: RawMap) -> None:
        self._map = servo_map
