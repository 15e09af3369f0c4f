"""The console dialogue of a calibration by motors: they move the joints, and the operator judges by eye."""

import math
from collections.abc import Sequence

from hexctl.control.calibration.calibration import JoggedCalibration
from hexctl.control.calibration.operator import SEEN, EndedError, Operator, ask, done, measured_deg
from hexctl.control.calibration.reference_pose import seen_at
from hexctl.robot.servos.raw_map import reference_deg
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG

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


class JoggingDialogue:
    """Asks the operator about each joint, and saves it before the next."""

    def __init__(self, calibration: JoggedCalibration, operator: Operator) -> None:
        self._calibration, self._operator = calibration, operator

    def run(self, joints: Sequence[int]) -> None:
        """Calibrate some joints, 0..17, until done or ended by the operator."""
        try:
            self._ask(READY)
            self._calibration.begin()
            for number, joint in enumerate(joints, start=1):
                name, servo = JOINT_NAMES[joint], self._calibration.map.servo_name(joint)
                self._operator.tell(f"{name}, {servo} ({number} of {len(joints)})")
                self._calibrate(joint)
                done(self._operator, self._calibration.save, joint)
        except EndedError:
            pass

    def _calibrate(self, joint: int) -> None:
        home_deg = self._calibration.angle_deg(joint)
        self._find_sign(joint)
        self._find_offset(joint)
        while not self._find_limits(joint):
            pass
        self._calibration.move(joint, home_deg)

    def _find_sign(self, joint: int) -> None:
        calibration, at_deg = self._calibration, self._calibration.angle_deg(joint)
        up = at_deg + NUDGE_DEG <= math.degrees(calibration.robot.joint_upper_rad[joint])
        seen = SEEN[JOINT_KINDS[joint % JOINTS_PER_LEG]][0 if up else 1]
        if self._ask("  watch this joint. Enter to move it, skip:") == "skip":
            return
        answer = ""
        while answer not in ("y", "yes", "n", "no", "skip"):
            calibration.move(joint, at_deg + (NUDGE_DEG if up else -NUDGE_DEG))
            answer = self._ask(f"  did it move {seen}? yes, no, again, skip:")
            calibration.move(joint, at_deg)
        if answer in ("n", "no"):
            calibration.flip(joint)

    def _find_offset(self, joint: int) -> None:
        robot = self._calibration.robot
        lower, upper = (math.degrees(ends[joint]) for ends in (robot.joint_lower_rad, robot.joint_upper_rad))
        true_deg = reference_deg(lower, upper) + 0.0  # no -0
        self._calibration.move(joint, true_deg)
        seen = seen_at(robot, self._calibration.angles_deg, joint, true_deg)
        self._operator.tell(f"  turn it to {true_deg:g} deg; with the body level {seen}")
        while (answer := self._ask(f"  {STEP_HELP}, at DEGREES if you measured, ok, skip:")) != "skip":
            measured = measured_deg(answer)
            if answer != "ok" and measured is None:
                self._step(joint, answer, f"{STEP_HELP}, at DEGREES, ok, skip, quit")
                continue
            at_deg = true_deg if measured is None else measured
            if done(self._operator, self._calibration.reference, [joint], at_deg):
                return

    def _find_limits(self, joint: int) -> bool:
        """Set both ends of the travel; a skipped end keeps its limit. False to ask again."""
        before = self._calibration.limits(joint)
        low = self._find_end(joint, "lower", before[0])
        high = self._find_end(joint, "upper", before[1])
        return (low, high) == before or done(self._operator, self._calibration.limit, joint, low, high)

    def _find_end(self, joint: int, which: str, limit: float) -> float:
        while True:
            angle_deg = round(self._calibration.angle_deg(joint), 1) + 0.0  # no -0
            raw = float(self._calibration.raw[joint])
            place = f"{angle_deg:.1f} deg, {raw:.0f} {self._calibration.map.unit}"
            answer = self._ask(f"  {which} end of its travel ({place}): {STEP_HELP}, ok, skip:")
            if answer in ("skip", "ok"):
                return limit if answer == "skip" else raw
            self._step(joint, answer, f"{STEP_HELP}, ok, skip, quit")

    def _step(self, joint: int, answer: str, allowed: str) -> None:
        by_deg = _by_deg(answer)
        if by_deg is None:
            self._operator.tell(f"  got {answer!r}; allowed: {allowed}")
        elif not self._calibration.move(joint, self._calibration.angle_deg(joint) + by_deg):
            self._operator.tell("  it is at the end of its range in the robot file, or of its servo")

    def _ask(self, question: str) -> str:
        """The operator's answer; raises EndedError for `quit` and a stop."""
        return ask(self._operator, question, self._calibration.tick)


def _by_deg(answer: str) -> float | None:
    if answer in STEPS_DEG:
        return STEPS_DEG[answer]
    try:
        value = float(answer)
    except ValueError:
        return None
    return value if abs(value) <= FARTHEST_DEG else None  # not for nan
