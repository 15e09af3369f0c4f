"""True pose and joint angles of a simulated robot over the last second."""

import threading
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.types import FloatArray
from hexctl.vision.robot_link import linked_robot
from hexctl.vision.twin.rendering import RobotPosture
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
        self._truths = _Series()
        self._joints = _Series()

    def add_truth(self, at_s: float, position: FloatArray, quaternion: FloatArray) -> None:
        """Add a position (3,) in m and an orientation (4,) as (w, x, y, z)."""
        self._truths.add(at_s, np.concatenate([position, quaternion]))

    def add_joints(self, at_s: float, joint_positions_rad: FloatArray) -> None:
        """Add joint angles, (18,)."""
        self._joints.add(at_s, joint_positions_rad)

    @property
    def newest_at_s(self) -> float | None:
        """When the newest truth came; None before there is a whole posture."""
        return self._truths.newest_at_s if self._joints.newest_at_s is not None else None

    def at(self, at_s: float) -> RobotPosture | None:
        """Posture at a time, clamped to the history; None before the first."""
        truth, joints = self._truths.at(at_s), self._joints.at(at_s)
        if truth is None or joints is None:
            return None
        return RobotPosture(truth[:3], truth[3:] / np.linalg.norm(truth[3:]), joints)


class _Series:
    """Arrays of one shape by time, written by one thread and read by another."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._samples: deque[tuple[float, FloatArray]] = deque(maxlen=KEPT)

    @property
    def newest_at_s(self) -> float | None:
        with self._lock:
            return self._samples[-1][0] if self._samples else None

    def add(self, at_s: float, values: FloatArray) -> None:
        with self._lock:
            self._samples.append((at_s, values))

    def at(self, at_s: float) -> FloatArray | None:
        with self._lock:
            samples = list(self._samples)
        if not samples:
            return None
        index = bisect_left(samples, at_s, key=lambda sample: sample[0])
        if index in (0, len(samples)):
            return samples[min(index, len(samples) - 1)][1]
        (before_s, before), (after_s, after) = samples[index - 1 : index + 1]
        share = (at_s - before_s) / (after_s - before_s)
        # Both signs of a quaternion are one orientation; from one state to the next it turns by a degree.
        if len(after) == 7 and before[3:] @ after[3:] < 0:
            after = np.concatenate([after[:3], -after[3:]])
        return (1 - share) * before + share * after


@contextmanager
def followed_robot(link: Link, name: str | None = None) -> Iterator[tuple[Robot, PostureHistory]]:
    """Collect the postures of a simulated robot on a link for a block.

    Args:
        link: link to the robot.
        name: name of the robot; None for the only one.

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
    at_s = time.monotonic()
    try:
        position, quaternion = decode_pose(bytes(sample.payload))
    except MessageError:
        return
    if position is not None and quaternion is not None:
        history.add_truth(at_s, position, quaternion)


def _take_joints(history: PostureHistory, sample: Any) -> None:
    at_s = time.monotonic()
    try:
        history.add_joints(at_s, decode_positions(bytes(sample.payload)))
    except MessageError:
        return
