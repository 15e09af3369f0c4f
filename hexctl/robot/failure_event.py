"""Failures that come and go while a robot walks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from hexctl.errors import InputError, check_type
from hexctl.robot.failure import FAILURE_FORMS, UNKNOWN, Failure, parse_failure
from hexctl.types import N_LEGS

#: What the command-line text of a failure to come looks like.
EVENT_FORMS = "LEG:FAILURE@SECONDS, such as 5:locked@8"

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
        check_type(self.at_s, float, "failure event: time")
        check_type(self.leg, int, "failure event: leg", f"a leg's number, 1..{N_LEGS}")
        check_type(self.failure, (Failure, type(None)), "failure event", "a Failure, or None to heal")
        if not (math.isfinite(self.at_s) and self.at_s >= 0):
            raise InputError(f"failure event: got {self.at_s:g} s; allowed: 0 or more")
        if not 1 <= self.leg <= N_LEGS:
            raise InputError(f"failure event: got leg {self.leg}; allowed: 1..{N_LEGS}")
        if self.failure is not None and self.failure.leg != self.leg:
            raise InputError(f"failure event: got leg {self.leg} with a failure of {self.failure.leg}")
        if self.failure is not None and self.failure.kind == UNKNOWN:
            raise InputError(f"failure event: got {UNKNOWN}; allowed: what breaks, as in 5:limp@8")

    def __str__(self) -> str:
        if self.failure is None:
            return f"{self.leg}@{self.at_s:.12g}"
        kind = f"stuck:{self.failure.joint}" if self.failure.kind == "stuck" else str(self.failure)
        return f"{self.leg}:{kind}@{self.at_s:.12g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoticedFailure:
    """A failure that a controller noticed by itself, and what it did about it.

    Attributes:
        at_s: seconds since the walk began.
        failure: leg, kind and joint, as it believes.
        evidence: what it was noticed by: `following` (targets that joints do not follow), `support` (load
            that a leg does not carry) or `effort` (torque that a joint does not give).
        did: what it did, in few words.
        healed: whether it noticed that the leg is whole again, or put down one that was missing to try it.
    """

    at_s: float
    failure: Failure
    evidence: str
    did: str
    healed: bool = False

    def __str__(self) -> str:
        again = "put down again, on trial," if self.failure.kind == "missing" else "whole again"
        what = again if self.healed else in_words(self.failure)
        return f"leg {self.failure.leg} {what} at {self.at_s:.2f} s, {self.did}"

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
            healed=bool(data.get("healed", False)),
        )


def in_words(failure: Failure) -> str:
    """Kind and joint of a failure, without its numbers: `locked`, `femur stuck`."""
    return failure.kind if failure.joint is None else f"{failure.joint} {failure.kind}"


def parse_failure_event(text: str) -> FailureEvent:
    """Event of a text such as `5:locked@8`: leg, failure as `parse_failure` has it, seconds.

    Raises InputError for anything else, and for an angle of a stuck joint.
    """
    leg, colon, rest = text.partition(":")
    kind, at, time_text = rest.rpartition("@")
    if not (colon and at and leg.strip().isdecimal()):
        raise InputError(f"failure event: got {text!r}; allowed: {EVENT_FORMS}, with {FAILURE_FORMS}")
    if kind.startswith("stuck") and kind.count(":") > 1:
        raise InputError(f"failure event: got {text!r}; allowed: stuck:JOINT, it sticks where it is")
    return FailureEvent(at_s=_seconds(time_text, text), leg=int(leg), failure=parse_failure(int(leg), kind))


def parse_healing(text: str) -> FailureEvent:
    """Event of a text such as `5@20`: which leg heals, and when.

    Raises InputError for anything else.
    """
    leg, at, time_text = text.partition("@")
    if not (at and leg.strip().isdecimal()):
        raise InputError(f"healing: got {text!r}; allowed: {HEALING_FORMS}")
    return FailureEvent(at_s=_seconds(time_text, text), leg=int(leg))


def _seconds(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"failure event: got {whole!r}; allowed: seconds in place of {text!r}") from None
