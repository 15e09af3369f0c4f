"""The hands of a calibration: hold all joints at 50 Hz, move one slowly, and listen meanwhile."""

import math
import os
import select
import sys
from collections.abc import Callable

import numpy as np

from hexctl.backends.mavlink.client import MavlinkServos
from hexctl.cli.console import print_note
from hexctl.control.guard import Guard
from hexctl.errors import RobotFaultError
from hexctl.robot.servo_map import ServoMap, referenced
from hexctl.types import FloatArray, JointTargets

#: How fast a joint moves while somebody has fingers near it.
SPEED_DEG_S = 20.0

#: A target this near is reached.
NEAR_DEG = 0.05


class QuitError(Exception):
    """The person, or the end of the input, asks for the end."""


class Lines:
    """Lines from a file descriptor, without ever waiting for one."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._waiting = b""
        self._ended = False

    def poll(self) -> str | None:
        """Return the next whole line without its end, or None while there is none.

        Raises QuitError after the last line of an input that has ended.
        """
        while b"\n" not in self._waiting:
            if self._ended:
                raise QuitError
            if not select.select([self._descriptor], [], [], 0)[0]:
                return None
            data = os.read(self._descriptor, 4096)
            self._ended = not data
            self._waiting += data or (b"\n" if self._waiting else b"")
        line, self._waiting = self._waiting.split(b"\n", 1)
        return line.decode("utf-8", errors="replace").strip()


class Hands:
    """Holds every joint where it is, and moves the one that it is told to, always through the guard."""

    def __init__(
        self, guard: Guard, servos: MavlinkServos, lines: Lines, interrupted: Callable[[], bool]
    ) -> None:
        self._guard, self._servos = guard, servos
        self._lines, self._interrupted = lines, interrupted
        self._targets_rad: FloatArray = guard.accepted_rad().copy()
        self._believe_in_range()

    @property
    def servo_map(self) -> ServoMap:
        """Return the servo map in use."""
        return self._servos.servo_map

    def angle_deg(self, joint: int) -> float:
        """Return where a joint is believed to be."""
        return math.degrees(self._targets_rad[joint])

    def pulse_us(self, joint: int) -> float:
        """Return the pulse that a joint's servo gets now."""
        return float(self._servos.servo_map.pulses_us(self._targets_rad)[joint])

    def remap(self, servo_map: ServoMap) -> None:
        """Go on with another servo map: nothing moves, the pulses mean other angles."""
        pulses = self._servos.servo_map.pulses_us(self._targets_rad)
        self._servos.remap(servo_map)
        self._targets_rad = servo_map.angles_rad(pulses)
        self._guard.clear()

    def ask(self, prompt: str, *, holding: bool = True) -> str:
        """Return what the person answers, in lower case, holding all joints meanwhile, or sending nothing.

        Raises QuitError for `quit`, Ctrl-C and the end of the input.
        """
        sys.stderr.write(f"{prompt} ")
        sys.stderr.flush()
        try:
            while (line := self._lines.poll()) is None:
                self._tick(holding=holding)
            if line.lower() in ("quit", "q"):
                raise QuitError
        except QuitError:
            print_note("")
            raise
        if not sys.stdin.isatty():
            # Nobody pressed the key that ends the line on the screen.
            print_note("")
        return line.lower()

    def move(self, joint: int, to_deg: float) -> bool:
        """Move one joint slowly; return whether it got there, or False where a limit is nearer."""
        step_deg = SPEED_DEG_S * self._guard.clock.period_s
        while True:
            missing_deg = to_deg - self.angle_deg(joint)
            if abs(missing_deg) < NEAR_DEG:
                return True
            before_deg = self.angle_deg(joint)
            self._targets_rad[joint] += math.radians(float(np.clip(missing_deg, -step_deg, step_deg)))
            self._tick()
            if abs(self.angle_deg(joint) - before_deg) < NEAR_DEG / 10:
                return False

    def tell(self, words: str) -> None:
        """Say something to the person."""
        print_note(words)

    def _believe_in_range(self) -> None:
        """Begin with a map in which every joint stands within its range.

        The guard would bring a joint that seems to be outside back in at full speed, and before a servo is
        calibrated that says little about where it is.
        """
        robot, servo_map = self._guard.robot, self._servos.servo_map
        within_rad = np.clip(self._targets_rad, robot.joint_lower_rad, robot.joint_upper_rad)
        for joint in np.flatnonzero(within_rad != self._targets_rad).tolist():
            believed_deg, true_deg = math.degrees(self._targets_rad[joint]), math.degrees(within_rad[joint])
            servo_map = referenced(servo_map, joint, believed_deg, true_deg)
        if servo_map is not self._servos.servo_map:
            self.remap(servo_map)

    def _tick(self, *, holding: bool = True) -> None:
        """Hold, or take the next step, and take over what was really sent; or only look."""
        if self._interrupted():
            raise QuitError
        tick = self._guard.clock.tick()
        self._guard.read()
        if self._guard.stopped is not None:
            raise RobotFaultError(
                f"stopped: {self._guard.stopped}; every joint done is saved, the same command goes on"
            )
        if not holding:
            return
        self._targets_rad = self._guard.write(
            JointTargets(self._targets_rad, tick.time_s)
        ).positions_rad.copy()
