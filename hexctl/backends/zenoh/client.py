"""Zenoh client: queries, the lease of a robot, and the served robot as LegServos."""

import os
import socket
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import zenoh

from hexctl.backends.base import LegServos, check_connected, check_targets
from hexctl.backends.clock import Clock, Tick, WallClock
from hexctl.backends.zenoh.subscriber import Ear, Mailbox
from hexctl.errors import MessageError, RobotFaultError
from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState
from hexctl.wire import TIME_TO_LIVE_S
from hexctl.wire.description import (
    RobotIdentity,
    check_may_command,
    check_same_robot,
    decode_json,
    encode_json,
)
from hexctl.wire.links import Link, Role
from hexctl.wire.messages import LEASE_ID_BYTES, CommandTag, encode_positions
from hexctl.wire.session import open_session

#: A robot answers within a tick; more than this is silence.
ANSWER_TIMEOUT_S = 1.0


def ask(
    session: zenoh.Session,
    key: str,
    content: dict[str, Any] | None = None,
    *,
    timeout_s: float = ANSWER_TIMEOUT_S,
) -> list[dict[str, Any]]:
    """Return what the robots at a key answer, a JSON object each; nobody may, then the list is empty.

    Args:
        session: an open one.
        key: one key, or a key expression.
        content: what to ask, or None.
        timeout_s: how long to wait for answers.
    """
    payload = None if content is None else encode_json(content)
    answers = []
    for reply in session.get(key, payload=payload, timeout=timeout_s):
        if reply.ok is not None:
            try:
                answers.append(decode_json(bytes(reply.ok.payload)))
            except MessageError:
                continue
    return answers


def ask_until(
    session: zenoh.Session, key: str, content: dict[str, Any] | None = None, *, timeout_s: float
) -> list[dict[str, Any]]:
    """Ask again and again until somebody answers, for a while: a robot may just be coming up."""
    deadline_s = time.monotonic() + timeout_s
    while True:
        answers = ask(session, key, content, timeout_s=min(ANSWER_TIMEOUT_S, timeout_s))
        if answers or time.monotonic() > deadline_s:
            return answers
        time.sleep(0.05)


#: How long a robot may take to give a lease.
ACQUIRE_TIMEOUT_S = 2.0


def owner_name() -> str:
    """Return what this process calls itself to others who want the robot."""
    return f"hexctl on {socket.gethostname()} (process {os.getpid()})"


class LeaseClient:
    """Holds the lease of a robot from `acquire` to `release`, renewing it at a third of its time.

    Attributes:
        lease_id: what commands carry.
        sequence: number of the lease.
        lost: why the lease is gone, or None while it is in force.
        lost_at_s: since when, on time.monotonic.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session, self._key = session, key
        self.lease_id = b""
        self.sequence = 0
        self.lost: str | None = None
        self.lost_at_s = 0.0
        self._duration_s = 0.0
        self._over = threading.Event()
        self._keeper: threading.Thread | None = None

    def acquire(self) -> None:
        """Take the lease.

        Raises RobotFaultError that says who holds the robot, or why it gives none.
        """
        answer = self._ask_for_it()
        self.lease_id, self.sequence = bytes.fromhex(answer["lease"]), int(answer["sequence"])
        self._duration_s = float(answer["duration_s"])
        self._keeper = threading.Thread(target=self._keep, name="lease", daemon=True)
        self._keeper.start()

    def _ask_for_it(self) -> dict[str, Any]:
        """Return the robot's answer to a request for the lease; raises RobotFaultError for a refusal."""
        wanted = {"op": "acquire", "owner": owner_name()}
        deadline_s = time.monotonic() + ACQUIRE_TIMEOUT_S
        while True:
            answers = ask_until(self._session, self._key, wanted, timeout_s=ACQUIRE_TIMEOUT_S)
            if not answers:
                raise RobotFaultError(
                    "the robot gives no lease: it does not answer, or this end may not command it"
                )
            refusal = answers[0].get("error")
            if refusal is None:
                return answers[0]
            # An answer that got lost on the way gave the lease to us, who do not know it; it ends by itself.
            if owner_name() not in str(refusal) or time.monotonic() > deadline_s:
                raise RobotFaultError(str(refusal))
            time.sleep(0.2)

    def rest(self) -> None:
        """Tell the robot that no command is due until the next one."""
        self._tell("rest")

    def release(self) -> None:
        """Give the lease back, if it is still in force."""
        self._over.set()
        if self._keeper is not None:
            self._keeper.join()
            if self.lost is None:
                self._tell("release")

    def _keep(self) -> None:
        """Renew until released; a robot that does not answer for the lease's whole time has gone."""
        heard_s = time.monotonic()
        while not self._over.wait(self._duration_s / 3) and self.lost is None:
            answer = self._tell("renew")
            if answer is not None:
                heard_s = self.lost_at_s = time.monotonic()
                self.lost = answer.get("error")
            elif time.monotonic() - heard_s > self._duration_s:
                self.lost_at_s = time.monotonic()
                self.lost = f"the robot has not answered for {time.monotonic() - heard_s:.1f} s"

    def _tell(self, op: str) -> dict[str, Any] | None:
        content = {"op": op, "lease": self.lease_id.hex()}
        try:
            answers = ask(self._session, self._key, content, timeout_s=self._duration_s / 3)
        except zenoh.ZError:
            return None
        return answers[0] if answers else None


#: How long a robot may take to say who it is.
DESCRIBE_TIMEOUT_S = 3.0

#: How long the reason of a lost lease may take to come.
STOP_REASON_TIMEOUT_S = 0.3

#: Where in the robot's period this end's ticks fall: as far from its ticks as can be.
PHASE = 0.5

