"""Failures that come and go while a robot walks."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from hexctl.errors import InputError, argument, check_type
from hexctl.robot.failure import UNKNOWN, Failure, parse_failure
from hexctl.types import JOINT_KINDS, N_LEGS

#: What the command-line text of a failure to come looks like.
EVENT_FORMS = "LEG:FAILURE@SECONDS, such as 5:locked@8"

#: What the command-line text of a failure that comes now looks like.
NOW_FORMS = "LEG:FAILURE, such as 5:limp"

#: Failures that may come during a walk: a joint sticks where it is, and what breaks is known.
COMING_FORMS = (
    f"locked, limp[:JOINT], missing, weak:[JOINT:]FRACTION, stuck:JOINT; JOINT: {', '.join(JOINT_KINDS)}; "
    "FRACTION: 0..1"
)

#: What the command-line text of a leg that heals looks like.
HEALING_FORMS = "LEG@SECONDS, such as 5@20"


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureEvent:
    """A moment of a walk at which a leg fails, or is whole again: what the world does, told to no controller.

    A joint that sticks then does so where it is, and a leg that locks keeps the targets that it was sent
    last; the angle of the failure is of no effect.

    Attributes:
        at_s: seconds since the walk began.
        leg: number of the leg, 1..6.
        failure: how it fails; None where it heals.

    Raises InputError for a time below 0 or an `unknown` failure.
    """

    at_s: float
    leg: int
    failure: Failure | None = None

    def __post_init__(self) -> None:
        what = "healing" if self.failure is None else "failure event"
        check_type(self.at_s, float, f"{what}: time")
        check_type(self.leg, int, f"{what}: leg", f"a leg's number, 1..{N_LEGS}")
        check_type(self.failure, (Failure, type(None)), what, "a Failure, or None to heal")
        if not (math.isfinite(self.at_s) and self.at_s >= 0):
            raise InputError(f"{what}: got {self.at_s:g} s; allowed: 0 or more")
        if not 1 <= self.leg <= N_LEGS:
            raise InputError(f"{what}: got leg {self.leg}; allowed: 1..{N_LEGS}")
        if self.failure is not None and self.failure.leg != self.leg:
            raise InputError(f"failure event: got leg {self.leg} with a failure of {self.failure.leg}")
        if self.failure is not None and self.failure.kind == UNKNOWN:
            raise InputError(f"failure event: got {UNKNOWN}; allowed: what breaks, as in 5:limp@8")

    def __str__(self) -> str:
        if self.failure is None:
            return f"{self.leg}@{self.at_s:.12g}"
        kind = f"stuck:{self.failure.joint}" if self.failure.kind == "stuck" else str(self.failure)
        return f"{self.leg}:{kind}@{self.at_s:.12g}"


#: Kinds of a noticed failure whose leg only putting it down can tell to be whole again.
ON_TRIAL = ("missing", UNKNOWN)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoticedFailure:
    """A failure that a controller noticed by itself, and what it did about it.

    Attributes:
        at_s: seconds since the walk began.
        failure: leg, kind and joint, as it believes.
        evidence: what it was noticed by: `following` (targets that joints do not follow), `support` (load
            that a leg does not carry), `effort` (torque that a joint does not give), `balance` (how the
            body leans and which feet touch) or `silence` (a servo that does not answer).
        did: what it did, in few words.
        healed: whether it noticed that the leg is whole again, or put down one that was missing to try it.
    """

    at_s: float
    failure: Failure
    evidence: str
    did: str
    healed: bool = False

    def __str__(self) -> str:
        comma = "," if self.healed and self.failure.kind in ON_TRIAL else ""
        return f"{self.in_words}{comma} at {self.at_s:.2f} s, {self.did}"

    @property
    def in_words(self) -> str:
        """Leg, and how it fails or that it is whole again: `leg 5 limp`."""
        again = "put down again, on trial" if self.failure.kind in ON_TRIAL else "whole again"
        return f"leg {self.failure.leg} {again if self.healed else in_words(self.failure)}"

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "at_s": round(self.at_s, 6),
            "leg": self.failure.leg,
            "kind": self.failure.kind,
            "joint": self.failure.joint,
            "evidence": self.evidence,
            "did": self.did,
            "healed": self.healed,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`; the angle of a stuck joint is not kept."""
        failure = Failure(leg=int(data["leg"]), kind=str(data["kind"]), joint=data["joint"])
        return cls(
            at_s=float(data["at_s"]),
            failure=failure,
            evidence=str(data["evidence"]),
            did=str(data["did"]),
            healed=bool(data["healed"]),
        )


