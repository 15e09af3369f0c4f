"""State subscriber: the latest messages of a served robot, put together into robot states."""

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh

from hexctl.errors import InputError, MessageError, RobotFaultError
from hexctl.robot.failure import Failure, each_failure, parse_failure
from hexctl.types import FloatArray, RobotState
from hexctl.waiting import wait_for
from hexctl.wire.description import decode_json
from hexctl.wire.links import KeyMap
from hexctl.wire.messages import StateTag, contacts_of, decode_battery, decode_joints, stale_joints_of
from hexctl.wire.pose import decode_pose

#: Kinds of messages that are subscribed to.
SUBSCRIBED = ("joint_states", "odom", "battery", "status")

#: How long a robot may take to send its first state.
FIRST_STATE_TIMEOUT_S = 3.0

#: A robot that has said nothing for this long has gone; long before, the guard has stopped for an old state.
GONE_AFTER_S = 5.0

#: A pose this much older than the joint state is not used.
STALE_POSE_S = 0.2

#: Tag assumed for a robot that sends none.
PLAIN_TAG = StateTag(
    sequence=0, stamp_ns=0, age_us=0, command_sequence=0, measured=True, healthy=True, contacts=None
)


@dataclass(frozen=True, slots=True)
class StampedSample:
    """A received message.

    Attributes:
        payload: the message.
        attachment: the attachment of the message, or None.
        at_s: when it arrived, on time.monotonic.
    """

    payload: bytes
    attachment: bytes | None
    at_s: float


class LatestValues:
    """Keeps the newest sample of each kind; callbacks only store, and replace what was never read."""

    def __init__(self) -> None:
        self._newest: dict[str, StampedSample] = {}

    def put(self, kind: str, sample: Any) -> None:
        """Keep a Zenoh sample as the newest of its kind."""
        attachment = None if sample.attachment is None else bytes(sample.attachment)
        self._newest[kind] = StampedSample(bytes(sample.payload), attachment, time.monotonic())

    def clear(self) -> None:
        """Discard everything."""
        self._newest.clear()

    def newest(self, kind: str) -> StampedSample | None:
        """The newest sample of a kind, or None before the first."""
        return self._newest.get(kind)


class StateSubscriber:
    """Subscribes to the messages of a served robot and puts robot states together from them.

    Args:
        keys: the keys of the robot.
        latest: where received messages are kept.
        plain: True for a robot that sends no tags.
    """

    def __init__(self, keys: KeyMap, latest: LatestValues, *, plain: bool = False) -> None:
        self._keys, self._latest, self._plain = keys, latest, plain
        self._failures: tuple[Failure, ...] | None = None
        self._failures_of: StampedSample | None = None

    def subscribe(self, session: zenoh.Session) -> None:
        """Subscribe, with nothing received yet."""
        self._latest.clear()
        for kind in SUBSCRIBED:
            session.declare_subscriber(getattr(self._keys, kind), partial(self._latest.put, kind))

    def forget(self) -> None:
        """Discard everything received so far."""
        self._latest.clear()

    def wait_for_first_s(self) -> float:
        """Arrival time of the first state, on time.monotonic, after waiting for it.

        Raises RobotFaultError when none arrives.
        """
        message = f"the robot sends no state at {self._keys.joint_states}; see hexctl status"
        newest = partial(self._latest.newest, "joint_states")
        return wait_for(newest, FIRST_STATE_TIMEOUT_S, message, poll_s=0.001).at_s

    def newest(self, clock_s: float) -> RobotState:
        """The newest state.

        Args:
            clock_s: the time now, on the clock of the state's stamp.

        Raises RobotFaultError for a robot that is silent or sends invalid states.
        """
        sample = self._latest.newest("joint_states")
        now_s = time.monotonic()
        if sample is None or now_s - sample.at_s > GONE_AFTER_S:
            raise RobotFaultError(
                f"the robot has been silent for {GONE_AFTER_S:g} s; "
                "see hexctl status, or start hexctl serve again"
            )
        try:
            positions_rad, torques_nm = decode_joints(sample.payload)
            tag = PLAIN_TAG if self._plain else StateTag.unpacked(sample.attachment or b"")
        except MessageError as error:
            raise RobotFaultError(f"the robot sends invalid states: {error}") from error
        position, quaternion = self._pose(sample.at_s)
        battery_v, battery_share = self._battery()
        return RobotState(
            positions_rad,
            stamp_s=max(0.0, clock_s - (now_s - sample.at_s)),
            measured=tag.measured,
            base_position_world=position,
            base_quaternion_world=quaternion,
            foot_contacts=contacts_of(tag),
            age_s=now_s - sample.at_s + tag.age_us / 1e6,
            healthy=tag.healthy,
            fault=tag.fault,
            stopped=tag.stopped,
            battery_v=battery_v,
            battery_share=battery_share,
            joint_torques_nm=torques_nm,
            stale_joints=stale_joints_of(tag),
        )

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Failures in force in a simulation at the other end, by leg, as it told last; None for a robot."""
        sample = self._latest.newest("status")
        if sample is not None and sample is not self._failures_of:
            self._failures_of = sample
            self._failures = _failures_of(sample.payload)
        return self._failures

    def _pose(self, state_at_s: float) -> tuple[FloatArray | None, FloatArray | None]:
        """The newest pose; None once states keep arriving without it, but not while everything is silent."""
        sample = self._latest.newest("odom")
        if sample is None or state_at_s - sample.at_s > STALE_POSE_S:
            return None, None
        try:
            return decode_pose(sample.payload)
        except MessageError:
            return None, None

    def _battery(self) -> tuple[float | None, float | None]:
        sample = self._latest.newest("battery")
        try:
            return (None, None) if sample is None else decode_battery(sample.payload)
        except MessageError:
            return None, None


def _failures_of(payload: bytes) -> tuple[Failure, ...] | None:
    """Failures that a status tells, such as `5:limp`; None where it tells none or is not understood."""
    try:
        texts = decode_json(payload).get("failures")
        if not isinstance(texts, list):
            return None
        told = [str(text).partition(":") for text in texts]
        return each_failure([parse_failure(int(leg), kind) for leg, _, kind in told])
    except (MessageError, InputError, ValueError):
        return None
