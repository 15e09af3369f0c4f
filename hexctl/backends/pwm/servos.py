"""Hobby servos on a board, and the thread that owns the board."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from hexctl.backends.clock import Clock
from hexctl.backends.port_thread import POLL_PERIOD_S, PortCounters, PortThread
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.backends.ticked_servos import PortServos
from hexctl.robot.model import Robot
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, BoolArray, FloatArray, RobotState

#: A board without an answer for this long counts as mute.
MUTE_S = 0.5

#: Time between powering two legs: a hobby servo draws stall current for 60 degrees, 0.15 to 0.2 s.
LEG_PAUSE_S = 0.15


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardReport:
    """Report of a board: `contacts` of the feet, (6,), None without inputs; `fault` if it does not obey.

    `limp` is whether servos are off in that fault; `warnings` are other conditions, in few words.
    """

    at_s: float
    contacts: BoolArray | None = None
    voltage_v: float | None = None
    current_a: float | None = None
    fault: str | None = None
    limp: bool = True
    warnings: tuple[str, ...] = ()


class PwmBoard(Protocol):
    """A board on an open port, used by one thread; methods raise OSError when the port is lost."""

    def commanded_us(self) -> FloatArray:
        """Last commanded pulses of each joint, (18,); NaN for none."""

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Power some servos, (18,), with the pulses of their joints, (18,)."""

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send pulses of each joint, (18,), to the powered servos, (18,); the others are limp."""

    def end(self) -> None:
        """Let all servos go limp."""

    def poll(self) -> BoardReport | None:
        """Report of the board, or None without an answer."""

    def close(self) -> None:
        """Close the port; the servos keep their pulses."""


class BoardThread(PortThread[PwmBoard]):
    """Owns a board whose servos turn to the first pulses from unknown angles at full speed.

    Therefore legs are powered one after the other, at the first pose; newer targets wait until all are on,
    and are then approached at the speed of the joints. Joints that already had pulses stay on.

    Args:
        speeds: maximum of the joints, (18,), in microseconds of pulse per second.

    Attributes:
        sent_us: last commanded pulses, (18,), NaN for none.
        powered: servos with pulses, (18,).
    """

    def __init__(
        self,
        opened: Callable[[], PwmBoard],
        board: PwmBoard,
        newest: BoardReport,
        counters: PortCounters,
        speeds: FloatArray,
        sent_us: FloatArray,
        *,
        time: TimeSource = WALL_TIME,
    ) -> None:
        super().__init__(opened, board, counters=counters, speeds=speeds, name="servo board", time=time)
        self._counters = counters
        self.newest, self.sent_us = newest, sent_us
        self._sent = sent_us
        self.powered: BoolArray = np.isfinite(sent_us)
        self._next_leg_at_s = 0.0

    def _may_follow(self) -> bool:
        return self.newest.fault is None

    def _must_release(self) -> bool:
        """Releasing arms a tripped board."""
        return self.newest.fault is not None

    def _follow(self, targets: FloatArray) -> FloatArray:
        if self.on and self.powered.all() and self._time.now() >= self._next_leg_at_s:
            self.sent_us = self._stepped(targets)
            self._device.write(self.sent_us, self.powered)
        elif self.on:
            self._power_next_leg()
            self._device.write(self.sent_us, self.powered)
        else:
            self.sent_us = self._stepped(targets)
            self._power_next_leg()
            self._device.begin(self.sent_us, self.powered)
        self._counters.writes += 1
        return np.where(self.powered, self.sent_us, np.nan)

    def _power_next_leg(self) -> None:
        now_s, waiting = self._time.now(), np.flatnonzero(~self.powered)
        if len(waiting) and now_s >= self._next_leg_at_s:
            leg = waiting[0] // JOINTS_PER_LEG
            self.powered = self.powered.copy()
            self.powered[leg * JOINTS_PER_LEG : (leg + 1) * JOINTS_PER_LEG] = True
            self._next_leg_at_s = now_s + LEG_PAUSE_S

    def _meet(self) -> None:
        self._sent = self._device.commanded_us()
        self.powered = np.isfinite(self._sent)
        self.sent_us = np.where(self.powered, self._sent, self.sent_us)

    def _let_go(self) -> None:
        self._device.end()
        self.powered = np.zeros_like(self.powered)
        self.newest = replace(self.newest, fault=None)

    def _poll(self) -> None:
        report = self._device.poll()
        if report is None:
            self._counters.missed += 1
            return
        self._counters.reports += 1
        self.newest = report
        if report.fault is not None and report.limp:
            self.on, self._sent = False, None
            self.powered = np.zeros_like(self.powered)

    def _finish(self) -> None:
        """Send the last pose: the servos are to keep it."""
        targets = self._targets
        while targets is not None and self._may_follow():
            self._sent = self._follow(targets)
            self.on = True
            if (self._sent == targets).all():
                return
            self._time.sleep(POLL_PERIOD_S)


class PwmServos(PortServos[PwmMap, BoardThread, PortCounters]):
    """Eighteen hobby servos without feedback: a joint is assumed to be at its target.

    A thread owns the port, and neither `read` nor `write` waits for it. Nothing is powered before the first
    `write`; the servos then turn to that pose at full speed, leg by leg. If an earlier program left a pose on
    the board, states begin with it, and no leg is switched off. After `close` the servos keep their pulses.
    """

    what = "the servo board"

    def __init__(
        self, robot: Robot | str | Path, *, pwm_map: PwmMap, port: str, clock: Clock | None = None
    ) -> None:
        super().__init__(robot, servo_map=pwm_map, port=port, counters=PortCounters(), clock=clock)

    @property
    def holds(self) -> bool:
        """Whether any servo has pulses."""
        return bool(self.powered.any())

    @property
    def powered(self) -> BoolArray:
        """Which servos have pulses, (18,)."""
        none: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        return none if self._thread is None else self._thread.powered.copy()

    @abstractmethod
    def _open(self) -> PwmBoard:
        """The board; raises RobotFaultError or OSError if there is none."""

    def _prepared(self) -> BoardThread:
        board, time = self._open(), self._clock.time
        try:
            pulses = board.commanded_us()
            report = board.poll() or BoardReport(at_s=time.now())
        except BaseException:
            board.close()
            raise
        return BoardThread(self._open, board, report, self.counters, self._speeds, pulses, time=time)

    def _state(self, thread: BoardThread) -> RobotState:
        sent_us, report = thread.sent_us, thread.newest
        told = np.isfinite(sent_us)
        told_rad = self._map.angles_rad(np.where(told, sent_us, self._map.centre))
        fault = self._fault(thread.gone, report)
        silent_s = max(0.0, self._clock.time.now() - report.at_s)
        age_s = silent_s if thread.gone is not None or silent_s > MUTE_S else 0.0
        if fault is not None:
            report = BoardReport(at_s=report.at_s, warnings=report.warnings)
        return RobotState(
            np.where(told, told_rad, self._sent_rad),
            stamp_s=max(0.0, self._clock.now_s - age_s),
            measured=False,
            age_s=age_s,
            foot_contacts=self._foot_contacts(report),
            healthy=fault is None,
            fault=fault,
            battery_v=report.voltage_v,
            low_battery_v=self._map.low_battery_v if thread.on else None,  # else the rail has no power
            current_a=report.current_a,
            warnings=report.warnings,
        )

    def _foot_contacts(self, report: BoardReport) -> BoolArray | None:
        """Contacts of the switches that the robot file has: inputs without one read as no contact."""
        switched = "foot_contacts" in self._robot.sensors
        return report.contacts.copy() if switched and report.contacts is not None else None

    def _fault(self, gone: str | None, report: BoardReport) -> str | None:
        if gone is not None:
            return self._gone(gone)
        if self._clock.time.now() - report.at_s > MUTE_S:
            return f"the board on {self._port} does not answer any more"
        return report.fault
