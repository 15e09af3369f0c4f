"""Messages of a served robot's own orientation, and of the true pose of a simulation."""

import time
from collections.abc import Iterator

from hexctl.backends.base import TruePose
from hexctl.robot.rotations import xyzw
from hexctl.types import FloatArray
from hexctl.wire.pose import encode_pose
from hexctl.wire.ros import telemetry


class ServedPoses:
    """Encodes the messages of the kinds `imu` and `truth`."""

    def __init__(self) -> None:
        self._imu = telemetry.imu()

    def messages(self, orientation: FloatArray | None, truth: TruePose | None) -> Iterator[tuple[str, bytes]]:
        """Kind and payload of each message; orientations are (w, x, y, z), positions in m."""
        stamp_ns = time.time_ns()
        if orientation is not None:
            yield "imu", self._imu.encode(stamp_ns, xyzw(orientation))
        if truth is not None:
            yield "truth", encode_pose(*truth, stamp_ns=stamp_ns)