NO_LEASE = bytes(LEASE_ID_BYTES)

WHO = "the robot on the network"


class TickedClock(WallClock):
    """A wall clock that counts its ticks.

    Attributes:
        ticks: ticks so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.ticks = 0

    def tick(self) -> Tick:
        """Wait for the next grid point and count it."""
        tick = super().tick()
        self.ticks += 1
        return tick


class ZenohServos(LegServos):
    """The controller's end of a robot that `hexctl serve` puts on the network.

    Connecting compares both ends' robot descriptions and takes the robot's lease; closing gives it back. The
    clock is this end's wall clock. `read` returns the newest state that came before the tick.
    """

    def __init__(self, robot: Robot, *, link: Link, mailbox: Mailbox | None = None) -> None:
        self._robot, self._link = robot, link
        self._keys = link.keys(robot.name)
        self._clock = TickedClock()
        self._opened: ExitStack | None = None
        self._ear = Ear(self._keys, mailbox or Mailbox(), plain=link.plain)
        self._tenancy: LeaseClient | None = None
        self._sequence = 0
        self._snapshot: tuple[int, RobotState] | None = None

    @property
    def robot(self) -> Robot:
        """Return the robot that is expected at the other end."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """Return this end's clock."""
        return self._clock

    def connect(self) -> None:
        """Open the link, make sure that it is the same robot, take its lease and hear its first state.

        Raises InputError for a link that is not allowed, and RobotFaultError that says what to check for
        everything else.
        """
        if self._opened is not None:
            return
        with ExitStack() as opening:
            session = opening.enter_context(open_session(self._link, Role.CONTROLLER, self._keys))
            if not self._link.plain:
                self._check_robot(session)
            self._ear.listen(session)
            if not self._link.plain:
                self._tenancy = LeaseClient(session, self._keys.lease)
                self._tenancy.acquire()
                opening.callback(self._tenancy.release)
                self._ear.forget()  # a state from before may tell of a stop that the lease has lifted
            self._publisher = session.declare_publisher(
                self._keys.command,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )
            self._sequence = 0
            self._snapshot = None
            # This end's ticks fall into the middle of the robot's.
            self._clock.begin(self._ear.await_first_s() - self._clock.period_s * PHASE)
            self._opened = opening.pop_all()

    def read(self) -> RobotState:
        """Return the newest state; the same one until the next tick.

        Raises RobotFaultError when not connected, when the robot is silent, or when the lease is lost.
        """
        check_connected(self._opened is not None, WHO)
        if self._snapshot is None or self._snapshot[0] != self._clock.ticks:
            state = self._ear.newest(self._clock.now_s)
            self._check_ours(state)
            self._snapshot = (self._clock.ticks, state)
        return _copy(self._snapshot[1])

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets to the robot, whose guard has the last word."""
        check_connected(self._opened is not None, WHO)
        check_targets(targets)
        self._sequence += 1
        self._publisher.put(encode_positions(targets.positions_rad), attachment=self._tag())
        return targets

    def rest(self) -> None:
        """Tell the robot that no command is due until the next one."""
        if self._opened is not None and self._tenancy is not None:
            self._tenancy.rest()

    def close(self) -> None:
        """Give the lease back and close the link."""
        if self._opened is not None:
            opened, self._opened = self._opened, None
            opened.close()

    def _check_robot(self, session: zenoh.Session) -> None:
        """Refuse to talk to another robot than the one expected."""
        answers = ask_until(session, self._keys.describe, timeout_s=DESCRIBE_TIMEOUT_S)
        if not answers:
            raise RobotFaultError(
                f"no robot called {self._robot.name} answers at {self._link.endpoint}; "
                "is hexctl serve running there, with the same --robot?"
            )
        if len(answers) > 1:
            raise RobotFaultError(
                f"{len(answers)} robots called {self._robot.name} answer at {self._link.endpoint}; "
                "give them different names"
            )
        check_same_robot(answers[0], self._robot)
        status = answers[0].get("status", {})
        identity = RobotIdentity.of_answer(status)
        check_may_command(identity, self._link)
        self.identity = identity
        simulated = status.get("simulated")
        self.simulated = simulated if isinstance(simulated, dict) else None

    def _check_ours(self, state: RobotState) -> None:
        """Raise RobotFaultError when somebody else has the robot now, or nobody.

        A stop takes the lease away too, and says more: states that tell of it may still be on their way.
        """
        tenancy = self._tenancy
        if tenancy is None or tenancy.lost is None or state.stopped is not None:
            return
        if time.monotonic() - tenancy.lost_at_s > STOP_REASON_TIMEOUT_S:
            raise RobotFaultError(f"the robot is no longer ours: {tenancy.lost}")

    def _tag(self) -> bytes:
        """Return what travels beside the next command."""
        tenancy = self._tenancy
        return CommandTag(
            sequence=self._sequence,
            stamp_ns=time.monotonic_ns(),
            time_to_live_ms=round(1000 * TIME_TO_LIVE_S),
            lease_id=NO_LEASE if tenancy is None else tenancy.lease_id,
            lease_sequence=0 if tenancy is None else tenancy.sequence,
        ).packed()


def _copy(state: RobotState) -> RobotState:
    """Return a state whose arrays the caller may change."""
    position, quaternion = state.base_position_world, state.base_quaternion_world
    return replace(
        state,
        joint_positions_rad=state.joint_positions_rad.copy(),
        base_position_world=None if position is None else position.copy(),
        base_quaternion_world=None if quaternion is None else quaternion.copy(),
        foot_contacts=None if state.foot_contacts is None else state.foot_contacts.copy(),
    )
