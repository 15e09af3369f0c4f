"""State subscriber: assembles robot states from the latest messages of a served robot."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import zenoh

from hexctl.errors import InputError, MessageError, RobotFaultError, printable
from hexctl.robot.failure import Failure, each_failure
from hexctl.robot.failure_grammar import parse_failure
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import FloatArray, RobotState, ServoReadings
from hexctl.waiting import wait_for
from hexctl.wire.description import decode_answer
from hexctl.wire.links import KeyMap
from hexctl.wire.pose import decode_pose
from hexctl.wire.ros_cdr import stamp_s
from hexctl.wire.transit_delay import MOST_LATE_S, RENEWED_S, TransitDelay
from hexctl.wire.zenoh_messages import StateTag, decode_battery, decode_joints

#: Subscribed kinds of messages.
SUBSCRIBED = ("joint_states", "odom", "battery", "status")

#: How long a robot may take to send its first state.
FIRST_STATE_TIMEOUT_S = 3.0

#: Silence after which a robot is lost; long before, the guard has stopped for an old state.
GONE_AFTER_S = 5.0

#: A pose this much older than the joint state is not used.
STALE_POSE_S = 0.2

#: Tag assumed for a robot that sends none.
PLAIN_TAG = StateTag(
    sequence=0, stamp_ns=0, age_us=0, command_sequence=0, measured=True, healthy=True, contacts=None
)


@dataclass(frozen=True, slots=True)
class StampedSample:
    """A received message and its arrival time."""

    payload: bytes
    attachment: bytes | None
    at_s: float


class LatestValues:
    """Keeps the newest sample of each kind."""

    def __init__(self, time: TimeSource = WALL_TIME) -> None:
        self.time = time
        self._newest: dict[str, StampedSample] = {}

    def put(self, kind: str, sample: Any) -> None:
        """Replace the sample of its kind."""
        attachment = None if sample.attachment is None else bytes(sample.attachment)
        self._newest[kind] = StampedSample(bytes(sample.payload), attachment, self.time.now())

    def clear(self) -> None:
        """Discard everything."""
        self._newest.clear()

    def newest(self, kind: str) -> StampedSample | None:
        """The newest sample of a kind, or None before the first."""
        return self._newest.get(kind)


class StateSubscriber:
    """Assembles robot states from the messages of a served robot; a `plain` one sends no tags."""

    def __init__(self, keys: KeyMap, latest: LatestValues, *, plain: bool = False) -> None:
        self._keys, self._latest, self._plain = keys, latest, plain
        self._forget_status()
        self._forget_clocks()
        self._after = 0

    def _forget_clocks(self) -> None:
        self._transits = {kind: TransitDelay(renewed_s=RENEWED_S) for kind in ("joint_states", "odom")}

    def _forget_status(self) -> None:
        self._failures: tuple[Failure, ...] | None = None
        self._servos: ServoReadings | None = None
        self._warnings: tuple[str, ...] = ()
        self._status_of: StampedSample | None = None

    def subscribe(self, session: zenoh.Session) -> None:
        """Subscribe, with nothing received yet."""
        self._latest.clear()
        self._forget_status()
        self._forget_clocks()
        for kind in SUBSCRIBED:
            session.declare_subscriber(getattr(self._keys, kind), partial(self._latest.put, kind))

    def forget(self, after: int = 0) -> None:
        """Discard everything received so far, and later states up to a number."""
        self._after = after
        self._latest.clear()
        self._forget_clocks()

    @property
    def heard_at_s(self) -> float:
        """Arrival time of the newest state; minus infinity before the first."""
        sample = self._latest.newest("joint_states")
        return -math.inf if sample is None else sample.at_s

    def wait_for_first_s(self) -> float:
        """Wait for the first state; its arrival time. Raises RobotFaultError if none arrives."""
        message = f"the robot sends no state at {self._keys.joint_states}; see hexctl status"
        time = self._latest.time
        return wait_for(self._first, FIRST_STATE_TIMEOUT_S, message, poll_s=0.001, time=time).at_s

    def _first(self) -> StampedSample | None:
        """The newest state; None if it is discarded."""
        sample = self._latest.newest("joint_states")
        if sample is None or not self._after:
            return sample
        with suppress(MessageError):  # an invalid one is reported when it is read
            if StateTag.unpacked(sample.attachment or b"").sequence <= self._after:
                return None
        return sample

    def newest(self, clock_s: float) -> RobotState:
        """The newest state; `clock_s` is the current time on the clock of its stamp.

        Raises RobotFaultError if the robot is silent or sends invalid states.
        """
        sample = self._latest.newest("joint_states")
        now_s = self._latest.time.now()
        if sample is None or now_s - sample.at_s > GONE_AFTER_S:
            raise RobotFaultError(
                f"the robot has been silent for {GONE_AFTER_S:g} s; "
                "see hexctl status, or start hexctl serve again"
            )
        try:
            joint_positions_rad, torques_nm, velocities_rad_s = decode_joints(sample.payload)
            tag = PLAIN_TAG if self._plain else StateTag.unpacked(sample.attachment or b"")
        except MessageError as error:
            raise RobotFaultError(f"the robot sends invalid states: {error}") from error
        delay_s = self._delay_s("joint_states", sample, tag)
        position, quaternion = self._pose(sample.at_s)
        self._take_status()
        battery_v, battery_share = self._battery()
        return RobotState(
            joint_positions_rad,
            stamp_s=max(0.0, clock_s - (now_s - sample.at_s) - delay_s),
            measured=tag.measured,
            base_position_world=position,
            base_quaternion_world=quaternion,
            foot_contacts=tag.contacts,
            age_s=now_s - sample.at_s + delay_s + tag.age_us / 1e6,
            healthy=tag.healthy,
            fault=_told(tag.fault),
            stopped=_told(tag.stopped),
            battery_v=battery_v,
            battery_share=battery_share,
            joint_torques_nm=torques_nm,
            servos=self._servos_at(now_s),
            warnings=self._warnings,
            stale_joints=tag.stale_joints,
            joint_velocities_rad_s=velocities_rad_s,
        )

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Last reported failures of a remote simulation, by leg; None for a robot."""
        self._take_status()
        return self._failures

    def _take_status(self) -> None:
        sample = self._latest.newest("status")
        if sample is None or sample is self._status_of:
            return
        self._status_of = sample
        try:
            status = decode_answer(sample.payload)
        except MessageError:
            status = {}
        self._failures, self._servos = _failures_of(status), _servos_of(status)
        warnings = status.get("warnings")
        self._warnings = tuple(map(str, warnings)) if isinstance(warnings, list) else ()

    def _servos_at(self, now_s: float) -> ServoReadings | None:
        if self._servos is None or self._status_of is None:
            return None
        return replace(self._servos.copy(), ages_s=self._servos.ages_s + (now_s - self._status_of.at_s))

    def _pose(self, state_at_s: float) -> tuple[FloatArray | None, FloatArray | None]:
        """The newest pose; None once states keep arriving without it, but not in silence."""
        sample = self._latest.newest("odom")
        if sample is None or state_at_s - sample.at_s > STALE_POSE_S:
            return None, None
        try:
            tag = PLAIN_TAG if self._plain else StateTag.unpacked(sample.attachment or b"")
            late = self._delay_s("odom", sample, tag) > MOST_LATE_S
            return (None, None) if late else decode_pose(sample.payload)
        except MessageError:
            return None, None

    def _delay_s(self, kind: str, sample: StampedSample, tag: StateTag) -> float:
        """Delay of a sample by its tag, or by its header without one, relative to the fastest of its kind."""
        stamp = stamp_s(sample.payload) if self._plain else tag.stamp_ns / 1e9
        return 0.0 if stamp is None else self._transits[kind].delay_s(stamp, sample.at_s)

    def _battery(self) -> tuple[float | None, float | None]:
        sample = self._latest.newest("battery")
        try:
            return (None, None) if sample is None else decode_battery(sample.payload)
        except MessageError:
            return None, None


def _told(text: str | None) -> str | None:
    """Reported text with unprintable characters escaped."""
    return None if text is None else printable(text)


def _failures_of(status: Mapping[str, Any]) -> tuple[Failure, ...] | None:
    """Failures in a status, such as `5:limp`; None without any or if invalid."""
    texts = status.get("failures")
    if not isinstance(texts, list):
        return None
    try:
        return each_failure([parse_failure(str(text)) for text in texts])
    except InputError:
        return None


def _servos_of(status: Mapping[str, Any]) -> ServoReadings | None:
    try:
        return ServoReadings.from_json(status["servos"])
    except (KeyError, TypeError, ValueError):
        return None
