"""A session of manual driving: devices are polled every tick, and their requests are executed."""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from threading import Lock
from typing import TYPE_CHECKING, Any, Protocol

from hexctl.control.drive.arbiter import Velocity
from hexctl.control.drive.drive import Drive
from hexctl.control.telemetry_watch import SeenWarnings
from hexctl.errors import EStopError, HexctlError, InputError
from hexctl.gait.body_pose import LEVEL
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.failure import in_words
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.teleop.robot_outline import legs_outline
from hexctl.types import FloatArray, RobotState

if TYPE_CHECKING:
    from hexctl.client.stop_client import ReadyStop

#: Requests of devices in addition to velocities.
REQUESTS = ("stop", "stand", "sit", "gait", "level", "hold body", "quit")

#: Requests that move the body by a step: the number of `BodyPose`, and the direction.
POSE_REQUESTS = {
    "up": ("up_m", 1),
    "down": ("up_m", -1),
    "front down": ("pitch_rad", 1),
    "front up": ("pitch_rad", -1),
    "lean right": ("roll_rad", 1),
    "lean left": ("roll_rad", -1),
    "twist left": ("yaw_rad", 1),
    "twist right": ("yaw_rad", -1),
    "shift forward": ("forward_m", 1),
    "shift back": ("forward_m", -1),
    "shift left": ("left_m", 1),
    "shift right": ("left_m", -1),
}

#: Steps of a pose request: an angle, and a share of the robot's size.
ANGLE_STEP_RAD, SHIFT_STEP = math.radians(2), 0.01

#: Maxima of a stick that moves the body.
MOST_ANGLE_RAD, MOST_SHIFT = math.radians(15), 0.05

#: Time for which devices show a message.
SAID_S = 6.0

#: Ticks between two reports to devices.
REPORT_TICKS = 5

#: Maximum ticks until the robot stands at the end of a session.
LAST_TICKS = 50

#: Time between two polls of the devices while the robot is stopped.
STOPPED_POLL_S = 0.1

#: Reports over which the speed of the body is measured.
SPEED_REPORTS = 10

#: Shorter distances count as no travel, because measured positions are noisy.
LEAST_TRAVEL_M = 0.01


class Travel:
    """Distance along the path, speed over the last second, and heading from the first; None if unknown."""

    def __init__(self) -> None:
        self.distance_m: float | None = None
        self.speed_m_s: float | None = None
        self.heading_deg: float | None = None
        self._first_yaw_rad: float | None = None
        self._counted_m: FloatArray | None = None
        self._recent: deque[tuple[float, FloatArray]] = deque(maxlen=SPEED_REPORTS + 1)

    def add(self, state: RobotState, now_s: float) -> None:
        """Take a state at a time on the robot's clock."""
        if state.base_position_world is not None:
            self._add_position(state.base_position_world[:2].copy(), now_s)
        if state.base_quaternion_world is not None:
            yaw = float(yaw_rad(state.base_quaternion_world))
            self._first_yaw_rad = yaw if self._first_yaw_rad is None else self._first_yaw_rad
            self.heading_deg = math.degrees(wrapped_rad(yaw - self._first_yaw_rad))

    def _add_position(self, position_m: FloatArray, now_s: float) -> None:
        self._recent.append((now_s, position_m))
        then_s, then_m = self._recent[0]
        if now_s > then_s:
            self.speed_m_s = math.dist(position_m, then_m) / (now_s - then_s)
        if self._counted_m is None:
            self.distance_m, self._counted_m = 0.0, position_m
        moved_m = math.dist(position_m, self._counted_m)
        if self.distance_m is not None and moved_m >= LEAST_TRAVEL_M:
            self.distance_m, self._counted_m = self.distance_m + moved_m, position_m


class Device(Protocol):
    """An input device. Its methods must not block."""

    def poll(self) -> None:
        """Take the input since the last tick."""

    def report(self, status: dict[str, Any]) -> None:
        """Show a status, plain values of `DriveSession.status`."""


