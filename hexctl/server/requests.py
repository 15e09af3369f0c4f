"""Requests to a robot: for its lease, for a stop, and for a failure of a simulation."""

from collections import deque
from contextlib import suppress
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, StrictInt, ValidationError

from hexctl.backends.base import simulation_of
from hexctl.control.guard import Guard
from hexctl.control.stop_reason import reason_in_words
from hexctl.errors import HexctlError, MessageError, RobotFaultError, shown
from hexctl.robot.configs import first_problem
from hexctl.robot.failure import in_words_with_share
from hexctl.robot.failure_grammar import parse_failure_now, parse_leg
from hexctl.server.leases import LEASE_S, Lease, LeaseManager, LeaseRefusedError
from hexctl.server.served_servos import call_servos
from hexctl.server.stops.latch import StopLatch
from hexctl.types import N_LEGS
from hexctl.wire.description import decode_json
from hexctl.wire.links import CLEAR_COMMAND
from hexctl.wire.stop import (
    LIFTED_BY_LEASE,
    MAX_BY,
    MOST_CLAIMS,
    OVER_ROS,
    UNNAMED,
    Stop,
    claim_of,
    new_clear_key,
)

#: Maximum length of a failure's text.
MAX_FAILURE_TEXT = 60

#: Most legs of a simulation that may change in a second: each change takes part of a control period.
MOST_CHANGES = 10
CHANGES_S = 1.0

#: Maximum length of the name of a stop request and of a stop id.
MAX_NAME = 64


def _displayable(owner: Any) -> str:
    """Names that cannot be displayed are replaced."""
    named = isinstance(owner, str) and owner.strip() and owner.isprintable()
    return str(owner)[:MAX_BY] if named else UNNAMED


def _printable(owner: str) -> str:
    if not owner.isprintable():
        raise ValueError(f"got {shown(owner)}; allowed: printable text")
    return owner


def _lease_id(text: Any) -> bytes:
    try:
        return bytes.fromhex(text)
    except (TypeError, ValueError):
        raise ValueError("got no hexadecimal digits; allowed: the granted lease") from None


def _leg(leg: Any) -> str:
    """A leg is a number or its text."""
    if type(leg) is not int and not (isinstance(leg, str) and len(leg) <= MAX_FAILURE_TEXT):
        raise ValueError(f"got {shown(leg)}; allowed: 1..{N_LEGS}")
    return str(leg)


Name = Annotated[str, Field(max_length=MAX_NAME)]


class StopRequest(BaseModel):
    """Content of a message at `estop`.

    Attributes:
        request: the client's name for its stop.
        id: that of the stop to clear.
        owner: the client's name for itself; an invalid one does not invalidate the request.
    """

    op: Literal["stop", "clear"]
    request: Name | None = None
    id: Name | None = None
    owner: Annotated[str, BeforeValidator(_displayable)] = UNNAMED
    keys: Annotated[tuple[Name, ...], Field(max_length=MOST_CLAIMS)] = ()


class LeaseRequest(BaseModel):
    """Content of a message at `lease`; `after` is the number of the last command before a rest."""

    op: Literal["acquire", "renew", "rest", "release"]
    owner: Annotated[str, AfterValidator(_printable)] = UNNAMED
    lease: Annotated[bytes, BeforeValidator(_lease_id)] = b""
    after: Annotated[StrictInt, Field(ge=0, lt=2**64)] = 0


class FailureRequest(BaseModel):
    """Content of a message at `failure`."""

    op: Literal["fail", "heal"]
    failure: Annotated[str, Field(max_length=MAX_FAILURE_TEXT)] = ""
    leg: Annotated[str, BeforeValidator(_leg)] = ""


RequestT = TypeVar("RequestT", bound=BaseModel)


def _read(kind: type[RequestT], payload: bytes) -> RequestT:
    """Decode a request; raises MessageError if it is malformed."""
    try:
        return kind.model_validate(decode_json(payload))
    except ValidationError as error:
        raise MessageError(first_problem(kind, error)) from error


def _read_stop(payload: bytes) -> StopRequest:
    """An empty payload is a stop."""
    return _read(StopRequest, payload) if payload else StopRequest(op="stop")


