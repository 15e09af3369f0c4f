"""Failures of a leg: `locked`, `limp`, `stuck`, `weak`, `missing`; and `unknown`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hexctl.errors import InputError, argument, check_type
from hexctl.typed_names import known_name, nearest
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS

if TYPE_CHECKING:
    from hexctl.robot.model import Robot

BROKEN_KINDS = ("locked", "limp", "stuck", "weak", "missing")

#: A leg that failed in a way that the controller is not told.
UNKNOWN = "unknown"

FAILURE_KINDS = (*BROKEN_KINDS, UNKNOWN)

#: What the command-line text of a failure looks like.
FAILURE_FORMS = "locked, limp[:JOINT], missing, weak:[JOINT:]FRACTION, stuck:JOINT:DEGREES, unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """The failure of one leg: what a simulation breaks, and what a controller is told.

    A `locked` leg holds its stance pose, on the floor. A `limp` one has no torque. A `stuck` one has one
    joint jammed. A `weak` one has part of its torque. A `missing` one has neither contacts nor mass. Of an
    `unknown` failure only the leg is known: a controller keeps that leg in its stance pose, whatever it does
    there, and a simulation draws what breaks (`drawn_failure`).

    Attributes:
        leg: number of the leg, 1..6.
        kind: one of `FAILURE_KINDS`.
        joint: `coxa`, `femur` or `tibia`, the joint that is stuck, or the only one that is limp or weak; None
            for the coxa of a stuck leg, for all three of others.
        angle_rad: the angle at which it is stuck; of no effect for other kinds.
        torque_fraction: part of the torque that a weak leg has, 0..1; of no effect for other kinds.

    Raises InputError for a value that is not allowed.
    """

    leg: int
    kind: str = "locked"
    joint: str | None = None
    angle_rad: float = 0.0
    torque_fraction: float = 0.3

    @property
    def joint_index(self) -> int:
        """Index of the stuck joint, or the only limp or weak one, in arrays of 18."""
        return JOINTS_PER_LEG * (self.leg - 1) + JOINT_KINDS.index(self.joint or JOINT_KINDS[0])

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the joints that failed, in arrays of 18."""
        first = JOINTS_PER_LEG * (self.leg - 1)
        return tuple(range(first, first + JOINTS_PER_LEG)) if self.joint is None else (self.joint_index,)

    def __post_init__(self) -> None:
        check_type(self.leg, int, "failed leg", f"a leg's number, 1..{N_LEGS}")
        check_type(self.kind, str, "failure", ", ".join(FAILURE_KINDS))
        check_type(self.joint, (str, type(None)), "failed joint", ", ".join(JOINT_KINDS))
        check_type(self.angle_rad, float, "stuck angle", "a finite angle in rad")
        check_type(self.torque_fraction, float, "weak torque fraction", "a number in 0..1")
        _require(1 <= self.leg <= N_LEGS, "failed leg", self.leg, "1..6")
        _require(self.kind in FAILURE_KINDS, "failure", self.kind, ", ".join(FAILURE_KINDS))
        _require(self.joint in (None, *JOINT_KINDS), "failed joint", self.joint, ", ".join(JOINT_KINDS))
        _require(math.isfinite(self.angle_rad), "stuck angle", self.angle_rad, "a finite angle")
        _require(0 <= self.torque_fraction <= 1, "weak torque fraction", self.torque_fraction, "0..1")
        # A joint that means nothing for a kind does not make another failure of it.
        joint = (self.joint or JOINT_KINDS[0]) if self.kind == "stuck" else self.joint
        object.__setattr__(self, "joint", joint if self.kind in ("stuck", "limp", "weak") else None)

    def __str__(self) -> str:
        only = "" if self.joint is None else f":{self.joint}"
        detail = {
            "stuck": f":{math.degrees(self.angle_rad):g}",
            "weak": f":{self.torque_fraction:g}",
        }
        return self.kind + only + detail.get(self.kind, "")


#: The failure of one leg, those of several, or None.
Failures = Failure | Sequence[Failure] | None

#: A robot walks with no more failed legs than this.
MOST_FAILED = 3


def failure_text(*failures: Failure | None) -> str:
    """Legs and failures as text, such as `leg 5 locked`; `none` where no leg failed."""
    return " and ".join(f"leg {one.leg} {one}" for one in failures if one is not None) or "none"


def untold_note(broken: Failures, told: Failures) -> str | None:
    """What an operator should know where a simulation breaks something else than its controller is told."""
    breaks, tells = each_failure(broken), each_failure(told)
    if breaks == tells:
        return None
    return f"the simulation breaks {failure_text(*breaks)}; the controller is told {failure_text(*tells)}"


def each_failure(failures: Failures) -> tuple[Failure, ...]:
    """The failure of one leg, those of several, or none, as a tuple, by leg."""
    if failures is None:
        return ()
    if isinstance(failures, Failure):
        return (failures,)
    return tuple(sorted(failures, key=lambda one: one.leg))


