"""Calibration of servos without position feedback: motors move the joints, and the operator judges by eye."""

import math
from collections.abc import Callable

import numpy as np

from hexctl.backends.base import CalibratedServos
from hexctl.control.calibration.backdriving import described_pose
from hexctl.control.calibration.operator import (
    SEEN,
    CalibrationResult,
    EndedError,
    Operator,
    ask,
    measured_deg,
)
from hexctl.control.guard import Guard
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.servos.raw_map import RawMap, reference_deg
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, FloatArray, JointTargets

#: Joint speed while an operator has fingers near it.
SPEED_DEG_S = 20.0

#: Distance within which a joint has reached its target.
NEAR_DEG = 0.05

#: Movement that shows in which direction a joint turns.
NUDGE_DEG = 8.0

#: Answers that move a joint.
STEPS_DEG = {"+": 1.0, "-": -1.0, "++": 5.0, "--": -5.0}
FARTHEST_DEG = 45.0

READY = (
    "Hold the robot up so that its legs hang free. Switch the servos' supply on, then press Enter: they jump "
    "to their places:"
)
STEP_HELP = f"+ or - 1 deg, ++ or -- 5, a number of degrees up to {FARTHEST_DEG:g}"


class JoggedCalibration:
    """Asks the operator about each joint, and saves it before the next.

    All joints are held, and one at a time is moved, slowly, always through the guard.
    """

    def __init__(
        self,
        guard: Guard,
        servos: CalibratedServos,
        operator: Operator,
        result: CalibrationResult,
        stop_requested: Callable[[], bool],
    ) -> None:
        self._guard, self._servos, self._robot = guard, servos, guard.robot
        self._operator, self._result, self._stop_requested = operator, result, stop_requested
        self._targets_rad: FloatArray = guard.accepted_rad().copy()
        self._assume_in_range()

    def run(self, joints: list[int]) -> None:
        """Calibrate some joints, 0..17, until done or ended by the operator."""
        try:
            self._ask(READY, holding=False)
            for number, joint in enumerate(joints, start=1):
                name, servo = JOINT_NAMES[joint], self._map.servo_name(joint)
                self._operator.tell(f"{name}, {servo} ({number} of {len(joints)})")
                self._calibrate(joint)
                self._result.save(joint, self._map)
        except EndedError:
            pass

    @property
    def _map(self) -> RawMap:
        return self._servos.servo_map

    def _angle_deg(self, joint: int) -> float:
        return math.degrees(self._targets_rad[joint])

    def _raw(self, joint: int) -> float:
        """The pulse or count that the servo of a joint gets."""
        return float(self._map.raw(self._targets_rad)[joint])

    def _assume_in_range(self) -> None:
        """Begin with a map in which every joint is within its range.

        The guard would otherwise move a joint back into its range at full speed, by an uncalibrated angle.
        """
        robot, servo_map = self._robot, self._map
        within_rad = np.clip(self._targets_rad, robot.joint_lower_rad, robot.joint_upper_rad)
        for joint in np.flatnonzero(within_rad != self._targets_rad).tolist():
            assumed_deg, true_deg = math.degrees(self._targets_rad[joint]), math.degrees(within_rad[joint])
            servo_map = servo_map.referenced(joint, assumed_deg, true_deg)
        if servo_map is not self._map:
            self._remap(servo_map)

    def _remap(self, servo_map: RawMap) -> None:
        """Continue with another servo map: nothing moves, raw positions mean other angles."""
        raw = self._map.raw(self._targets_rad)
        self._servos.remap(servo_map)
        self._targets_rad = servo_map.angles_rad(raw)
        self._guard.clear()

    def _move(self, joint: int, to_deg: float) -> bool:
        """Move one joint slowly; True once it is there, False if a limit is nearer."""
        step_deg = SPEED_DEG_S * self._guard.clock.period_s
        while True:
            before_deg = self._angle_deg(joint)
            missing_deg = to_deg - before_deg
            if abs(missing_deg) < NEAR_DEG:
                return True
            self._targets_rad[joint] += math.radians(float(np.clip(missing_deg, -step_deg, step_deg)))
            self._tick()
            if abs(self._angle_deg(joint) - before_deg) < NEAR_DEG / 10:
                return False

    def _tick(self, *, holding: bool = True) -> None:
        """Send the targets for one tick, or only read; raises EndedError or RobotFaultError."""
        if self._stop_requested():
            raise EndedError
        tick = self._guard.clock.tick()
        self._guard.read()
        if self._guard.stopped is not None:
            raise RobotFaultError(
                f"stopped: {self._guard.stopped}; every joint done is saved; run it again for the rest"
            )
        if holding:
            sent = self._guard.write(JointTargets(self._targets_rad, tick.time_s))
            self._targets_rad = sent.joint_positions_rad.copy()

    def _calibrate(self, joint: int) -> None:
        home_deg = self._angle_deg(joint)
        self._find_sign(joint)
        self._find_offset(joint)
        self._find_limits(joint)
        self._move(joint, home_deg)

    def _find_sign(self, joint: int) -> None:
        kind = JOINT_KINDS[joint % JOINTS_PER_LEG]
        at_deg = self._angle_deg(joint)
        up = at_deg + NUDGE_DEG <= math.degrees(self._robot.joint_upper_rad[joint])
        seen = SEEN[kind][0 if up else 1]
        if self._ask("  watch this joint. Enter to move it, skip:") == "skip":
            return
        while True:
            self._move(joint, at_deg + (NUDGE_DEG if up else -NUDGE_DEG))
            answer = self._ask(f"  did it move {seen}? yes, no, again, skip:")
            self._move(joint, at_deg)
            if answer in ("n", "no"):
                self._remap(self._map.flipped(joint, at_deg))
            if answer in ("y", "yes", "n", "no", "skip"):
                return

    def _find_offset(self, joint: int) -> None:
        lower, upper = (
            math.degrees(limit[joint]) for limit in (self._robot.joint_lower_rad, self._robot.joint_upper_rad)
        )
        true_deg = reference_deg(lower, upper) + 0.0  # no -0
        self._move(joint, true_deg)
        self._operator.tell(
            f"  turn it to {true_deg:g} deg; with the body level {self._seen(joint, true_deg)}"
        )
        while True:
            answer = self._ask(f"  {STEP_HELP}, at DEGREES if you measured, ok, skip:")
            told_deg = measured_deg(answer)
            if answer == "skip":
                return
            if answer == "ok" or told_deg is not None:
                true_deg = true_deg if told_deg is None else told_deg
                if not lower <= true_deg <= upper:
                    self._operator.tell(f"  got {true_deg:g}; allowed: {lower:g} to {upper:g} deg")
                    continue
                assumed_deg = self._angle_deg(joint)
                self._remap(self._map.referenced(joint, assumed_deg, true_deg))
                return
            self._step(joint, answer, f"{STEP_HELP}, at DEGREES, ok, skip, quit")

    def _seen(self, joint: int, angle_deg: float) -> str:
        """Description of a joint at an angle, with the other joints of its leg unchanged."""
        leg, kind = divmod(joint, JOINTS_PER_LEG)
        pose_deg = [self._angle_deg(JOINTS_PER_LEG * leg + each) for each in range(JOINTS_PER_LEG)]
        pose_deg[kind] = angle_deg
        coxa_deg, femur_deg, tibia_deg = pose_deg
        return described_pose(self._robot, (coxa_deg, femur_deg, tibia_deg))[kind].partition(": ")[2]

    def _find_limits(self, joint: int) -> None:
        """Take the raw positions of both ends of the travel; a skipped end keeps its limit."""
        servo_map = self._map
        lowest, highest = servo_map.least[joint], servo_map.most[joint]
        low, high = (lowest, highest) if servo_map.signs[joint] > 0 else (highest, lowest)
        low = self._find_end(joint, "lower", float(low))
        high = self._find_end(joint, "upper", float(high))
        try:
            self._remap(servo_map.limited(joint, (low, high)))
        except InputError as error:
            self._operator.tell(f"  {error}; the limits stay as they were")

    def _find_end(self, joint: int, which: str, limit: float) -> float:
        while True:
            angle_deg = round(self._angle_deg(joint), 1) + 0.0  # no -0
            place = f"{angle_deg:.1f} deg, {self._raw(joint):.0f} {self._map.unit}"
            answer = self._ask(f"  {which} end of its travel ({place}): {STEP_HELP}, ok, skip:")
            if answer == "skip":
                return limit
            if answer == "ok":
                return self._raw(joint)
            self._step(joint, answer, f"{STEP_HELP}, ok, skip, quit")

    def _step(self, joint: int, answer: str, allowed: str) -> None:
        by_deg = _by_deg(answer)
        if by_deg is None:
            self._operator.tell(f"  got {answer!r}; allowed: {allowed}")
        elif not self._move(joint, self._angle_deg(joint) + by_deg):
            self._operator.tell("  it is at the end of its range in the robot file, or of its servo")

    def _ask(self, question: str, *, holding: bool = True) -> str:
        """The operator's answer while joints are held; raises EndedError for `quit` and a stop."""
        return ask(self._operator, question, lambda: self._tick(holding=holding))


def _by_deg(answer: str) -> float | None:
    if answer in STEPS_DEG:
        return STEPS_DEG[answer]
    try:
        value = float(answer)
    except ValueError:
        return None
    return value if abs(value) <= FARTHEST_DEG else None  # not for nan