class RequestHandler:
    """Answers requests about the lease and the stop of one robot.

    Attributes:
        malformed: requests so far that could not be decoded.
        rested_after: number of the last command before the lease's holder rested, as it reported.
    """

    def __init__(self, guard: Guard, leases: LeaseManager, latch: StopLatch) -> None:
        self._guard, self.leases, self.latch = guard, leases, latch
        self.malformed = self.rested_after = 0
        self.ros_key = new_clear_key()
        self._changed_at_s: deque[float] = deque(maxlen=MOST_CHANGES)

    def stop_over_ros(self) -> None:
        """Stop the robot with a claim that ROS can prove. Thread-safe."""
        self.latch.stop(by=OVER_ROS, claim=claim_of(self.ros_key))

    def urgent(self, payload: bytes) -> None:
        """Stop the robot unless a payload at `estop` asks for a clear. Thread-safe.

        A malformed payload stops too: a client that writes there wants to stop.
        """
        try:
            wanted = _read_stop(payload)
        except MessageError:
            wanted = StopRequest(op="stop")
        if wanted.op == "stop":
            self.latch.stop(wanted.request, by=wanted.owner)

    def estop(self, payload: bytes, at_s: float) -> dict[str, Any]:
        """Answer to a request at `estop`, which `urgent` has seen: why the robot is stopped now.

        A stop and a clear end the lease. A refused clear changes nothing and is answered with `error`.
        """
        try:
            wanted = _read_stop(payload)
        except MessageError as error:
            self.leases.revoke()
            return {**_stop_facts(self.latch.ensure()), **self._misunderstood(error)}
        if wanted.op == "clear":
            return self.clear(wanted.id, at_s, by=wanted.owner, keys=wanted.keys)
        self.leases.revoke()
        return _stop_facts(self.latch.ensure(by=wanted.owner))

    def clear(
        self, stop_id: str | None, at_s: float, *, by: str = UNNAMED, keys: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """Clear a stop with keys; a fault that persists stops the robot again before the answer."""
        if self._guard.stopped is None:
            return {"stopped": None}
        refusal = self.latch.clear(stop_id, at_s, by=by, keys=keys)
        if refusal is not None:
            return {"stopped": self._guard.stopped, "error": refusal}
        self.leases.revoke()
        with suppress(RobotFaultError):  # a lost robot: the next control period reports it
            self._guard.read()
        return {"stopped": self._guard.stopped}

    def failure(self, payload: bytes, at_s: float) -> dict[str, Any]:
        """Answer to a request at `failure`: the failed legs of a simulation, or an error.

        A request is `{"op": "fail", "failure": "5:limp"}` or `{"op": "heal", "leg": 5}`. More than
        `MOST_CHANGES` in a second are refused. `at_s` is on any monotonic clock.
        """
        changed_at_s = self._changed_at_s
        if len(changed_at_s) == MOST_CHANGES and at_s - changed_at_s[0] < CHANGES_S:
            return {"error": f"failure: got more in a second; allowed: {MOST_CHANGES} legs that fail or heal"}
        try:
            wanted = _read(FailureRequest, payload)
        except MessageError as error:
            return self._misunderstood(error)
        heals = wanted.op == "heal"
        try:
            text = wanted.leg if heals else wanted.failure
            failure = None if heals else parse_failure_now(text)
            leg = parse_leg(text, "leg") if failure is None else failure.leg
            simulation = simulation_of(self._guard)
            whole = all(one.leg != leg for one in simulation.failures)
            call_servos(self._guard, "change_leg", lambda: simulation.change_leg(leg, failure))
            changed_at_s.append(at_s)
        except HexctlError as error:
            return {"error": str(error)}
        failures = simulation.failures
        note = {"note": f"leg {leg} was whole already"} if heals and whole else {}
        return {"failures": [f"leg {one.leg} {in_words_with_share(one)}" for one in failures], **note}

    def lease(self, payload: bytes, now_s: float) -> dict[str, Any]:
        """Answer to a request at `lease`: acquire, renew, rest or release."""
        try:
            wanted = _read(LeaseRequest, payload)
        except MessageError as error:
            return self._misunderstood(error)
        try:
            if wanted.op == "acquire":
                lease = self.acquire(wanted.owner, now_s)
                return {"lease": lease.lease_id.hex(), "sequence": lease.sequence, "duration_s": LEASE_S}
            answer = self._keep(wanted.op, wanted.lease, now_s)
        except HexctlError as error:
            return {"error": str(error)}
        if wanted.op == "rest":
            self.rested_after = wanted.after
        return answer

    def acquire(self, owner: str, now_s: float, duration_s: float = LEASE_S) -> Lease:
        """Grant a lease and lift a stop for silence; raises LeaseRefusedError if leased or stopped."""
        stopped = self._guard.stopped
        if stopped not in (None, LIFTED_BY_LEASE):
            self.leases.refused += 1
            why = reason_in_words(stopped)
            raise LeaseRefusedError(f"the robot is stopped: {why}; remove the cause, then {CLEAR_COMMAND}")
        lease = self.leases.acquire(owner, now_s, duration_s)
        if not self._guard.lift_silence():
            self.leases.revoke()
            raise LeaseRefusedError(f"the robot has just been stopped: {self._guard.stopped}")
        self._guard.pause_watchdog()
        self.rested_after = 0
        return lease

    def is_current(self, lease: Lease, now_s: float) -> bool:
        """Whether a lease is in force."""
        current = self.leases.current(now_s)
        return current is not None and current.lease_id == lease.lease_id

    def release(self, lease: Lease, now_s: float) -> None:
        """Give a lease back, if it is still in force; no command is expected until the next lease."""
        if self.is_current(lease, now_s):
            self.leases.release(lease.lease_id, now_s)
            self._guard.pause_watchdog()

    def _keep(self, wanted: str, lease_id: bytes, now_s: float) -> dict[str, Any]:
        if wanted == "release":
            self.leases.release(lease_id, now_s)
            if self._guard.in_motion:  # interrupted, as by a second Ctrl-C
                self._guard.stop(LIFTED_BY_LEASE)
            else:
                self._guard.pause_watchdog()
            return {"released": True}
        lease = self.leases.renew(lease_id, now_s)
        if wanted == "rest":
            self._guard.pause_watchdog()
        return {"sequence": lease.sequence}

    def _misunderstood(self, error: MessageError) -> dict[str, Any]:
        self.malformed += 1
        return {"error": str(error)}


def _stop_facts(stop: Stop) -> dict[str, Any]:
    return {"stopped": stop.reason, "stop_id": stop.stop_id}
