"""Servos behind a server: their pose may be external, and each of their faults is named."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from hexctl.backends.base import LegServos, ServosWrapper
from hexctl.control.guard import EXPIRY_S
from hexctl.errors import HexctlError, RobotFaultError
from hexctl.robot.plugins import label_of, why
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.wire.ros.odometry_error import own_pose_covariance

Answer = TypeVar("Answer")


class ServedServos(ServosWrapper):
    """Servos behind a server: their pose may be external, and each of their faults is named.

    An external pose, such as motion capture, replaces both position and orientation, because their frames
    differ. Falls are still judged by the robot's own orientation, if measured (`tilt_of`). The guard detects
    an external pose that stops coming.

    Every exception of the servos becomes a RobotFaultError that names the call: `serve` then ends with a
    fault instead of a traceback.

    Attributes:
        posed_at_s: arrival of the newest external pose, by the robot's time source; None without one.
        pose_covariance: covariance (36,) of the pose: that of the source, as it came, or of the robot's own.
        own_orientation: orientation (4,) that the robot itself measured in the last state, or None.
    """

    def __init__(self, servos: LegServos) -> None:
        super().__init__(servos)
        self._pose: tuple[FloatArray | None, FloatArray | None] = None, None
        self.posed_at_s: float | None = None
        self.pose_covariance = own_pose_covariance()
        self.own_orientation: FloatArray | None = None

    def tilt_of(self, state: RobotState) -> FloatArray | None:
        """Orientation (4,) by which falls are judged: the robot's own, else the external one, or None."""
        return state.base_quaternion_world if self.own_orientation is None else self.own_orientation

    def has_simulated_pose(self) -> bool:
        """Whether the pose is that of a simulation, and not an external one."""
        return self.posed_at_s is None and self.simulation is not None

    def set_pose(
        self,
        position_world: FloatArray | None,
        quaternion_world: FloatArray | None,
        covariance: FloatArray,
        at_s: float,
    ) -> None:
        """Set the external pose in m and (w, x, y, z), its covariance (36,), and its time by the robot's."""
        self._pose, self.posed_at_s = (position_world, quaternion_world), at_s
        self.pose_covariance = covariance

    def connect(self) -> None:
        """Connect the servos."""
        call_servos(self, "connect", super().connect)

    def read(self) -> RobotState:
        """State of the servos, with the external pose if there was one."""
        state = call_servos(self, "read", super().read)
        self.own_orientation = state.base_quaternion_world
        if self.posed_at_s is None:
            return state
        fresh = self.clock.time.now() - self.posed_at_s <= EXPIRY_S
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
        self.posed_at_s = self.own_orientation = None
        call_servos(self, "close", super().close)


def call_servos(servos: ServosWrapper, name: str, method: Callable[[], Answer]) -> Answer:
    """Call `method`, which is `name` of servos; an unexpected exception becomes a RobotFaultError."""
    try:
        return method()
    except HexctlError:
        raise
    except Exception as error:
        label = label_of(type(servos.unwrapped))
        raise RobotFaultError(f"the servos failed: {label}.{name} raised {why(error)}") from error
