"""The console dialogue of a calibration by hand: the operator poses limp legs and moves their joints."""

from collections.abc import Sequence
from itertools import groupby

from hexctl.control.calibration.calibration import BackdrivenCalibration
from hexctl.control.calibration.operator import SEEN, EndedError, Operator, ask, done, measured_deg
from hexctl.control.calibration.reference_pose import described_pose, leg_pose_deg
from hexctl.errors import InputError
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG

READY = (
    "Servos with feedback are moved by hand. They lose their torque now, and the robot drops: support its "
    "body so that its legs hang free. Enter when ready:"
)
LIMP = "torque is off: the joints can be moved by hand, and no motor moves"
STILL_LIMP = "torque is off and stays off until hexctl run or serve switches it on"


class BackdrivingDialogue:
    """Asks the operator to pose legs and joints by hand, reads them, and saves each finished joint."""

    def __init__(self, calibration: BackdrivenCalibration, operator: Operator) -> None:
        self._calibration, self._operator = calibration, operator

    def run(self, joints: Sequence[int]) -> None:
        """Calibrate some joints, 0..17, leg by leg, until done or ended by the operator."""
        try:
            self._ask(READY)
            self._calibration.begin()
            self._operator.tell(LIMP)
            try:
                for leg, group in groupby(joints, key=lambda joint: joint // JOINTS_PER_LEG):
                    self._calibrate(leg, list(group))
            finally:
                self._operator.tell(STILL_LIMP)
        except EndedError:
            pass

    def _calibrate(self, leg: int, joints: list[int]) -> None:
        self._pose(leg, joints)
        for joint in joints:
            self._operator.tell(f"{JOINT_NAMES[joint]}, {self._calibration.map.servo_name(joint)}")
            while not self._find_ends(joint):
                pass
            found = self._calibration.map
            self._operator.tell(
                f"  sign {found.signs[joint]:g}, offset {found.offsets_deg[joint]:g} deg, "
                f"{found.least[joint]:g} to {found.most[joint]:g} {found.unit}"
            )
            done(self._operator, self._calibration.save, joint)

    def _pose(self, leg: int, joints: list[int]) -> None:
        """Reference the joints in their leg's reference pose, or skip it."""
        robot = self._calibration.robot
        self._operator.tell(f"leg {leg + 1}: level the body and put the leg into this pose, as in a jig:")
        for text in described_pose(robot, leg_pose_deg(robot, leg)):
            self._operator.tell(f"  {text}")
        which = "" if len(joints) > 1 else ", at DEGREES if you measured its joint"
        while True:
            answer = self._ask(f"  Enter when leg {leg + 1} is in it and still{which}, skip:")
            if answer == "skip":
                return
            true_deg = measured_deg(answer) if len(joints) == 1 else None
            if answer and true_deg is None:
                self._operator.tell(f"  got {answer!r}; allowed: Enter{which}, skip, quit")
            elif done(self._operator, self._calibration.reference, joints, true_deg):
                return

    def _find_ends(self, joint: int) -> bool:
        """Set limits and direction from both ends, or the direction from a movement; False to try again."""
        up, down = SEEN[JOINT_KINDS[joint % JOINTS_PER_LEG]]
        low = self._read(joint, f"  move it {down}, as far as it may go, and hold it. Enter, skip:")
        high = None if low is None else self._read(joint, f"  now {up}, as far as it may go. Enter, skip:")
        if low is not None and high is not None:
            return done(self._operator, self._calibration.limit, joint, low, high)
        before = self._read(joint, "  its direction: hold it anywhere in its travel. Enter, skip:")
        after = None if before is None else self._read(joint, f"  move it {up}, 10 deg or more. Enter, skip:")
        if before is None or after is None:
            return True
        return done(self._operator, self._calibration.turn, joint, before, after)

    def _read(self, joint: int, question: str) -> float | None:
        """Count of a joint that is held still; None if skipped."""
        while (answer := self._ask(question)) != "skip":
            if answer:
                self._operator.tell(f"  got {answer!r}; allowed: Enter, skip, quit")
                continue
            try:
                return float(self._calibration.measured([joint])[joint])
            except InputError as error:
                self._operator.tell(f"  {error}")
        return None

    def _ask(self, question: str) -> str:
        return ask(self._operator, question, self._calibration.tick)
