"""Calibration in a page: one joint after another is moved while a finger is down, judged, and saved."""

from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.calibration.calibration import STOP_BUTTON, BackdrivenCalibration, JoggedCalibration
from hexctl.control.calibration.operator import SEEN, CalibrationResult, EndedError
from hexctl.control.calibration.reference_pose import described_pose, leg_pose_deg, seen_at
from hexctl.control.calibration.servo_calibration import chosen_joints, opened_calibration
from hexctl.control.drive.arbiter import COMMAND_EXPIRY_S, Velocity, VelocitySource
from hexctl.errors import InputError
from hexctl.teleop.control_page import ControlPage, page_html
from hexctl.teleop.page_options import PagedCalibrationOptions
from hexctl.teleop.robot_outline import legs_outline
from hexctl.time_source import WALL_TIME
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG
from hexctl.wire.page_address import PageAddress

#: An owner that is silent for this long loses the page to another client.
OWNED_S = 5.0

#: Ticks between two reports, and requests that wait at most.
REPORT_TICKS, MOST_WAITING = 5, 8

READY = {
    False: "Hold the robot up so that its legs hang free, and switch the supply of its servos on. They jump "
    "to their places when you press start.",
    True: "The servos lose their torque when you press start, and the robot drops. Support its body so that "
    "its legs hang free.",
}


