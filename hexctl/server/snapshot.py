"""What is known of a served robot in one control period, for ROS and for the event log."""

import time
from dataclasses import dataclass, field

from hexctl.backends.clock import Standstill
from hexctl.types import FloatArray, RobotState
from hexctl.wire.stop import Clear, Stop


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotSnapshot:
    """A robot in one control period.

    Attributes:
        orientation: of the robot's IMU, (w, x, y, z), (4,); None without one.
        posed_at_s: arrival of the newest external pose, by the robot's time source; None without one.
        ros: line on the ROS router.
        doubt: line on an implausible position.
        standstill: last one of this program.
        stamp_ns: nanoseconds since 1970.
    """

    state: RobotState
    orientation: FloatArray | None = None
    posed_at_s: float | None = None
    posture: str = "idle"
    controller: str | None = None
    stop: Stop | None = None
    cleared: Clear | None = None
    ros: str | None = None
    doubt: str | None = None
    standstill: Standstill | None = None
    stamp_ns: int = field(default_factory=time.time_ns)

    @property
    def stopped(self) -> str | None:
        """Why it is stopped, or None."""
        return None if self.stop is None else self.stop.reason
