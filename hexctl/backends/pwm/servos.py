"""Hobby servos on a board, as `LegServos`."""

import time
from abc import abstractmethod
from pathlib import Path

import numpy as np

from hexctl.backends.clock import Clock
from hexctl.backends.pwm.pwm_board import BoardReport, BoardThread, PwmBoard, PwmCounters
from hexctl.backends.ticked_servos import PortServos
from hexctl.robot.model import Robot
from hexctl.robot.servos.pwm_map import PwmMap
from hexctl.types import RobotState

#: A board that has not answered for this long is mute.
MUTE_S = 0.5


class PwmServos(PortServos[PwmMap, BoardThread, PwmCounters]):
    """Eighteen hobby servos without feedback: a joint is taken to be where the board was told to turn it.

    A thread of its own owns the port: neither `read` nor `write` waits for it. Nothing is powered before the
    first `write`; the servos then turn to that pose at full speed, from wherever they are, leg by leg. Where
    the board was told a pose by an earlier program, states begin with it, and no leg is switched off. After
    `close` the servos keep their pulses.
    """

    what = "the servo board"

    def __init__(
        self, robot: Robot | str | Path, *, pwm_map: PwmMap, place: str, clock: Clock | None = None
    ) -> None:
        super().__init__(robot, servo_map=pwm_map, place=place, counters=PwmCounters(), clock=clock)

    @abstractmethod
    def _open(self) -> PwmBoard:
        """The board, found; raises RobotFaultError or OSError where there is none."""

    def _started(self) -> BoardThread:
        board = self._open()
        try:
            pulses = board.commanded_us()
            report = board.poll() or BoardReport(at_s=time.monotonic())
        except BaseException:
            board.close()
            raise
        speeds = np.degrees(self._robot.joint_max_speed_rad_s) * self._map.per_deg
        thread = BoardThread(self._open, board, report, self.counters, speeds, pulses)
        thread.start()
        return thread

    def _state(self, thread: BoardThread) -> RobotState:
        told_us, report = thread.told_us, thread.newest
        told = np.isfinite(told_us)
        told_rad = self._map.angles_rad(np.where(told, told_us, self._map.centre))
        fault = self._fault(thread.gone, report)
        silent_s = max(0.0, time.monotonic() - report.at_s)
        age_s = silent_s if thread.gone is not None or silent_s > MUTE_S else 0.0
        if fault is not None:
            report = BoardReport(at_s=report.at_s)
        return RobotState(
            np.where(told, told_rad, self._sent_rad),
            stamp_s=max(0.0, self._clock.now_s - age_s),
            measured=False,
            age_s=age_s,
            foot_contacts=None if report.contacts is None else report.contacts.copy(),
            healthy=fault is None,
            fault=fault,
            battery_v=report.voltage_v,
            current_a=report.current_a,
        )

    def _fault(self, gone: str | None, report: BoardReport) -> str | None:
        if gone is not None:
            return self._gone(gone)
        if time.monotonic() - report.at_s > MUTE_S:
            return f"the board on {self._place} does not answer any more"
        return report.fault
