"""What the robot's thread hands to ROS in every control period."""

import time
from dataclasses import dataclass, field

from hexctl.types import FloatArray, RobotState


@dataclass(frozen=True, slots=True, eq=False)
class RobotSnapshot:
    """State of a robot as it is published.

    Attributes:
        state: that was read in this control period.
        orientation: the robot's own (w, x, y, z), (4,), as an IMU measures it; None where it has none.
        stopped: why the robot is stopped, or None.
        posture: name of the idle supervisor's state.
        controller: who holds the robot, or None.
        posed_at_s: when the newest pose from outside came, by the robot's time source; None where the pose is
            the robot's own.
        stamp_ns: nanoseconds since 1970.
    """

    state: RobotState
    orientation: FloatArray | None
    stopped: str | None
    posture: str
    controller: str | None
    posed_at_s: float | None = None
    stamp_ns: int = field(default_factory=time.time_ns)
