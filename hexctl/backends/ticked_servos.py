"""Leg servos with one read per tick, and those with a map to raw positions."""

from abc import abstractmethod
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from hexctl.backends.base import OwnServos, check_connected, check_targets
from hexctl.backends.clock import Clock, WallClock
from hexctl.backends.port_thread import PortThread, reason_of
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servos.raw_map import RawMap
from hexctl.types import FloatArray, JointTargets, RobotState

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


Map = TypeVar("Map", bound=RawMap)
Thread = TypeVar("Thread", bound="PortThread[Any]")
Counters = TypeVar("Counters")


class TickedServos(OwnServos):
    """Eighteen servos with a local clock; `read` gives one state until the next tick."""

    #: Name of the other end in messages.
    what = "the servos"

    def __init__(self, robot: Robot | str | Path, clock: Clock) -> None:
        super().__init__(robot, clock)
        self._snapshot: tuple[int, RobotState] | None = None
        self._opened: ExitStack | None = None

    def read(self) -> RobotState:
        """Newest state, constant within a tick. Raises RobotFaultError when not connected or lost."""
        self._check_connected()
        if self._snapshot is None or self._snapshot[0] != self._clock.index:
            self._snapshot = (self._clock.index, self._newest())
        return self._snapshot[1].copy()

    def connect(self) -> None:
        """Open the connection; nothing moves. Raises RobotFaultError with advice."""
        if self._opened is None:
            with ExitStack() as opening:
                self._open_all(opening)
                self._snapshot, self._opened = None, opening.pop_all()

    def close(self) -> None:
        """Close the connection; the robot holds its pose."""
        if self._opened is not None:
            opened, self._opened = self._opened, None
            opened.close()

    def _check_connected(self) -> None:
        check_connected(self._opened is not None, self.what)

    @abstractmethod
    def _open_all(self, opening: ExitStack) -> None:
        """Open all resources, with callbacks that close them."""

    @abstractmethod
    def _newest(self) -> RobotState:
        """Newest state."""


class MappedServos(TickedServos, Generic[Map, Counters]):
    """Servos on a port, with a map between joint angles and raw positions; `counters` are a dataclass."""

    def __init__(
        self, robot: Robot | str | Path, *, servo_map: Map, port: str, counters: Counters, clock: Clock
    ) -> None:
        super().__init__(robot, clock)
        self._map, self._port, self.counters = servo_map, port, counters
        self._sent_rad: FloatArray = self._robot.stance_angles_rad.copy()

    @property
    def servo_map(self) -> Map:
        """Which servo moves which joint, and how."""
        return self._map

    def remap(self, servo_map: RawMap) -> None:
        """Replace the calibration: no servo moves, but its raw position means another angle.

        Clear a guard around these servos right after, or it takes the change for a movement.
        """
        raw = self._map.raw(self._sent_rad)
        self._map = self._map.calibrated_as(servo_map)
        self._sent_rad = self._map.angles_rad(raw)
        self._snapshot = None

    @property
    def link_counts(self) -> dict[str, int]:
        """Counts of the port by name."""
        counters: DataclassInstance = self.counters  # type: ignore[assignment]
        values = ((each.name, getattr(counters, each.name)) for each in fields(counters))
        return {name: value for name, value in values if isinstance(value, int)}

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets; the result is the nearest that the limits of the servos allow."""
        self._check_connected()
        check_targets(targets)
        sent = targets
        if clips := bool(self._map.outside(targets.joint_positions_rad).any()):
            sent = JointTargets(self._map.limited_rad(targets.joint_positions_rad), targets.stamp_s)
        self._send_targets(sent.joint_positions_rad, clips=clips)
        self._sent_rad = sent.joint_positions_rad.copy()
        return sent

    @abstractmethod
    def _send_targets(self, positions_rad: FloatArray, *, clips: bool) -> None:
        """Send angles (18,) within the limits of the servos; `clips` if they were clipped."""

    def _gone(self, reason: str) -> str:
        return f"the port {self._port} was lost ({reason}); is the cable still in?"


class PortServos(MappedServos[Map, Counters], Generic[Map, Thread, Counters]):
    """Eighteen servos on a port that a thread owns: neither `read` nor `write` waits for it.

    Nothing moves before the first `write`. After `close` the robot holds its pose.
    """

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        servo_map: Map,
        port: str,
        counters: Counters,
        clock: Clock | None = None,
    ) -> None:
        clock = clock or WallClock()
        super().__init__(robot, servo_map=servo_map, port=port, counters=counters, clock=clock)
        self._speeds = np.degrees(self._robot.joint_max_speed_rad_s) * servo_map.per_deg
        self._thread: Thread | None = None
        self._sent_rad = servo_map.limited_rad(self._sent_rad)

    @property
    def holds(self) -> bool:
        """Whether the servos are known to hold."""
        return self._thread is not None and self._thread.on

    def disable_torque(self) -> bool:
        """Let all joints go limp until the next targets."""
        self._check_connected()
        assert self._thread is not None  # noqa: S101  for the type
        self._thread.release()
        return True

    def _open_all(self, opening: ExitStack) -> None:
        try:
            self._thread = self._prepared()
        except OSError as error:
            raise RobotFaultError(self._gone(reason_of(error))) from error
        opening.callback(self._stop)
        self._thread.start()

    def _stop(self) -> None:
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.stop()

    @abstractmethod
    def _prepared(self) -> Thread:
        """Thread on the opened port, not started; raises RobotFaultError or OSError."""

    @abstractmethod
    def _state(self, thread: Thread) -> RobotState:
        """Newest state."""

    def _newest(self) -> RobotState:
        assert self._thread is not None  # noqa: S101  `read` asks whether it is connected
        return self._state(self._thread)

    def _send_targets(self, positions_rad: FloatArray, *, clips: bool) -> None:
        assert self._thread is not None  # noqa: S101  as does `write`
        self._thread.send(self._map.limited_raw(positions_rad))
