"""Zenoh client: queries, the lease of a robot, and the served robot as LegServos."""

import math
import os
import re
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import zenoh

from hexctl.backends.base import check_targets
from hexctl.backends.clock import WallClock
from hexctl.backends.ticked_servos import TickedServos
from hexctl.backends.zenoh.subscriber import LatestValues, StateSubscriber
from hexctl.errors import InputError, MessageError, RobotFaultError, argument, shown
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import JointTargets, RobotState
from hexctl.waiting import wait_for
from hexctl.wire import TIME_TO_LIVE_S
from hexctl.wire.description import (
    RobotIdentity,
    check_may_command,
    check_same_robot,
    decode_answer,
    encode_json,
    robot_of,
    status_of,
)
from hexctl.wire.links import ANY_ROBOT, CLEAR_COMMAND, Link, Role
from hexctl.wire.zenoh_messages import LEASE_ID_BYTES, CommandTag, encode_positions, prepare_codec
from hexctl.wire.zenoh_session import open_session

#: A robot answers within a tick; more than this is silence.
ANSWER_TIMEOUT_S = 1.0

#: How long a robot may take to give a lease.
ACQUIRE_TIMEOUT_S = 2.0

#: Shortest and longest lease in s. A lease is renewed after a third of its time.
LEASES_S = (0.1, 600.0)

#: How long a robot may take to describe itself.
DESCRIBE_TIMEOUT_S = 3.0

#: Intervals of repeated lease requests: on lossy links an answer arrives before the robot expires. Slow links
#: get a third of the lease at the end.
RESEND_S = (0.03, 0.03, 0.05, 0.1)

#: How long the reason for a lost lease may take to arrive.
STOP_REASON_TIMEOUT_S = 0.3

#: Where in the robot's period the ticks of this end fall: as far from its ticks as possible.
PHASE = 0.5

NO_LEASE = bytes(LEASE_ID_BYTES)


def ask(
    session: zenoh.Session,
    key: str,
    content: dict[str, Any] | None = None,
    *,
    timeout_s: float = ANSWER_TIMEOUT_S,
) -> list[dict[str, Any]]:
    """Answers of the robots at a key or key expression, one JSON object each; empty if none answers."""
    payload = None if content is None else encode_json(content)
    answers = []
    for reply in session.get(key, payload=payload, timeout=timeout_s):
        if reply.ok is not None:
            try:
                answers.append(decode_answer(bytes(reply.ok.payload)))
            except MessageError:
                continue
    return answers


def ask_until(
    session: zenoh.Session,
    key: str,
    content: dict[str, Any] | None = None,
    *,
    timeout_s: float,
    silence: str,
) -> list[dict[str, Any]]:
    """Repeat a query, as the robot may be starting; raises RobotFaultError with `silence` if none answers."""
    once_s = min(ANSWER_TIMEOUT_S, timeout_s)
    return wait_for(lambda: ask(session, key, content, timeout_s=once_s), timeout_s, silence, poll_s=0.05)


def owner_name() -> str:
    """Name under which this process holds a lease, shown to other clients."""
    return f"hexctl on {socket.gethostname()} (process {os.getpid()})"


def granted(answer: Mapping[str, Any]) -> tuple[bytes, int, float]:
    """Identifier, number and duration in s of a granted lease; raises RobotFaultError if it is invalid."""
    text, sequence = answer.get("lease"), answer.get("sequence")
    duration_s: Any = answer.get("duration_s")
    if (
        isinstance(text, str)
        and re.fullmatch(f"[0-9a-f]{{{2 * LEASE_ID_BYTES}}}", text)
        and type(sequence) is int
        and 0 < sequence < 1 << 32
        and type(duration_s) in (int, float)
        and LEASES_S[0] <= duration_s <= LEASES_S[1]
    ):
        return bytes.fromhex(text), sequence, float(duration_s)
    raise RobotFaultError(
        f"the robot grants a lease that this hexctl does not understand: {shown(dict(answer))}; install the "
        "same version on both ends"
    )


