"""State subscriber: the latest messages of a served robot, put together into robot states."""

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import zenoh

from hexctl.errors import MessageError, RobotFaultError
from hexctl.types import FloatArray, RobotState
from hexctl.wire.links import KeyMap
from hexctl.wire.messages import StateTag, contacts_of, decode_battery, decode_pose, decode_positions


@dataclass(frozen=True, slots=True)
class Letter:
    """A message that came.

    Attributes:
        payload: as it came.
        attachment: what came beside it, or None.
        at_s: when, on time.monotonic.
    """

    payload: bytes
    attachment: bytes | None
    at_s: float


class Mailbox:
    """Keeps the newest letter of each kind; a letter that is replaced unread is no loss."""

    def __init__(self) -> None:
        self._newest: dict[str, Letter] = {}

    def put(self, kind: str, sample: Any) -> None:
        """Keep a Zenoh sample as the newest of its kind."""
        attachment = None if sample.attachment is None else bytes(sample.attachment)
        self._newest[kind] = Letter(bytes(sample.payload), attachment, time.monotonic())

    def clear(self) -> None:
        """Throw everything away."""
        self._newest.clear()

    def newest(self, kind: str) -> Letter | None:
        """Return the newest letter of a kind, or None before the first."""
        return self._newest.get(kind)


HEARD = ("joint_states", "odom", "battery")

#: How long a robot may take to send its first state.
FIRST_STATE_TIMEOUT_S = 3.0

#: A robot that has said nothing for this long has gone; long before, the guard has stopped for an old state.
GONE_AFTER_S = 5.0

#: A pose this much older than the joints' state is none.
STALE_POSE_S = 0.2

#: What is taken for granted of a robot that sends no tags.
PLAIN_TAG = StateTag(
    sequence=0, stamp_ns=0, age_us=0, command_sequence=0, measured=True, healthy=True, contacts=None
)


class Ear:
    """Keeps the newest that a robot says and puts states together from it.

    `plain` is for a robot that sends no tags.
    """

    def __init__(self, keys: KeyMap, mailbox: Mailbox, *, plain: bool = False) -> None:
        self._keys, self._mailbox, self._plain = keys, mailbox, plain

    def listen(self, session: zenoh.Session) -> None:
        """Begin to listen, having heard nothing."""
        self._mailbox.clear()
        for kind in HEARD:
            session.declare_subscriber(getattr(self._keys, kind), partial(self._mailbox.put, kind))

    def forget(self) -> None:
        """Take nothing that was heard so far for true."""
        self._mailbox.clear()

    def await_first_s(self) -> float:
        """Wait for the first state and return when it came, on time.monotonic.

        Raises RobotFaultError when none comes.
        """
        deadline_s = time.monotonic() + FIRST_STATE_TIMEOUT_S
        while (letter := self._mailbox.newest("joint_states")) is None:
            if time.monotonic() > deadline_s:
                raise RobotFaultError(
                    f"the robot sends no state at {self._keys.joint_states}; see hexctl status"
                )
            time.sleep(0.001)
        return letter.at_s

    def newest(self, clock_s: float) -> RobotState:
        """Return the newest state.

        Args:
            clock_s: the time now on the clock that the state's stamp shall be on.

        Raises RobotFaultError for a robot that is silent or sends something else.
        """
        letter = self._mailbox.newest("joint_states")
        now_s = time.monotonic()
        if letter is None or now_s - letter.at_s > GONE_AFTER_S:
            raise RobotFaultError(
                f"the robot has been silent for {GONE_AFTER_S:g} s; "
                "see hexctl status, or start hexctl serve again"
            )
        try:
            positions_rad = decode_positions(letter.payload)
            tag = PLAIN_TAG if self._plain else StateTag.unpacked(letter.attachment or b"")
        except MessageError as error:
            raise RobotFaultError(f"the robot sends states that are none: {error}") from error
        position, quaternion = self._pose(letter.at_s)
        battery_v, battery_share = self._battery()
        return RobotState(
            positions_rad,
            stamp_s=max(0.0, clock_s - (now_s - letter.at_s)),
            measured=tag.measured,
            base_position_world=position,
            base_quaternion_world=quaternion,
            foot_contacts=contacts_of(tag),
            age_s=now_s - letter.at_s + tag.age_us / 1e6,
            healthy=tag.healthy,
            fault=tag.fault,
            stopped=tag.stopped,
            battery_v=battery_v,
            battery_share=battery_share,
        )

    def _pose(self, state_at_s: float) -> tuple[FloatArray | None, FloatArray | None]:
        """Return the newest pose; it is lost when states go on without it, not when all is silent."""
        letter = self._mailbox.newest("odom")
        if letter is None or state_at_s - letter.at_s > STALE_POSE_S:
            return None, None
        try:
            return decode_pose(letter.payload)
        except MessageError:
            return None, None

    def _battery(self) -> tuple[float | None, float | None]:
        letter = self._mailbox.newest("battery")
        try:
            return (None, None) if letter is None else decode_battery(letter.payload)
        except MessageError:
            return None, None
