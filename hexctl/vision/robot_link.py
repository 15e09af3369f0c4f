"""Link between camera and robot: receive joint states, send poses."""

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import zenoh

from hexctl.backends.zenoh.zenoh_client import linked_robot
from hexctl.errors import MessageError
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z, yaw_rad
from hexctl.types import ArrayFields, BoolArray, FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import decode_orientation, encode_pose
from hexctl.wire.ros_cdr import stamp_s
from hexctl.wire.transit_delay import StampCheck, TransitDelay
from hexctl.wire.zenoh_messages import StateTag, decode_positions

#: Length of the queue: ten seconds of states; older ones are dropped.
MOST_STATES = 500

#: An orientation older than this does not belong to a state any more.
STALE_YAW_S = 0.1


#: A state later than this comes from a restarted robot, whose clock is another one.
OTHER_CLOCK_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class LegState(ArrayFields):
    """State of a robot at one time.

    Attributes:
        at_s: time of the measurement on time.monotonic of this computer, plus the minimum transfer time.
        joint_positions_rad: (18,).
        foot_contacts: (6,), or None without contact sensors.
        yaw_rad: yaw of the robot's own sensor in its own frame; None without one.
    """

    at_s: float
    joint_positions_rad: FloatArray
    foot_contacts: BoolArray | None
    yaw_rad: float | None


class RobotLink:
    """A robot on a link, as it describes itself: its states as they come, and its pose as it is seen."""

    def __init__(self, robot: Robot, session: zenoh.Session, keys: KeyMap, *, plain: bool) -> None:
        self.robot, self._plain = robot, plain
        self._states: deque[LegState] = deque(maxlen=MOST_STATES)
        self._yaw: tuple[float, float] | None = None
        self._transit, self._yaw_stamps = TransitDelay(OTHER_CLOCK_S), StampCheck(OTHER_CLOCK_S)
        # A wall clock that is never set: a step back would make poses late.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        for kind, take in (("imu", self._take_yaw), ("joint_states", self._take_state)):
            session.declare_subscriber(getattr(keys, kind), partial(self._guarded, take))
        self._publisher = session.declare_publisher(
            keys.pose, congestion_control=zenoh.CongestionControl.DROP, express=True
        )

    def states(self) -> list[LegState]:
        """States since the last call, the oldest first."""
        taken = []
        while self._states:
            taken.append(self._states.popleft())
        return taken

    def publish(
        self, pose: PlanarPose, height_m: float, *, position_variance_m2: float, yaw_variance_rad2: float
    ) -> None:
        """Send the robot the current pose of its base, its height above the floor, and their variances."""
        payload = encode_pose(
            np.array([pose.x_m, pose.y_m, height_m]),
            about_z(pose.yaw_rad),
            position_variance_m2=position_variance_m2,
            yaw_variance_rad2=yaw_variance_rad2,
            stamp_ns=self._epoch_ns + time.monotonic_ns(),
        )
        self._publisher.put(payload)

    def _guarded(self, take: Any, sample: Any) -> None:
        """Take a sample; one that cannot be read never ends the thread of Zenoh."""
        with suppress(MessageError):
            take(sample, time.monotonic())

    def _take_yaw(self, sample: Any, now_s: float) -> None:
        payload = bytes(sample.payload)
        quaternion = decode_orientation(payload)
        if not self._yaw_stamps.admits(stamp_s(payload), now_s):
            return
        self._yaw = None if quaternion is None else (now_s, float(yaw_rad(quaternion)))

    def _take_state(self, sample: Any, now_s: float) -> None:
        joint_positions_rad = decode_positions(bytes(sample.payload))
        contacts, at_s = None, now_s
        if not self._plain:
            tag = StateTag.unpacked(b"" if sample.attachment is None else bytes(sample.attachment))
            contacts = tag.contacts
            # As if each message took as long as the fastest: by arrival times the robot would seem to jump.
            at_s = now_s - self._transit.delay_s(tag.stamp_ns / 1e9, now_s) - tag.age_us / 1e6
        known = self._yaw is not None and now_s - self._yaw[0] <= STALE_YAW_S
        yaw = self._yaw[1] if known and self._yaw is not None else None
        self._states.append(LegState(at_s, joint_positions_rad, contacts, yaw))


@contextmanager
def robot_link(link: Link, name: str | None = None) -> Iterator[RobotLink]:
    """End of a link for a camera, until the block ends; for arguments and errors see `linked_robot`."""
    with linked_robot(link, Role.CONTROLLER, name) as (session, robot):
        yield RobotLink(robot, session, link.keys(robot.name), plain=link.plain)
