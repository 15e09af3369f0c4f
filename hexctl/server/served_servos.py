"""Servos behind a server: their pose may come from outside, and every fault of theirs is named."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.control.guard import EXPIRY_S
from hexctl.errors import HexctlError, RobotFaultError
from hexctl.types import FloatArray, JointTargets, RobotState

Answer = TypeVar("Answer")


class ServedServos(ServosWrapper):
    """Servos behind a server: they may get their pose from outside, and every fault of theirs is named.

    A pose from outside, such as motion capture, replaces the robot's own, both halves of it: the two are in
    frames of their own, and a position of one with a yaw of the other would be a pose in neither. Falls are
    still judged by the robot's own orientation, where it has one (`tilt_of`). A pose that stops coming is
    lost, which the guard notices.

    Whatever the servos raise becomes a RobotFaultError that says which call failed and why: an exception that
    a driver does not expect ends `serve` as a fault, not as a traceback.
    """

    def __init__(self, servos: LegServos) -> None:
        super().__init__(servos)
        self._pose: tuple[FloatArray | None, FloatArray | None] | None = None
        self._pose_at_s = 0.0
        self._own_quaternion: FloatArray | None = None

    @property
    def posed_from_outside(self) -> bool:
        """Whether a pose from outside has replaced the robot's own."""
        return self._pose is not None

    @property
    def posed_at_s(self) -> float | None:
        """When the newest pose from outside came, by the robot's time source; None while there was none."""
        return None if self._pose is None else self._pose_at_s

    @property
    def own_orientation(self) -> FloatArray | None:
        """Orientation (4,) that the robot itself measured in the state that was read last, or None."""
        return self._own_quaternion

    def tilt_of(self, state: RobotState) -> FloatArray | None:
        """Orientation (4,) by which falls are judged in the state that was read last, or None.

        It is the robot's own, from which roll and pitch are known in any frame, else the one from outside.
        """
        return state.base_quaternion_world if self._own_quaternion is None else self._own_quaternion

    def set_pose(
        self, position_world: FloatArray | None, quaternion_world: FloatArray | None, at_s: float
    ) -> None:
        """Set the pose from outside.

        Args:
            position_world: (3,) in m, or None where unknown.
            quaternion_world: (w, x, y, z), or None where unknown.
            at_s: time of arrival by the robot's time source.
        """
        self._pose, self._pose_at_s = (position_world, quaternion_world), at_s

    def connect(self) -> None:
        """Connect the servos."""
        call_servos(self, "connect", super().connect)

    def read(self) -> RobotState:
        """State of the servos, with the pose from outside once there was one."""
        state = call_servos(self, "read", super().read)
        self._own_quaternion = state.base_quaternion_world
        if self._pose is None:
            return state
        fresh = self.clock.time.now() - self._pose_at_s <= EXPIRY_S
        position, quaternion = self._pose if fresh else (None, None)
        return replace(state, base_position_world=position, base_quaternion_world=quaternion)

    def write(self, targets: JointTargets) -> JointTargets:
        """Write to the servos."""
        return call_servos(self, "write", lambda: self.wrapped.write(targets))

    def pause_watchdog(self) -> None:
        """Expect no command until the next one."""
        call_servos(self, "pause_watchdog", super().pause_watchdog)

    def disable_torque(self) -> bool:
        """Switch off the torque of the servos."""
        return call_servos(self, "disable_torque", super().disable_torque)

    def close(self) -> None:
        """Close the servos and drop the pose."""
        self._pose = self._own_quaternion = None
        call_servos(self, "close", super().close)


def call_servos(servos: ServosWrapper, name: str, method: Callable[[], Answer]) -> Answer:
    """Result of a method of servos; an error that hexctl does not know becomes a RobotFaultError.

    Args:
        servos: whose method is called.
        name: of the method, for the message.
        method: the call.
    """
    try:
        return method()
    except HexctlError:
        raise
    except Exception as error:
        kind = type(servos.unwrapped).__name__
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise RobotFaultError(f"the servos failed: {kind}.{name} raised {reason}") from error
