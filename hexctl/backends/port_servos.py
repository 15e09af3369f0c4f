"""Leg servos on a port that a thread owns, as `LegServos`."""

from abc import abstractmethod
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hexctl.backends.base import LegServos, as_robot, check_connected, check_targets
from hexctl.backends.clock import Clock, CountedClock, WallClock
from hexctl.backends.port_thread import PortThread, ReopenedCount, reason_of
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servos.raw_map import RawMap
from hexctl.types import FloatArray, JointTargets, RobotState

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


Map = TypeVar("Map", bound=RawMap)
Thread = TypeVar("Thread", bound="PortThread[Any]")
Counters = TypeVar("Counters", bound=ReopenedCount)


class PortServos(LegServos, Generic[Map, Thread, Counters]):
    """Eighteen servos on a port: neither `read` nor `write` waits for it.

    Nothing moves before the first `write`. After `close` the robot holds its pose.

    Args:
        robot: the robot that the servos belong to, or the name or path of its file.
        servo_map: which servo moves which joint, and how.
        place: the port, as messages have it.
        counters: of the port.
        clock: a wall clock unless given.

    Attributes:
        counters: counts of the port.
    """

    #: What is on the port, as messages have it.
    what = "the servos"

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        servo_map: Map,
        place: str,
        counters: Counters,
        clock: Clock | None = None,
    ) -> None:
        self._robot = as_robot(robot)
        self._map, self._place, self.counters = servo_map, place, counters
        self._clock = CountedClock(clock or WallClock())
        self._thread: Thread | None = None
        self._sent_rad: FloatArray = servo_map.limited_rad(self._robot.stance_angles_rad)
        self._snapshot: tuple[int, RobotState] | None = None

    @property
    def robot(self) -> Robot:
        """The robot that the servos belong to."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """The clock of this end."""
        return self._clock

    @property
    def servo_map(self) -> Map:
        """Which servo moves which joint, and how."""
        return self._map

    def remap(self, servo_map: RawMap) -> None:
        """Use another calibration from now on: no servo moves, its raw position means another angle."""
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

    def connect(self) -> None:
        """Open the port and find what is on it; nothing moves.

        Raises RobotFaultError that says what to check.
        """
        if self._thread is None:
            try:
                self._thread = self._started()
            except OSError as error:
                raise RobotFaultError(self._gone(reason_of(error))) from error
            self._snapshot = None

    def read(self) -> RobotState:
        """Newest state; the same one until the next tick.

        Raises RobotFaultError when not connected.
        """
        thread = self._connected()
        if self._snapshot is None or self._snapshot[0] != self._clock.ticks:
            self._snapshot = (self._clock.ticks, self._state(thread))
        return self._snapshot[1].copy()

    def write(self, targets: JointTargets) -> JointTargets:
        """Leave targets for the port; the result is the nearest that the limits of the servos allow."""
        thread = self._connected()
        check_targets(targets)
        sent = targets
        if self._map.outside(targets.joint_positions_rad).any():
            sent = JointTargets(self._map.limited_rad(targets.joint_positions_rad), targets.stamp_s)
        thread.send(self._map.limited_raw(sent.joint_positions_rad))
        self._sent_rad = sent.joint_positions_rad.copy()
        return sent

    @property
    def holds(self) -> bool:
        """Whether the servos hold, as far as is known."""
        return self._thread is not None and self._thread.on

    def disable_torque(self) -> bool:
        """Let all joints go limp until the next targets."""
        self._connected().release()
        return True

    def close(self) -> None:
        """Close the port; the robot holds its pose."""
        if self._thread is not None:
            thread, self._thread = self._thread, None
            thread.stop()

    @abstractmethod
    def _started(self) -> Thread:
        """The thread, with what has been found on the opened port; raises RobotFaultError or OSError."""

    @abstractmethod
    def _state(self, thread: Thread) -> RobotState:
        """Newest state."""

    def _connected(self) -> Thread:
        """The thread; raises RobotFaultError when not connected."""
        check_connected(self._thread is not None, self.what)
        assert self._thread is not None  # noqa: S101  for the type
        return self._thread

    def _gone(self, reason: str) -> str:
        return f"the port {self._place} has gone ({reason}); is the cable still in?"
