"""True pose and joint angles of a simulated robot over the last second."""

import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np

from hexctl.backends.zenoh.zenoh_client import linked_robot
from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.simulators.camera.rendering import RobotPosture
from hexctl.types import FloatArray
from hexctl.waiting import comes_true
from hexctl.wire.links import Link, Role
from hexctl.wire.pose import decode_pose
from hexctl.wire.zenoh_messages import decode_positions

#: Length of the history: one second of states.
KEPT = 100

#: Timeout for the first true pose.
FIRST_TRUTH_S = 3.0


class PostureHistory:
    """Postures by the time of their arrival on time.monotonic; in between they are interpolated."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._truths: deque[tuple[float, FloatArray]] = deque(maxlen=KEPT)
        self._joints: deque[tuple[float, FloatArray]] = deque(maxlen=KEPT)

    def add_truth(self, at_s: float, position: FloatArray, quaternion: FloatArray) -> None:
        """Add a position (3,) in m and an orientation (4,) as (w, x, y, z)."""
        with self._lock:
            # Both signs of a quaternion are one orientation; from one state to the next it turns by a degree.
            if self._truths and self._truths[-1][1][3:] @ quaternion < 0:
                quaternion = -quaternion
            self._truths.append((at_s, np.concatenate([position, quaternion])))

    def add_joints(self, at_s: float, joint_positions_rad: FloatArray) -> None:
        """Add joint angles, (18,)."""
        with self._lock:
            self._joints.append((at_s, joint_positions_rad))

    @property
    def newest_at_s(self) -> float | None:
        """When the newest truth came; None before there is a whole posture."""
        with self._lock:
            return self._truths[-1][0] if self._truths and self._joints else None

    def at(self, at_s: float) -> RobotPosture | None:
        """Posture at a time, clamped to the history; None before the first."""
        with self._lock:
            truths, joints = list(self._truths), list(self._joints)
        if not truths or not joints:
            return None
        truth = _interpolated(truths, at_s)
        return RobotPosture(truth[:3], truth[3:] / np.linalg.norm(truth[3:]), _interpolated(joints, at_s))


def _interpolated(samples: list[tuple[float, FloatArray]], at_s: float) -> FloatArray:
    times_s = np.array([sample_s for sample_s, _ in samples])
    columns = np.transpose([values for _, values in samples])
    return np.array([np.interp(at_s, times_s, column) for column in columns])


@contextmanager
def followed_robot(link: Link, name: str | None = None) -> Iterator[tuple[Robot, PostureHistory]]:
    """Collect the postures of a simulated robot, the only one or that of a name, on a link for a block.

    Raises RobotFaultError if no robot answers or it does not publish its true pose, and InputError if several
    answer.
    """
    with linked_robot(link, Role.VIEWER, name) as (session, robot):
        keys, history = link.keys(robot.name), PostureHistory()
        for kind, take in (("truth", _take_truth), ("joint_states", _take_joints)):
            session.declare_subscriber(getattr(keys, kind), partial(take, history))
        if not comes_true(lambda: history.newest_at_s is not None, FIRST_TRUTH_S):
            raise RobotFaultError(
                f"{robot.name} at {link.endpoint} does not publish its true pose; "
                "only a robot of hexctl serve --backend sim does"
            )
        yield robot, history


def _take_truth(history: PostureHistory, sample: Any) -> None:
    with suppress(MessageError):
        position, quaternion = decode_pose(bytes(sample.payload))
        if position is not None and quaternion is not None:
            history.add_truth(time.monotonic(), position, quaternion)


def _take_joints(history: PostureHistory, sample: Any) -> None:
    with suppress(MessageError):
        history.add_joints(time.monotonic(), decode_positions(bytes(sample.payload)))