def in_words(failure: Failure) -> str:
    """Kind and joint of a failure, without its numbers: `locked`, `femur stuck`."""
    return failure.kind if failure.joint is None else f"{failure.joint} {failure.kind}"


def in_words_with_share(failure: Failure) -> str:
    """Kind and joint of a failure, and the torque that a weak leg or joint has left."""
    share = f" ({failure.torque_fraction:g} of its torque)" if failure.kind == "weak" else ""
    return in_words(failure) + share


def parse_failure_event(text: str) -> FailureEvent:
    """Event of a text such as `5:locked@8`: leg, failure as `parse_failure` has it, seconds.

    Raises InputError for anything else, and for an angle of a stuck joint.
    """
    leg, colon, rest = text.partition(":")
    kind, at, time_text = rest.rpartition("@")
    if not (colon and at and _is_number(leg)):
        raise InputError(f"failure event: got {text!r}; allowed: {EVENT_FORMS}, with {COMING_FORMS}")
    failure = _coming(int(leg), kind, f"failure event: got {text!r}; allowed: ")
    at_s = _seconds(time_text, f"failure event: got {text!r}")
    return FailureEvent(at_s=at_s, leg=failure.leg, failure=failure)


def parse_failure_now(text: str) -> Failure:
    """Failure of a text such as `5:limp`, which comes now: leg, and failure as `parse_failure` has it.

    Raises InputError for anything else, for an angle of a stuck joint, and for an `unknown` failure.
    """
    leg, colon, kind = text.partition(":")
    if not (colon and _is_number(leg)) or "@" in kind:
        raise InputError(f"failure of a leg: got {text!r}; allowed: {NOW_FORMS}, with {COMING_FORMS}")
    return _coming(int(leg), kind, f"failure of a leg: got {text!r}; allowed: ")


def _is_number(leg: str) -> bool:
    """Whether a text is a whole number of few digits, which `int` reads."""
    return leg.strip(" ").isdecimal() and len(leg) < 10


def parse_coming_failure(leg: int, kind: str) -> Failure:
    """Failure of a leg, 1..6, that comes while a robot walks, in words as `parse_failure` has them.

    Raises InputError for anything else, for an angle of a stuck joint, and for an `unknown` failure.
    """
    return _coming(leg, kind, f"failure: got {kind}; allowed: ")


def _coming(leg: int, kind: str, refused: str) -> Failure:
    """Failure that comes while a robot walks; `refused` begins the message for one that cannot."""
    Failure(leg=leg)  # refuses a leg that no robot has
    if kind.startswith("stuck") and kind.count(":") > 1:
        raise InputError(f"{refused}stuck:JOINT, it sticks where it is")
    if kind == "stuck":
        joints = ", ".join(JOINT_KINDS)
        raise InputError(f"{refused}stuck:JOINT with {joints}; a whole leg that keeps its pose is locked")
    try:
        failure = parse_failure(leg, kind)
    except InputError as error:
        raise InputError(refused + COMING_FORMS) from error
    if failure.kind == UNKNOWN:
        raise InputError(refused + COMING_FORMS)
    return failure


def parse_healing(text: str) -> FailureEvent:
    """Event of a text such as `5@20`: which leg heals, and when.

    Raises InputError for anything else.
    """
    leg, at, time_text = text.partition("@")
    if not (at and _is_number(leg)):
        raise InputError(f"healing: got {text!r}; allowed: {HEALING_FORMS}")
    return FailureEvent(at_s=_seconds(time_text, f"healing: got {text!r}"), leg=int(leg))


def check_healings(
    events: Sequence[FailureEvent], before: Sequence[FailureEvent] = (), failed_legs: Collection[int] = ()
) -> None:
    """Raise InputError for a leg that heals while it is whole.

    Args:
        events: that are checked.
        before: further events of the same walk, those of the world.
        failed_legs: legs that have failed before the walk.
    """
    failed = set(failed_legs)
    for event in sorted((*before, *events), key=lambda one: one.at_s):
        if event.failure is not None:
            failed.add(event.leg)
        elif event.leg in failed:
            failed.remove(event.leg)
        elif event in events:
            raise InputError(
                f"healing: got {event}, when leg {event.leg} is whole; allowed: after its failure, as "
                f"{argument('fail')} {event.leg}:limp@SECONDS says one"
            )


def _seconds(text: str, refused: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{refused}; allowed: seconds in place of {text!r}") from None