def check_further(failure: Failure | None, further: Sequence[Failure], what: str) -> None:
    """Raise InputError for failures of legs besides a first one that are not of other legs, 3 in all."""
    check_type(further, (tuple, list), what, "Failures, as (Failure(leg=5),)")
    for one in further:
        check_type(one, Failure, what, "Failures, as (Failure(leg=5),)")
    legs = [one.leg for one in (*each_failure(failure), *further)]
    _require(not further or failure is not None, what, "some without a first", "with the failure of a leg")
    _require(len(set(legs)) == len(legs), what, f"legs {_and(legs)}", "each leg once")
    _require(len(legs) <= MOST_FAILED, what, f"{len(legs)} legs", f"up to {MOST_FAILED}, others must walk")


def _and(values: Sequence[object]) -> str:
    return ", ".join(map(str, values))


def failure_of(failed_leg: int | None, failure: str | None) -> Failure | None:
    """Failure of a leg's number and words, as options and keywords have them; None where no leg failed.

    Words are those of `parse_failure`; without any the leg is locked. Raises InputError for words without a
    leg, and for what is not allowed.
    """
    if failed_leg is not None:
        return parse_failure(failed_leg, failure or "locked")
    if failure is None:
        return None
    raise InputError(
        f"{argument('failure')}: got {failure} without a leg; allowed: with {argument('failed_leg')} 1..6"
    )


def failures_of(failed_legs: Sequence[int], failure: str | None) -> tuple[Failure, ...]:
    """Failures of legs' numbers and words, in the order of the legs.

    Words are those of `parse_failure`, once for all legs, or with commas for each: `locked,limp`. Raises
    InputError for what is not allowed.
    """
    words = [part.strip() for part in (failure or "locked").split(",")]
    if len(words) == 1:
        words *= len(failed_legs)
    if len(words) != len(failed_legs):
        raise InputError(
            f"{argument('failure')}: got {failure} with legs {_and(failed_legs)}; allowed: one for all, or "
            "one for each"
        )
    found = [parse_failure(leg, text) for leg, text in zip(failed_legs, words, strict=True)]
    check_further(found[0] if found else None, found[1:], argument("failed_leg"))
    return each_failure(found)


def parse_failure(leg: int, text: str) -> Failure:
    """Failure of a leg from its command-line text.

    `locked`, `limp[:JOINT]`, `missing`, `weak[:JOINT][:FRACTION]`, `stuck[:JOINT[:DEGREES]]`, for example
    `stuck:femur:30`, or `unknown`.
    Raises InputError for anything else.
    """
    check_type(text, str, "failure", FAILURE_FORMS)
    kind, *details = (_known(part) for part in text.split(":"))
    most, what = {"stuck": 2, "weak": 2, "limp": 1}.get(kind, 0), argument("failure")
    near = "" if kind in FAILURE_KINDS else nearest(kind, FAILURE_KINDS)
    _require(kind in FAILURE_KINDS and len(details) <= most, what, text, FAILURE_FORMS + near)
    joint = details.pop(0) if details and (kind != "weak" or details[0] in JOINT_KINDS) else None
    if kind == "weak" and details:
        fraction = _number(details.pop(), text)
        allowed = "weak:FRACTION or weak:JOINT:FRACTION, the part of its torque, 0..1"
        _require(not details and 0 <= fraction <= 1, what, text, allowed)
        return Failure(leg=leg, kind=kind, joint=joint, torque_fraction=fraction)
    allowed = f"{kind}:JOINT with {', '.join(JOINT_KINDS)}"
    if kind == "stuck":
        degrees = _number(details[0], text) if details else 0.0
        allowed = f"stuck:JOINT:DEGREES with {', '.join(JOINT_KINDS)} and a finite angle"
        _require(joint in (None, *JOINT_KINDS) and math.isfinite(degrees), what, text, allowed)
        return Failure(leg=leg, kind=kind, joint=joint, angle_rad=math.radians(degrees))
    _require(joint in (None, *JOINT_KINDS), what, text, allowed)
    return Failure(leg=leg, kind=kind, joint=joint)


def _known(part: str) -> str:
    """A kind or a joint in any case and spelling as it is called here, anything else as it is."""
    return known_name(part, (*FAILURE_KINDS, *JOINT_KINDS)) or part


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        allowed = f"a number in place of {text!r}"
        raise InputError(f"{argument('failure')}: got {whole!r}; allowed: {allowed}") from None


def _require(holds: bool, what: str, got: object, allowed: str) -> None:
    if not holds:
        raise InputError(f"{what}: got {got}; allowed: {allowed}")


#: Standard deviation of the angle at which a joint of an unknown failure jams, about its angle in the stance.
JAM_SPREAD_RAD = math.radians(20.0)

#: Share of the torque that a weak leg of an unknown failure has.
WEAK_SHARES = (0.05, 0.6)


def drawn_failure(robot: "Robot", failure: Failure | None, seed: int) -> Failure | None:
    """The failure that a simulation with a seed applies: the one given, or one drawn where it is `unknown`.

    Every kind is as likely as any other. A jammed joint is any of the three, near its angle in the stance.
    """
    if failure is None or failure.kind != UNKNOWN:
        return failure
    # A stream of its own beside those of bumps, joint offsets, noise and lost commands.
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
