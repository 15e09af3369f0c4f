"""Hobby servos on a board, as `LegServos`."""

import time
from abc import abstractmethod
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hexctl.backends.base import LegServos, as_robot, check_connected, check_targets
from hexctl.backends.clock import Clock, CountedClock, WallClock
from hexctl.backends.pwm.board import BoardReport, PwmBoard, PwmCounters
from hexctl.backends.pwm.board_thread import BoardThread
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.pwm_map import PwmMap
from hexctl.types import FloatArray, JointTargets, RobotState

#: A board that has not answered for this long is mute.
MUTE_S = 0.5


class PwmServos(LegServos):
    """Eighteen hobby servos without feedback: where a joint is told to be, there it is taken to be.

    A thread of its own owns the port: neither `read` nor `write` waits for it. Nothing is powered before the
    first `write`; the servos then turn to that pose at full speed, from wherever they are. Where the board
    was told a pose by an earlier program, states begin with it. After `close` the servos keep their pulses.

    Args:
        robot: the robot that the servos belong to, or the name or path of its file.
        pwm_map: which output moves which joint, and how.
        place: of the board, as messages have it.
        clock: a wall clock unless given.

    Attributes:
        counters: counts of the board.
    """

    def __init__(
        self, robot: Robot | str | Path, *, pwm_map: PwmMap, place: str, clock: Clock | None = None
    ) -> None:
        self._robot = as_robot(robot)
        self._map, self._place = pwm_map, place
        self._clock = CountedClock(clock or WallClock())
        self.counters = PwmCounters()
        self._thread: BoardThread | None = None
        self._sent_rad: FloatArray = pwm_map.pulses.limited_rad(self._robot.stance_angles_rad)

    @abstractmethod
    def _open(self) -> PwmBoard:
        """The board, found; raises RobotFaultError or OSError where there is none."""

    @property
    def robot(self) -> Robot:
        """The robot that the servos belong to."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """The clock of this end."""
        return self._clock

    @property
    def pwm_map(self) -> PwmMap:
        """Which output moves which joint, and how."""
        return self._map

    @property
    def link_counts(self) -> dict[str, int]:
        """Counts of the board by name."""
        return asdict(self.counters)

    def connect(self) -> None:
        """Open the port and find the board; nothing is powered.

        Raises RobotFaultError that says what to check.
        """
        if self._thread is not None:
            return
        try:
            board = self._open()
            pulses = board.commanded_us()
            report = board.poll() or BoardReport(at_s=time.monotonic())
        except OSError as error:
            raise RobotFaultError(self._gone(error.strerror or str(error))) from error
        if pulses is not None:
            self._sent_rad = self._map.pulses.angles_rad(pulses)
        self._thread = BoardThread(self._open, board, report, self.counters)
        self._thread.start()

    def read(self) -> RobotState:
        """Targets that were sent last, with what the board tells.

        Raises RobotFaultError when not connected.
        """
        check_connected(self._thread is not None, "the servo board")
        assert self._thread is not None  # noqa: S101  for the type
        report = self._thread.newest
        fault = self._fault(self._thread.gone, report)
        if fault is not None:
            report = BoardReport(at_s=report.at_s)
        return RobotState(
            self._sent_rad.copy(),
            stamp_s=self._clock.now_s,
            measured=False,
            foot_contacts=None if report.contacts is None else report.contacts.copy(),
            healthy=fault is None,
            fault=fault,
            battery_v=report.voltage_v,
            current_a=report.current_a,
        )

    def write(self, targets: JointTargets) -> JointTargets:
        """Leave targets for the board; the result is the nearest that the pulses of the servos allow."""
        check_connected(self._thread is not None, "the servo board")
        check_targets(targets)
        assert self._thread is not None  # noqa: S101  for the type
        pulses, sent = self._map.pulses, targets
        if pulses.outside(targets.positions_rad).any():
            sent = JointTargets(pulses.limited_rad(targets.positions_rad), targets.stamp_s)
        wanted = pulses.pulses_us(sent.positions_rad)
        self._thread.send(np.clip(wanted, pulses.min_us, pulses.max_us))
        self._sent_rad = sent.positions_rad.copy()
        return sent

    def disable_torque(self) -> bool:
        """Let all joints go limp until the next targets; a board that has tripped is armed again."""
        check_connected(self._thread is not None, "the servo board")
        assert self._thread is not None  # noqa: S101  for the type
        self._thread.release()
        return True

    def close(self) -> None:
        """Close the port; the servos keep their pulses."""
        if self._thread is not None:
            thread, self._thread = self._thread, None
            thread.stop()

    def _gone(self, reason: str) -> str:
        return f"the port {self._place} has gone ({reason}); is the cable still in?"

    def _fault(self, gone: str | None, report: BoardReport) -> str | None:
        """Why the robot cannot be walked, or None."""
        if gone is not None:
            return self._gone(gone)
        if time.monotonic() - report.at_s > MUTE_S:
            return f"the board on {self._place} does not answer any more"
        return report.fault
