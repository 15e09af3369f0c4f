"""State that the robot's thread hands to ROS in every control period."""

import time
from dataclasses import dataclass, field

from hexctl.types import FloatArray, RobotState


@dataclass(frozen=True, slots=True, eq=False)
class RobotSnapshot:
    """State of a robot for publishing; `stamp_ns` is nanoseconds since 1970.

    Attributes:
        orientation: of the robot's IMU, (w, x, y, z), (4,); None without one.
        posed_at_s: arrival of the newest external pose, by the robot's time source; None without one.
    """

    state: RobotState
    orientation: FloatArray | None
    stopped: str | None
    posture: str
    controller: str | None
    posed_at_s: float | None = None
    stamp_ns: int = field(default_factory=time.time_ns)
