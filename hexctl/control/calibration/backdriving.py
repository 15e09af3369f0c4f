"""Calibration of servos with position feedback: torque is off, and the operator moves the joints by hand."""

import math
from collections.abc import Callable
from itertools import groupby

import numpy as np

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
from hexctl.robot.model import Robot
from hexctl.robot.servos.raw_map import RawMap, reference_deg
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, FloatArray

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

READY = (
    "Servos with feedback are moved by hand. They lose their torque now, and the robot drops: support its "
    "body so that its legs hang free. Enter when ready:"
)
LIMP = "torque is off: the joints can be moved by hand, and no motor moves"
STILL_LIMP = "torque is off and stays off until hexctl run or serve switches it on"


class BackdrivenCalibration:
    """Asks the operator to pose legs and joints by hand, reads them, and saves each finished joint.

    It never writes to the guard; a requested stop ends it.
    """

    def __init__(
        self,
        guard: Guard,
        servo_map: RawMap,
        operator: Operator,
        result: CalibrationResult,
        stop_requested: Callable[[], bool],
    ) -> None:
        self._guard, self._map, self._read_map = guard, servo_map, servo_map
        self._operator, self._result, self._stop_requested = operator, result, stop_requested

    def run(self, joints: list[int]) -> None:
        """Calibrate some joints, 0..17, leg by leg, until done or ended by the operator."""
        try:
            self._ask(READY)
            if not self._guard.disable_torque():
                raise RobotFaultError("the servos did not let go; joints cannot be moved by hand")
            self._operator.tell(LIMP)
            try:
                for leg, group in groupby(joints, key=lambda joint: joint // JOINTS_PER_LEG):
                    self._calibrate(leg, list(group))
            finally:
                self._operator.tell(STILL_LIMP)
        except EndedError:
            pass

    def _calibrate(self, leg: int, joints: list[int]) -> None:
        posed = self._pose(leg, joints)
        for joint in joints:
            reference = posed.get(joint)
            self._operator.tell(f"{JOINT_NAMES[joint]}, {self._map.servo_name(joint)}")
            while not self._find_ends(joint, reference):
                pass
            found = self._map
            self._operator.tell(
                f"  sign {found.signs[joint]:g}, offset {found.offsets_deg[joint]:g} deg, "
                f"{found.least[joint]:g} to {found.most[joint]:g} {found.unit}"
            )
            self._result.save(joint, found)

    def _pose(self, leg: int, joints: list[int]) -> dict[int, float]:
        """Reference the joints in their leg's reference pose; their raw positions there, empty if skipped."""
        pose_deg = leg_pose_deg(self._guard.robot, leg)
        self._operator.tell(f"leg {leg + 1}: level the body and put the leg into this pose, as in a jig:")
        for text in described_pose(self._guard.robot, pose_deg):
            self._operator.tell(f"  {text}")
        which = "" if len(joints) > 1 else ", at DEGREES if you measured its joint"
        while True:
            answer = self._ask(f"  Enter when leg {leg + 1} is in it and still{which}, skip:")
            if answer == "skip":
                return {}
            told_deg = measured_deg(answer) if len(joints) == 1 else None
            if answer and told_deg is None:
                self._operator.tell(f"  got {answer!r}; allowed: Enter{which}, skip, quit")
                continue
            raw = self._still(joints)
            if raw is None:
                continue
            for joint in joints:
                assumed_deg = math.degrees(self._map.angles_rad(raw)[joint])
                true_deg = pose_deg[joint % JOINTS_PER_LEG] if told_deg is None else told_deg
                self._map = self._map.referenced(joint, assumed_deg, true_deg)
            return {joint: float(raw[joint]) for joint in joints}

    def _find_ends(self, joint: int, reference: float | None) -> bool:
        """Set limits from both ends, and the sign from their order or a movement; False to try again."""
        kind = JOINT_KINDS[joint % JOINTS_PER_LEG]
        up, down = SEEN[kind]
        low = self._read(joint, f"  move it {down}, as far as it may go, and hold it. Enter, skip:")
        high = None if low is None else self._read(joint, f"  now {up}, as far as it may go. Enter, skip:")
        if low is None or high is None:
            return self._find_sign(joint, reference, up)
        if not self._moved(joint, low, high):
            return False
        if reference is not None and not min(low, high) < reference < max(low, high):
            self._operator.tell(
                f"  got counts {low:.0f} and {high:.0f}, and {reference:.0f} in the pose; allowed: the pose "
                "between both ends. Was it moved the other way? Else its counts start again within its "
                "travel: take the horn off, turn the servo by a quarter, and pose the leg again"
            )
            return False
        try:
            limited = self._map.limited(joint, (low, high))
        except InputError as error:
            self._operator.tell(f"  {error}")
            return False
        self._map = limited
        self._turn(joint, rises=high > low, reference=reference if reference is not None else low)
        return True

    def _find_sign(self, joint: int, reference: float | None, up: str) -> bool:
        before = self._read(joint, "  its direction: hold it anywhere in its travel. Enter, skip:")
        after = None if before is None else self._read(joint, f"  move it {up}, 10 deg or more. Enter, skip:")
        if before is None or after is None:
            return True
        if not self._moved(joint, before, after):
            return False
        self._turn(joint, rises=after > before, reference=reference if reference is not None else before)
        return True

    def _moved(self, joint: int, before: float, after: float) -> bool:
        moved_deg = abs(after - before) / self._map.per_deg[joint]
        if moved_deg < LEAST_MOVE_DEG:
            self._operator.tell(f"  it moved by {moved_deg:.1f} deg; allowed: {LEAST_MOVE_DEG:g} or more")
        return bool(moved_deg >= LEAST_MOVE_DEG)

    def _turn(self, joint: int, *, rises: bool, reference: float) -> None:
        """Set the sign; the angle at the raw position `reference` stays the same."""
        if rises != (self._map.signs[joint] > 0):
            raw = self._map.centre.copy()
            raw[joint] = reference
            self._map = self._map.flipped(joint, math.degrees(self._map.angles_rad(raw)[joint]))

    def _read(self, joint: int, question: str) -> float | None:
        while True:
            answer = self._ask(question)
            if answer == "skip":
                return None
            if answer:
                self._operator.tell(f"  got {answer!r}; allowed: Enter, skip, quit")
            elif (raw := self._still([joint])) is not None:
                return float(raw[joint])

    def _still(self, joints: list[int]) -> FloatArray | None:
        """Mean raw positions, (18,), of joints that do not move; None after reporting the reason.

        A measurement counts once: a bus reads only some of its servos in a tick.
        """
        taken: dict[int, list[float]] = {joint: [] for joint in joints}
        measured_at_s = dict.fromkeys(joints, -math.inf)
        begin_s = self._guard.clock.now_s
        while self._guard.clock.now_s - begin_s < PATIENCE_S:
            raw, at_s = self._tick()
            for joint in joints:
                if at_s[joint] > measured_at_s[joint] + AGAIN_S:
                    measured_at_s[joint] = at_s[joint]
                    taken[joint] = [*taken[joint], float(raw[joint])][-READS:]
            if all(len(values) == READS for values in taken.values()) and not self._moving(taken):
                means = self._map.centre.copy()
                means[joints] = [float(np.mean(taken[joint])) for joint in joints]
                return means
        unheard = [joint for joint, values in taken.items() if len(values) < READS]
        names = ", ".join(JOINT_NAMES[joint] for joint in unheard or self._moving(taken))
        why = "is not heard; are its cable and its power in?" if unheard else "moves; hold it still"
        self._operator.tell(f"  {names} {why}")
        return None

    def _moving(self, taken: dict[int, list[float]]) -> list[int]:
        per_deg = self._map.per_deg
        return [
            joint
            for joint, values in taken.items()
            if max(values) - min(values) > max(STILL_DEG * per_deg[joint], 2.0)  # AX and LX: two counts
        ]

    def _tick(self) -> tuple[FloatArray, FloatArray]:
        """Raw positions, (18,), and their times, (18,); raises EndedError or RobotFaultError."""
        if self._stop_requested():
            raise EndedError
        self._guard.clock.tick()
        state = self._guard.read()
        if self._guard.stopped is not None and not self._guard.hot:  # a limp servo cools
            raise RobotFaultError(
                f"stopped: {self._guard.stopped}; every joint done is saved; run it again for the rest"
            )
        ages_s = np.full(len(JOINT_NAMES), state.age_s) if state.servos is None else state.servos.ages_s
        return self._read_map.raw(state.joint_positions_rad), self._guard.clock.now_s - ages_s

    def _ask(self, question: str) -> str:
        return ask(self._operator, question, self._tick)


def leg_pose_deg(robot: Robot, leg: int) -> tuple[float, ...]:
    """Joint angles of a leg, 0..5, in its reference pose."""
    joints = range(JOINTS_PER_LEG * leg, JOINTS_PER_LEG * (leg + 1))
    lower, upper = np.degrees(robot.joint_lower_rad), np.degrees(robot.joint_upper_rad)
    return tuple(reference_deg(float(lower[joint]), float(upper[joint])) + 0.0 for joint in joints)  # no -0


def described_pose(robot: Robot, pose_deg: tuple[float, ...]) -> tuple[str, str, str]:
    """Description of a leg in a pose, a line per link, as seen with a protractor or a level."""
    _, femur, tibia = (math.degrees(math.atan2(up, out)) for out, up in robot.link_vectors_m.tolist())
    coxa_deg, femur_deg, tibia_deg = pose_deg
    aside = f"{abs(coxa_deg):g} deg {SEEN['coxa'][0 if coxa_deg > 0 else 1]} from " if coxa_deg else ""
    femur_rises, tibia_rises = femur + femur_deg, tibia + femur_deg + tibia_deg
    return (
        f"coxa {coxa_deg:g} deg: the leg points {aside}straight away from its mount",
        f"femur {femur_deg:g} deg: the line from its axis to the tibia's axis {_slope(femur_rises)}",
        f"tibia {tibia_deg:g} deg: the line from its axis to the tip of the foot {_slope(tibia_rises)}",
    )


def _slope(rises_deg: float) -> str:
    rises_deg = (rises_deg + 180) % 360 - 180
    if abs(rises_deg) < 0.5:
        return "is level"
    if abs(rises_deg + 90) < 0.5:
        return "points straight down"
    if abs(rises_deg - 90) < 0.5:
        return "points straight up"
    inward, steep = abs(rises_deg) > 90, min(abs(rises_deg), 180 - abs(rises_deg))
    way = "above" if rises_deg > 0 else "below"
    return f"runs {'inward' if inward else 'outward'}, {steep:.0f} deg {way} level"