class PagedCalibration:
    """The page's face of a calibration: requests of its owner change the map, a held button moves a joint.

    A joint moves only while jogs arrive, as velocities do in a drive. A stop is latched until `go on`.
    """

    def __init__(self, calibration: JoggedCalibration | BackdrivenCalibration, joints: Sequence[int]) -> None:
        self._calibration, self._joints = calibration, list(joints)
        self.source = VelocitySource("page", WALL_TIME.now, COMMAND_EXPIRY_S)
        self.saved = {joint for joint in joints if calibration.result.has(joint)}
        self._joint = next((joint for joint in joints if joint not in self.saved), joints[0])
        self._ends: list[float | None] = [None, None]
        self._begun = self._finished = False
        self._said, self._ticks = "", 0
        self._asked: deque[str] = deque(maxlen=MOST_WAITING)

    def ask(self, request: str) -> None:
        """Queue a request; thread-safe. A stop is immediate and drops the others."""
        if request == "stop":
            self._asked.clear()
            self._calibration.guard.stop(STOP_BUTTON)
            self.source.forget()
        else:
            self._asked.append(request)

    def run(self, report: Callable[[dict[str, Any]], None]) -> None:
        """Calibrate until the owner finishes or a stop is requested; raises RobotFaultError."""
        try:
            while not self._finished:
                if self._asked:
                    self._do(self._asked.popleft())
                jog = self.source.desired(WALL_TIME.now())
                if jog is not None and isinstance(self._calibration, JoggedCalibration):
                    self._calibration.jog(self._joint, jog.turn_rad_s)
                self._calibration.tick()
                if self._ticks % REPORT_TICKS == 0:
                    report(self.status())
                self._ticks += 1
        except EndedError:
            pass

    def _do(self, request: str) -> None:
        word, _, value = request.partition(" ")
        requests: dict[str, Callable[[str], None]] = {
            "start": self._start,
            "choose": self._choose,
            "flip": self._flip,
            "zero": self._zero,
            "lower": self._end,
            "upper": self._end,
            "undo": self._undo,
            "save": self._save,
            "go": self._go_on,
            "finish": self._finish,
        }
        if word not in requests or (not self._begun and word not in ("start", "choose", "go", "finish")):
            return
        try:
            self._said = ""
            requests[word](word if word in ("lower", "upper") else value)
        except InputError as error:
            self._said = str(error)

    def _start(self, _: str) -> None:
        self._calibration.begin()
        self._begun = True

    def _choose(self, value: str) -> None:
        if value.isdecimal() and int(value) in self._joints:
            self._joint, self._ends = int(value), [None, None]

    def _flip(self, _: str) -> None:
        self._calibration.flip(self._joint)
        self._ends = [None, None]

    def _zero(self, value: str) -> None:
        """Set the angle of the joint: its reference, or a measured one; by hand that of its whole leg."""
        try:
            true_deg = float(value) if value else None
        except ValueError:
            true_deg = float("nan")
        if true_deg is not None and not abs(true_deg) <= 360:
            raise InputError(f"got {value}; allowed: an angle in degrees")
        leg = self._joint // JOINTS_PER_LEG
        by_leg = self._calibration.by_hand and true_deg is None
        joints = [each for each in self._joints if each // JOINTS_PER_LEG == leg] if by_leg else [self._joint]
        self._calibration.reference(joints, true_deg)

    def _end(self, which: str) -> None:
        """Take an end of the travel where the joint is; both together are its limits."""
        raw = float(self._calibration.measured([self._joint])[self._joint])
        self._ends[which == "upper"] = raw
        lower, upper = self._ends
        if lower is not None and upper is not None:
            self._ends = [None, None]
            self._calibration.limit(self._joint, lower, upper)

    def _undo(self, _: str) -> None:
        if self._ends != [None, None]:
            self._ends = [None, None]
        elif (joint := self._calibration.undo()) is not None:
            self._joint = joint
            self.saved.discard(joint)

    def _save(self, _: str) -> None:
        if self._ends != [None, None]:
            raise InputError("got one end of the travel; allowed: both ends, or neither (undo)")
        self._calibration.save(self._joint)
        self.saved.add(self._joint)
        left = [joint for joint in self._joints if joint not in self.saved]
        after = [joint for joint in left if joint > self._joint]
        self._said = f"{JOINT_NAMES[self._joint]} is saved" if left else "every joint is saved: finish"
        self._joint = (after or left or [self._joint])[0]

    def _go_on(self, _: str) -> None:
        self.source.forget()
        self._calibration.resume()

    def _finish(self, _: str) -> None:
        self._finished = True

    def status(self) -> dict[str, Any]:
        """What the page shows, as plain values; angles in deg, raw positions in counts or microseconds."""
        calibration, joint, robot = self._calibration, self._joint, self._calibration.robot
        servo_map, angles_deg, raw = calibration.map, calibration.angles_deg, calibration.raw
        known, kind = bool(np.isfinite(angles_deg).all()), joint % JOINTS_PER_LEG
        pose_deg = leg_pose_deg(robot, joint // JOINTS_PER_LEG)
        limits = calibration.limits(joint)
        seen = (
            described_pose(robot, pose_deg)
            if calibration.by_hand
            else (seen_at(robot, angles_deg, joint, pose_deg[kind]) if known else "",)
        )
        return {
            "robot": robot.name,
            "begun": self._begun,
            "ready": READY[calibration.by_hand],
            "by_hand": calibration.by_hand,
            "joints": self._joints,
            "saved": sorted(self.saved),
            "joint": joint,
            "name": JOINT_NAMES[joint],
            "servo": servo_map.servo_name(joint),
            "unit": servo_map.unit,
            "angle_deg": round(float(angles_deg[joint]), 2) if known else None,
            "raw": round(float(raw[joint]), 1) if known else None,
            "sign": int(servo_map.signs[joint]),
            "offset_deg": round(float(servo_map.offsets_deg[joint]), 2),
            "limits": limits,
            "limits_deg": [round(calibration.angle_at(joint, each), 1) for each in limits],
            "ends": self._ends,
            "zero_deg": pose_deg[kind],
            "zero_seen": seen,
            "seen": SEEN[JOINT_KINDS[kind]],
            "undo": calibration.changed or self._ends != [None, None],
            "stopped": calibration.guard.stopped,
            "said": self._said,
            "legs": legs_outline(robot, np.radians(angles_deg), robot.gait.height * robot.size_m),
        }


def calibrate_on_page(
    robot: str | Path,
    options: PagedCalibrationOptions,
    *,
    say: Callable[[str], None],
    stop_requested: Callable[[], bool] = lambda: False,
) -> CalibrationResult:
    """Serve a page on which one client calibrates a robot, until it finishes; `say` takes its address.

    Raises what `hexctl.control.calibration.servo_calibration.calibrate` raises, and RobotFaultError for an
    address that cannot be served.
    """
    with opened_calibration(robot, options, stop_requested) as calibration:
        paged = PagedCalibration(calibration, chosen_joints(options.joints))
        page = ControlPage(
            PageAddress.parse(options.page or ""),
            page_html("calibrate"),
            paged.source,
            lambda _forward, _left, turn: Velocity(turn_rad_s=turn),
            paged.ask,
            credentials=options.page_credentials,
            owned_s=OWNED_S,
        )
        with page:
            token = "" if page.token is None else f" with the token {page.token}"
            say(f"hexctl: calibrate on {page.url}{token}; Ctrl-C ends it")
            paged.run(page.report)
    return calibration.result