class LeaseClient:
    """Holds the lease of a robot from `acquire` to `release`, renewing it at a third of its time.

    `after_state` is the number of the newest state before the lease, `lost` why it is lost, or None.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        heard_at_s: Callable[[], float] = lambda: -math.inf,
        *,
        clear: str = CLEAR_COMMAND,
        time: TimeSource = WALL_TIME,
    ) -> None:
        """Create a client without a lease; `clear` is the command that ends a stop, for messages.

        `heard_at_s` is the last sign of life of the robot: lost answers do not mean that it is gone.
        """
        self._clear, self._time = clear, time
        self._session, self._key, self._heard_at_s = session, key, heard_at_s
        self.lease_id = b""
        self.sequence = self.after_state = 0
        self.lost: str | None = None
        self.lost_at_s = 0.0
        self._duration_s = 0.0
        self._released = threading.Event()
        self._renewal: threading.Thread | None = None

    def acquire(self) -> None:
        """Take the lease; raises RobotFaultError that names its holder or the reason of a refusal."""
        answer = self._query_lease()
        self.lease_id, self.sequence, self._duration_s = granted(answer)
        state = answer.get("state")
        self.after_state = state if type(state) is int and state > 0 else 0
        self._renewal = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._renewal.start()

    def _query_lease(self) -> dict[str, Any]:
        wanted = {"op": "acquire", "owner": owner_name()}
        refusal = ""

        def granted() -> dict[str, Any] | None:
            nonlocal refusal
            silence = "the robot gives no lease: it does not answer, or this end may not command it"
            answers = ask_until(
                self._session, self._key, wanted, timeout_s=ACQUIRE_TIMEOUT_S, silence=silence
            )
            if answers[0].get("error") is None:
                return answers[0]
            refusal = str(answers[0]["error"])
            # A lost answer may have granted the lease to this process already; that lease expires by itself.
            if owner_name() not in refusal:
                raise RobotFaultError(refusal.replace(CLEAR_COMMAND, self._clear))
            return None

        return wait_for(granted, ACQUIRE_TIMEOUT_S, lambda: refusal, poll_s=0.2)

    def pause_watchdog(self, after: int) -> None:
        """Announce that after command number `after` none is due until the next one."""
        self._request("rest", after=after)

    def release(self) -> None:
        """Return the lease if it is valid."""
        self._released.set()
        if self._renewal is not None:
            self._time.join(self._renewal)
            if self.lost is None:
                self._request("release")

    def _renew(self) -> None:
        """Renew until released; a robot silent for the duration of the lease is lost."""
        heard_s = self._time.now()
        pause_s = self._duration_s / 3
        while not self._time.wait(self._released, pause_s) and self.lost is None:
            answer = self._request("renew")
            pause_s = self._duration_s / (20 if answer is None else 3)
            if answer is not None:
                heard_s = self.lost_at_s = self._time.now()
                self.lost = answer.get("error")
                continue
            silent_s = self._time.now() - max(heard_s, self._heard_at_s())
            if silent_s > self._duration_s:
                self.lost_at_s = self._time.now()
                self.lost = f"the robot has not answered for {silent_s:.1f} s"

    def _request(self, op: str, **words: Any) -> dict[str, Any] | None:
        """Repeat a request about the lease until it is answered; None without an answer."""
        content = {"op": op, "lease": self.lease_id.hex(), **words}
        soon_s = [min(resend_s, self._duration_s / 10) for resend_s in RESEND_S]
        for timeout_s in (*soon_s, self._duration_s / 3):
            try:
                answers = ask(self._session, self._key, content, timeout_s=timeout_s)
            except zenoh.ZError:
                return None
            if answers:
                return answers[0]
        return None


class ZenohServos(TickedServos):
    """Client of a robot that `hexctl serve` puts on the network.

    Connecting compares the robot descriptions of both ends and takes the lease; closing releases it. The
    clock is the local wall clock. `read` gives the newest state that arrived before the tick.

    Args:
        robot: the expected robot, or the name or path of its file.
        latest: storage of received messages; a new one unless given.
    """

    what = "the robot on the network"

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        link: Link,
        latest: LatestValues | None = None,
        time: TimeSource = WALL_TIME,
    ) -> None:
        self._wall = WallClock(time=time)
        super().__init__(robot, self._wall)
        self._link = link
        self.identity: RobotIdentity | None = None
        self.simulated: Mapping[str, str] | None = None
        self._keys = link.keys(self._robot.name)
        self._subscriber = StateSubscriber(self._keys, latest or LatestValues(time), plain=link.plain)
        self._lease: LeaseClient | None = None
        self._sequence = 0

    @property
    def link(self) -> Link:
        """Link to the robot."""
        return self._link

    @property
    def remote(self) -> Self:
        """The servos themselves."""
        return self

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Last reported failures of a remote simulation, by leg; None for a robot."""
        return None if self._opened is None else self._subscriber.failures

    def _open_all(self, opening: ExitStack) -> None:
        """Connect. Raises InputError for an invalid link, else RobotFaultError with advice."""
        prepare_codec()
        session = opening.enter_context(open_session(self._link, Role.CONTROLLER, self._keys))
        if not self._link.plain:
            self._check_robot(session)
        self._subscriber.subscribe(session)
        if not self._link.plain:
            self._lease = LeaseClient(
                session,
                self._keys.lease,
                lambda: self._subscriber.heard_at_s,
                clear=self._link.clear_command,
                time=self._clock.time,
            )
            self._lease.acquire()
            opening.callback(self._lease.release)
            # An older state may report a stop that the lease has lifted.
            self._subscriber.forget(after=self._lease.after_state)
        self._publisher = session.declare_publisher(
            self._keys.command,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._sequence = 0
        # The ticks of this end fall into the middle of the robot's.
        self._wall.begin(self._subscriber.wait_for_first_s() - self._clock.period_s * PHASE)

    def _newest(self) -> RobotState:
        """Newest state; raises RobotFaultError when the robot is silent, or when the lease is lost."""
        try:
            state = self._subscriber.newest(self._clock.now_s)
            self._check_ours(state)
        except RobotFaultError as error:
            if (why := self._clock.standing_still()) is None:
                raise
            raise RobotFaultError(f"{why}, and the robot stopped without its commands") from error
        return state

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets to the robot, whose guard has the last word."""
        self._check_connected()
        check_targets(targets)
        self._sequence += 1
        self._publisher.put(encode_positions(targets.joint_positions_rad), attachment=self._tag())
        return targets

    def pause_watchdog(self) -> None:
        """Announce that no command is due until the next one."""
        if self._opened is not None and self._lease is not None:
            self._lease.pause_watchdog(self._sequence)

    def _check_robot(self, session: zenoh.Session) -> None:
        answer = robot_at(session, self._link, self._robot.name)
        check_same_robot(answer, self._robot)
        status = status_of(answer)
        identity = RobotIdentity.of_answer(status)
        check_may_command(identity, self._link)
        self.identity = identity
        simulated = status.get("simulated")
        self.simulated = simulated if isinstance(simulated, dict) else None

    def _check_ours(self, state: RobotState) -> None:
        """Raise RobotFaultError when the lease is lost; a state with the reason, a stop, may still arrive."""
        lease = self._lease
        if lease is None or lease.lost is None or state.stopped is not None:
            return
        if self._clock.time.now() - lease.lost_at_s > STOP_REASON_TIMEOUT_S:
            raise RobotFaultError(f"this end no longer commands the robot: {lease.lost}; run it again")

    def _tag(self) -> bytes:
        lease = self._lease
        return CommandTag(
            sequence=self._sequence,
            stamp_ns=int(1e9 * self._clock.time.now()),
            time_to_live_ms=round(1000 * TIME_TO_LIVE_S),
            lease_id=NO_LEASE if lease is None else lease.lease_id,
            lease_sequence=0 if lease is None else lease.sequence,
        ).packed()


@contextmanager
def linked_robot(
    link: Link, role: Role, name: str | None = None, *, first: bool = False
) -> Iterator[tuple[zenoh.Session, Robot]]:
    """Session on a link, and its robot; arguments and errors are those of `robot_at`."""
    with open_session(link, role, link.keys(ANY_ROBOT if name is None else name)) as session:
        yield session, robot_of(robot_at(session, link, name, first=first))


def robot_at(session: zenoh.Session, link: Link, name: str | None, *, first: bool = False) -> dict[str, Any]:
    """Description of the robot called `name` at a link, or else of the only one, or the first that answers.

    Raises RobotFaultError if no robot answers or several have the name, and InputError if several answer or
    none of them has the name.
    """
    asked = link.keys(ANY_ROBOT if name is None else name).describe
    silence = f"no robot answers at {link.endpoint}; is hexctl serve running there?"
    try:
        answers = ask_until(session, asked, timeout_s=DESCRIBE_TIMEOUT_S, silence=silence)
    except RobotFaultError:
        others = [] if name is None else ask(session, link.keys(ANY_ROBOT).describe)
        if not others:
            raise
        raise _not_one(f"{name}", others) from None
    if len(answers) > 1 and name is not None:
        raise RobotFaultError(
            f"{len(answers)} robots called {name} answer at {link.endpoint}; give them different names"
        )
    if len(answers) > 1 and not first:
        raise _not_one("none", answers)
    return answers[0]


def _not_one(got: str, there: list[dict[str, Any]]) -> InputError:
    names = ", ".join(sorted(robot_of(answer).name for answer in there))
    return InputError(f"{argument('robot')}: got {got}, and there are: {names}; allowed: one of them")


@contextmanager
def subscribe_states(link: Link) -> Iterator[tuple[Robot, StateSubscriber]]:
    """First robot that answers at a link and a subscriber of its states, without commands.

    Raises RobotFaultError when it sends no state; for other errors see `linked_robot`.
    """
    with linked_robot(link, Role.VIEWER, first=True) as (session, robot):
        states = StateSubscriber(link.keys(robot.name), LatestValues(), plain=link.plain)
        states.subscribe(session)
        states.wait_for_first_s()
        yield robot, states