class DriveSession:
    """Drives a robot manually until a device asks to quit.

    A stop of a device is also latched at a robot on the network. After it, "stand" reconnects, which the
    robot refuses until its stop is cleared. `robot_stop` stops the robot for all its clients.
    """

    def __init__(self, drive: Drive, robot_stop: "ReadyStop | None" = None) -> None:
        self.drive, self._robot_stop = drive, robot_stop
        self._stop_sent = False
        self.ended: str | None = None
        self.commanded = False
        self.said = ""
        self._asking, self._stops = Lock(), 0
        self._asked: dict[str, None] = {}  # in their order
        self._quit: str | None = None
        self._noticed = 0
        self._shown, self._shown_until_s = "", 0.0
        self._travel = Travel()
        self._warnings = SeenWarnings()

    @property
    def warned(self) -> tuple[str, ...]:
        """Warnings of the robot that came during the drive, one of each kind."""
        return self._warnings.news

    def ask(self, request: str, why: str = "") -> None:
        """Queue one of `REQUESTS` or `POSE_REQUESTS`; thread-safe. Each tick executes one of them.

        A stop is immediate and drops earlier requests. A queued request is not added again, so no client can
        crowd out others. Raises InputError for any other request.
        """
        if request not in REQUESTS and request not in POSE_REQUESTS:
            raise InputError(f"request: got {request!r}; allowed: {', '.join((*REQUESTS, *POSE_REQUESTS))}")
        if request == "stop":
            with self._asking:
                self._stops += 1
                self._asked.clear()
                self._stop_sent = self._robot_stop is not None
            self.drive.stop("stop button")  # in force from this tick on
            if self._robot_stop is not None:
                self._robot_stop.press()
        elif request == "quit":
            self._quit = why or request
        else:
            with self._asking:
                self._asked.setdefault(request)

    def lean(self, forward: float, left: float, roll: float, pitch: float) -> None:
        """Move the body by shares -1 to 1 of the maxima of a stick, while the gamepad is followed."""
        drive = self.drive
        most_m = MOST_SHIFT * drive.robot.size_m
        pose = replace(
            drive.body_goal,
            roll_rad=roll * MOST_ANGLE_RAD,
            pitch_rad=pitch * MOST_ANGLE_RAD,
            forward_m=forward * most_m,
            left_m=left * most_m,
        )
        drive.arbiter.pose(pose, "gamepad")

    def run(self, devices: Sequence[Device] = (), stop_requested: Callable[[], bool] = lambda: False) -> str:
        """Drive until a device asks to quit; return the reason. The robot then stands.

        A stop requested from the start commands nothing. Raises EStopError when the guard has stopped
        the robot, RobotFaultError when it or its link fails.
        """
        if self.ended is None and stop_requested():
            self.ended = "interrupted"
            return self.ended
        ticks, self.commanded = 0, True
        self._warnings = SeenWarnings(self.drive.guard.peek().warnings)  # the drive's notes have them
        while self.ended is None:
            if stop_requested():
                self.ended = "interrupted"
            try:
                state = self.drive.step(lambda: self._poll(devices))
            except EStopError:
                if not self._stop_sent:
                    raise
                self._wait_stopped(devices, stop_requested)
                continue
            self._listen(state)
            if ticks % REPORT_TICKS == 0:
                self._travel.add(state, self.drive.guard.clock.now_s)
                self._report(devices, state)
            ticks += 1
        self.drive.arbiter.stop(self.ended, stands=True)
        for _ in range(LAST_TICKS):
            if self.drive.at_rest:
                break
            self.drive.step()
        self.drive.pause()
        return self.ended

    def _wait_stopped(self, devices: Sequence[Device], stop_requested: Callable[[], bool]) -> None:
        """Wait until the stop is cleared and a device asks to stand; raises EStopError at the end."""
        state, self.said = self.drive.guard.peek(), ""
        while not self._stands_again():
            self._report(devices, state)
            time.sleep(STOPPED_POLL_S)
            for device in devices:
                device.poll()
            if self._quit is not None or stop_requested():
                raise EStopError("stopped by a device of the drive")

    def _stands_again(self) -> bool:
        with self._asking:
            asked = "stand" in self._asked
            self._asked.clear()
            if not asked:
                return False
            self._stop_sent = False
        try:
            self.drive.reconnect()
        except HexctlError as error:
            self._stop_sent, self.said = True, str(error)
            return False
        self.said = ""
        return True

    def _report(self, devices: Sequence[Device], state: RobotState) -> None:
        status = self.status(state)
        for device in devices:
            device.report(status)

    def status(self, state: RobotState) -> dict[str, Any]:
        """Status of the robot as plain values; `clear` is the command for a stop by this session, or None."""
        drive, robot_stop = self.drive, self._robot_stop
        latched = robot_stop is not None and self._stop_sent and drive.guard.stopped is not None
        velocity, decision = Velocity() if latched else drive.velocity, drive.decision
        return {
            "robot": drive.robot.name,
            "mode": drive.mode,
            "stopped": drive.stopped,
            "clear": robot_stop.clear_command if robot_stop is not None and latched else None,
            "source": decision.source,
            "velocity": [velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s],
            "distance_m": self._travel.distance_m,
            "speed_m_s": None if latched else self._travel.speed_m_s,
            "heading_deg": self._travel.heading_deg,
            "gait": name_of(drive.gait_now.slots),
            "body_pose": drive.body_pose.array.round(4).tolist(),
            "battery_v": state.battery_v,
            "battery_share": state.battery_share,
            "legs": self._legs(state),
            "failures": [f"leg {one.leg} {in_words(one)}" for one in drive.failures],
            "said": state.fault or (robot_stop and robot_stop.trouble) or self.said or self._lack(state),
        }

    def _legs(self, state: RobotState) -> list[dict[str, Any]]:
        robot, failed = self.drive.robot, {one.leg for one in self.drive.failures}
        step_m = self.drive.gait_now.height * robot.size_m
        return legs_outline(robot, state.joint_positions_rad, step_m, failed)

    def _lack(self, state: RobotState) -> str:
        drive = self.drive
        if drive.level and state.base_quaternion_world is None:
            return "the body is not kept level: the robot measures no roll and pitch"
        if drive.mode != "driving":
            return ""
        if drive.share(1, 1, 1).array.min() <= 0:
            return "no speed is possible with this body height"
        return "" if drive.pose_share == 1 else f"the legs reach {drive.pose_share:.0%} of this body pose"

    def _poll(self, devices: Sequence[Device]) -> None:
        for device in devices:
            device.poll()
        self._do_requests()

    def _listen(self, state: RobotState) -> None:
        if new := self._warnings.take(state.warnings):
            self.said = f"servos: {'; '.join(new)}"
        noticed = self.drive.noticed
        if len(noticed) > self._noticed:
            self.said = str(noticed[-1])
        self._noticed = len(noticed)
        now_s = self.drive.guard.clock.now_s
        if self.said != self._shown:
            self._shown, self._shown_until_s = self.said, now_s + SAID_S
        elif now_s >= self._shown_until_s:
            self.said = self._shown = ""

    def _do_requests(self) -> None:
        """Execute the oldest request. Only one per tick, because some take long."""
        self.ended = self.ended or self._quit
        with self._asking:
            request, stops = next(iter(self._asked), None), self._stops
            if request is None:
                return
            del self._asked[request]
        try:
            self._do(request)
        except HexctlError as error:
            self.said = str(error)
        if self._stops != stops:
            self.drive.stop("stop button")  # a stop during "stand", which has cleared it

    def _do(self, request: str) -> None:
        drive = self.drive
        if request == "stand":
            drive.stand()
        elif request == "sit":
            drive.sit()
        elif request == "gait":
            names = list(NAMED_SLOTS)
            now = name_of(drive.gait.slots)
            drive.gait = names[(names.index(now) + 1) % len(names)] if now in names else names[0]
        elif request in ("level", "hold body"):
            drive.arbiter.pose(LEVEL if request == "level" else drive.body_pose)
        else:
            self._move_body(*POSE_REQUESTS[request])

    def _move_body(self, name: str, direction: int) -> None:
        """Move the body by a step from the commanded pose, if the legs reach that."""
        drive = self.drive
        step = ANGLE_STEP_RAD if name.endswith("_rad") else SHIFT_STEP * drive.robot.size_m
        pose = replace(drive.body_goal, **{name: getattr(drive.body_goal, name) + direction * step})
        reached = drive.reach(pose) == 1
        self.said = "" if reached else "the legs do not reach further"
        if reached:
            drive.arbiter.pose(pose)


def name_of(slots: Sequence[int]) -> str:
    """Name of the slots of a gait, or the slots themselves."""
    names = {named: name for name, named in NAMED_SLOTS.items()}
    return names.get(tuple(slots), ",".join(map(str, slots)))
