"""Failures of a leg: before a walk, during it, and as a controller detects them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np

from hexctl.errors import InputError, argument, check_type
from hexctl.options import Range, check_fields
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS

if TYPE_CHECKING:
    from hexctl.robot.model import Robot

BROKEN_KINDS = ("locked", "limp", "stuck", "weak", "missing")

#: A failure of which the controller knows only the leg.
UNKNOWN = "unknown"

FAILURE_KINDS = (*BROKEN_KINDS, UNKNOWN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """The failure of one leg, in a simulation or as known to a controller.

    A `locked` leg holds its stance pose, on the floor. A `limp` one has no torque. A `stuck` one has one
    joint jammed. A `weak` one has part of its torque. A `missing` one has neither contacts nor mass. A leg
    with an `unknown` failure is kept in its stance pose, and a simulation draws what breaks
    (`drawn_failure`).

    Attributes:
        leg: 1..6.
        kind: one of `FAILURE_KINDS`.
        joint: the stuck joint, or the only limp or weak one, of `coxa`, `femur` and `tibia`; None for the
            coxa of a stuck leg, for all three of others.
        angle_rad: of a stuck joint.
        torque_fraction: remaining share of the torque of a weak leg, 0..1.

    Raises InputError for an invalid value.
    """

    leg: Annotated[int, Range(low=1, high=N_LEGS, whole=True)]
    kind: str = "locked"
    joint: str | None = None
    angle_rad: Annotated[float, Range()] = 0.0
    torque_fraction: Annotated[float, Range(low=0, high=1)] = 0.3

    @property
    def joint_index(self) -> int:
        """Index of the stuck joint, or the only limp or weak one, in arrays of 18."""
        return JOINTS_PER_LEG * (self.leg - 1) + JOINT_KINDS.index(self.joint or JOINT_KINDS[0])

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the failed joints, in arrays of 18."""
        first = JOINTS_PER_LEG * (self.leg - 1)
        return tuple(range(first, first + JOINTS_PER_LEG)) if self.joint is None else (self.joint_index,)

    def __post_init__(self) -> None:
        kinds, joints = ", ".join(FAILURE_KINDS), ", ".join(JOINT_KINDS)
        check_type(self.kind, str, "failure", kinds)
        check_type(self.joint, (str, type(None)), "failed joint", joints)
        check_fields(self)
        _require(self.kind in FAILURE_KINDS, "failure", self.kind, kinds)
        _require(self.joint in (None, *JOINT_KINDS), "failed joint", self.joint, joints)
        # A joint that a kind does not use does not make it another failure.
        joint = (self.joint or JOINT_KINDS[0]) if self.kind == "stuck" else self.joint
        object.__setattr__(self, "joint", joint if self.kind in ("stuck", "limp", "weak") else None)

    @property
    def typed(self) -> str:
        """Leg and failure as typed in an option: `5:limp`."""
        return f"{self.leg}:{self}"

    def __str__(self) -> str:
        only = "" if self.joint is None else f":{self.joint}"
        detail = {
            "stuck": f":{math.degrees(self.angle_rad):g}",
            "weak": f":{self.torque_fraction:g}",
        }
        return self.kind + only + detail.get(self.kind, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class FailureEvent:
    """A moment of a walk at which a leg of the world fails or heals; no controller knows it.

    A joint jams where it is: the angle of the failure is ignored. A leg that locks keeps its last targets.

    Attributes:
        at_s: seconds since the walk began.
        leg: 1..6.
        failure: None if it heals.

    Raises InputError for a time below 0 or an `unknown` failure.
    """

    at_s: Annotated[float, Range(low=0, unit="s")]
    leg: Annotated[int, Range(low=1, high=N_LEGS, whole=True)]
    failure: Failure | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.failure is None:
            return
        what = argument("failure")
        if self.failure.leg != self.leg:
            raise InputError(f"{what}: got leg {self.leg} with a failure of {self.failure.leg}")
        if self.failure.kind == UNKNOWN:
            raise InputError(f"{what}: got {UNKNOWN}; allowed: what breaks, as in 5:limp@8")

    def __str__(self) -> str:
        if self.failure is None:
            return f"{self.leg}@{self.at_s:.12g}"
        kind = f"stuck:{self.failure.joint}" if self.failure.kind == "stuck" else str(self.failure)
        return f"{self.leg}:{kind}@{self.at_s:.12g}"


#: Kinds of failures of legs that must be put down to show that they are intact.
ON_TRIAL = ("missing", UNKNOWN)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoticedFailure:
    """A failure that a controller detected, and its response.

    Attributes:
        at_s: seconds since the walk began.
        failure: leg, kind and joint, as it assumes.
        evidence: `following` (joints do not follow targets), `support` (missing load), `effort` (missing
            torque), `balance` (lean and contacts), `start` (dead before the first step), `silence` (a servo
            that does not answer) or `stiffness` (a weak joint, whose leg is used as before).
        did: the response, in few words.
        healed: whether the leg was found intact, or a missing one was put down for a trial.
        torque_error: standard deviation of the torque fraction of a weak joint; None for other kinds.
    """

    at_s: float
    failure: Failure
    evidence: str
    did: str
    healed: bool = False
    torque_error: float | None = None

    def __str__(self) -> str:
        comma = "," if self.healed and self.failure.kind in ON_TRIAL else ""
        return f"{self.in_words}{comma} at {self.at_s:.2f} s, {self.did}"

    @property
    def in_words(self) -> str:
        """Leg, and how it failed or that it is intact again: `leg 5 limp`."""
        how = in_words_with_share(self.failure, self.torque_error)
        if self.healed:
            how = "put down again, on trial" if self.failure.kind in ON_TRIAL else "whole again"
        return f"leg {self.failure.leg} {how}"

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "at_s": round(self.at_s, 6),
            "leg": self.failure.leg,
            "kind": self.failure.kind,
            "joint": self.failure.joint,
            "torque_fraction": round(self.failure.torque_fraction, 3)
            if self.failure.kind == "weak"
            else None,
            "torque_error": None if self.torque_error is None else round(self.torque_error, 3),
            "evidence": self.evidence,
            "did": self.did,
            "healed": self.healed,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`; the angle of a stuck joint is not kept."""
        weak = {} if data["torque_fraction"] is None else {"torque_fraction": float(data["torque_fraction"])}
        failure = Failure(leg=int(data["leg"]), kind=str(data["kind"]), joint=data["joint"], **weak)
        return cls(
            at_s=float(data["at_s"]),
            failure=failure,
            evidence=str(data["evidence"]),
            did=str(data["did"]),
            healed=bool(data["healed"]),
            torque_error=data["torque_error"],
        )


def in_words(failure: Failure) -> str:
    """Kind and joint of a failure, without its numbers: `locked`, `femur stuck`."""
    return failure.kind if failure.joint is None else f"{failure.joint} {failure.kind}"


def in_words_with_share(failure: Failure, error: float | None = None) -> str:
    """Kind and joint of a failure, and the remaining torque of a weak leg or joint, with its error."""
    if failure.kind != "weak":
        return in_words(failure)
    share = (
        f"{failure.torque_fraction:g}" if error is None else f"{failure.torque_fraction:.2f} ± {error:.2f}"
    )
    return f"{in_words(failure)} ({share} of its torque)"


#: The failure of one leg, those of several, or None.
Failures = Failure | Sequence[Failure] | None

#: Maximum number of failed legs of a walk.
MOST_FAILED = 3


def failure_text(*failures: Failure | None) -> str:
    """Legs and failures as text, such as `leg 5 locked`; `none` without a failure."""
    return " and ".join(f"leg {one.leg} {one}" for one in failures if one is not None) or "none"


def difference_note(broken: Failures, assumed: Failures) -> str | None:
    """Note for the operator if the simulation breaks something else than the controller knows, or None."""
    breaks, tells = each_failure(broken), each_failure(assumed)
    if breaks == tells:
        return None
    return f"simulated failure: {failure_text(*breaks)}; the controller assumes {failure_text(*tells)}"


def each_failure(failures: Failures) -> tuple[Failure, ...]:
    """One failure, several or none as a tuple, by leg."""
    if failures is None:
        return ()
    if isinstance(failures, Failure):
        return (failures,)
    return tuple(sorted(failures, key=lambda one: one.leg))


def checked_failures(failures: Failures, what: str) -> tuple[Failure, ...]:
    """One failure, several or none, by leg; raises InputError for a leg twice, or more than 3 legs."""
    allowed = "a Failure, as Failure(leg=5), several, or None"
    check_type(failures, (Failure, tuple, list, type(None)), what, allowed)
    for one in () if failures is None or isinstance(failures, Failure) else failures:
        check_type(one, Failure, what, allowed)
    by_leg = each_failure(failures)
    legs = [one.leg for one in by_leg]
    _require(len(set(legs)) == len(legs), what, f"legs {', '.join(map(str, legs))}", "each leg once")
    _require(len(legs) <= MOST_FAILED, what, f"{len(legs)} legs", f"up to {MOST_FAILED}, others must walk")
    return by_leg


def failures_json(failures: Sequence[Failure]) -> dict[str, Any]:
    """JSON values: the first failed leg and its failure, and those of further legs by number."""
    first = next(iter(failures), None)
    return {
        "failed_leg": first and first.leg,
        "failure": first and str(first),
        "further_failures": {str(one.leg): str(one) for one in failures[1:]},
    }


def check_events(
    events: Sequence[FailureEvent], before: Sequence[FailureEvent] = (), failed: Sequence[Failure] = ()
) -> None:
    """Raise InputError for events, after those before, that change nothing.

    A leg heals while it is intact, or fails as it has already failed.
    """
    broken = {one.leg: one for one in failed}
    for event in sorted((*before, *events), key=lambda one: one.at_s):
        if event.failure is not None:
            if event in events and broken.get(event.leg) == event.failure:
                raise InputError(
                    f"{argument('failure')}: got {event}, when leg {event.leg} is {event.failure} already; "
                    f"allowed: another leg, another failure, or {argument('heal')} {event.leg}@SECONDS before"
                )
            broken[event.leg] = event.failure
        elif event.leg in broken:
            del broken[event.leg]
        elif event in events:
            raise InputError(
                f"{argument('heal')}: got {event}, when leg {event.leg} is whole; allowed: after it failed, "
                f"such as {argument('failure')} {event.leg}:limp@SECONDS"
            )


def _require(valid: bool, what: str, got: object, allowed: str) -> None:
    if not valid:
        raise InputError(f"{what}: got {got}; allowed: {allowed}")


#: Standard deviation of the angle of a jammed joint of an unknown failure, about its stance angle.
JAM_SPREAD_RAD = math.radians(20.0)


def loses_leg(kind: str) -> bool:
    """Whether a leg with a failure of a kind does not carry; a weak one is used as before."""
    return kind != "weak"


#: Range of the remaining torque of a weak leg of an unknown failure.
WEAK_SHARES = (0.05, 0.6)


def drawn_failure(robot: "Robot", failure: Failure, seed: int) -> Failure:
    """The failure that a simulation applies: the one given, or a random one if it is `unknown`."""
    if failure.kind != UNKNOWN:
        return failure
    # A separate stream from those of bumps, joint offsets, noise and lost commands.
    rng = np.random.default_rng([seed, 4, failure.leg])
    kind, joint = str(rng.choice(BROKEN_KINDS)), str(rng.choice(JOINT_KINDS))
    share = float(rng.uniform(*WEAK_SHARES))
    drawn = Failure(
        leg=failure.leg, kind=kind, joint=joint if kind == "stuck" else None, torque_fraction=share
    )
    index = JOINTS_PER_LEG * (drawn.leg - 1) + JOINT_KINDS.index(joint)
    angle_rad = robot.stance_angles_rad[index] + JAM_SPREAD_RAD * rng.standard_normal()
    within_rad = np.clip(angle_rad, robot.joint_lower_rad[index], robot.joint_upper_rad[index])
    return replace(drawn, angle_rad=float(within_rad))
