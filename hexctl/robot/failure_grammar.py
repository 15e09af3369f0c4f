"""Text of failures: `LEG:KIND[:DETAIL][@SECONDS]`, such as `5:limp`, `5:stuck:coxa:30` and `5:locked@8`.

With `@SECONDS` the leg fails during a walk, otherwise before. A leg without a kind, `5`, is locked.
`LEG@SECONDS` is a leg that heals.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from hexctl.errors import InputError, argument, check_type
from hexctl.robot.failure import (
    BROKEN_KINDS,
    FAILURE_KINDS,
    Failure,
    FailureEvent,
    checked_failures,
)
from hexctl.typed_names import known_name, nearest
from hexctl.types import JOINT_KINDS, N_LEGS

#: Forms of texts, for messages: a failure, one that happens now, kinds, kinds while moving, a healing.
FORMS = "LEG:KIND such as 5:limp, 5:stuck:coxa@8"

NOW_FORMS = "LEG:KIND such as 5:limp, 5:stuck:coxa"

KINDS = "locked, limp[:JOINT], missing, weak[:JOINT][:FRACTION], stuck[:JOINT[:DEGREES]], unknown"

#: A joint jams where it is, and what breaks is known.
COMING_KINDS = "locked, limp[:JOINT], missing, weak[:JOINT][:FRACTION], stuck:JOINT"

HEALING_FORMS = "LEG@SECONDS such as 5@20"

#: In place of failed legs: a diagnosis finds them.
AUTO_LEG = "auto"

_LEGS = f"1..{N_LEGS}"
_JOINTS = ", ".join(JOINT_KINDS)

#: Failures as options and keywords take them: texts with or without commas, and values.
AskedFailures = str | Failure | FailureEvent | Sequence[str | Failure | FailureEvent] | None

#: Failed legs as options and keywords take them: a number, a text such as `2,5`, or numbers.
AskedLegs = int | str | Sequence[int] | None


class ReadFailures(NamedTuple):
    """Requested failures: before the walk, by leg, and events during it, in the order given."""

    failures: tuple[Failure, ...]
    events: tuple[FailureEvent, ...]


def read_failures(asked: AskedFailures, failed_legs: AskedLegs = None) -> ReadFailures:
    """Failures of texts and values, such as `5:limp,2:locked@8`, and locked legs; raises InputError."""
    values = tuple(_each_value(asked))
    failures = [value for value in values if isinstance(value, Failure)]
    kinds = {one.leg: one.kind for one in failures}
    for leg in read_legs(failed_legs):
        if kinds.get(leg, "locked") != "locked":
            raise InputError(
                f"{argument('failed_leg')}: got {leg}, a locked leg, which {argument('failure')} makes "
                f"{kinds[leg]}; allowed: one of the two for each leg"
            )
        failures += [] if leg in kinds else [Failure(leg=leg)]
    by_leg = checked_failures(failures, argument("failure" if kinds else "failed_leg"))
    return ReadFailures(by_leg, tuple(value for value in values if isinstance(value, FailureEvent)))


def _each_value(asked: AskedFailures) -> Iterable[Failure | FailureEvent]:
    what, allowed = argument("failure"), f"a Failure, text {FORMS}, or several"
    several = () if asked is None else (asked,) if isinstance(asked, str | Failure | FailureEvent) else asked
    check_type(several, (tuple, list), what, allowed)
    for one in several:
        check_type(one, (str, Failure, FailureEvent), what, allowed)
        if isinstance(one, FailureEvent) and one.failure is None:
            raise InputError(f"{what}: got '{one}', a leg that heals; allowed: {FORMS}")
        if not isinstance(one, str):
            yield one
            continue
        for text in one.split(","):
            yield parse_failure_event(text) if "@" in text else parse_failure(text)


def read_failures_before(asked: AskedFailures, failed_legs: AskedLegs, instead: str) -> tuple[Failure, ...]:
    """Failures before a walk; raises InputError for others, with `instead` as the allowed values."""
    failures, events = read_failures(asked, failed_legs)
    if events:
        raise InputError(f"{argument('failure')}: got '{events[0]}'; allowed: {instead}")
    return failures


def option_of(failure: Failure) -> tuple[str, str]:
    """Option that asks for a failure, and its value: `failed_leg` and `5`, or `failure` and `5:limp`."""
    locked = failure.kind == "locked"
    return ("failed_leg", str(failure.leg)) if locked else ("failure", failure.typed)


def read_legs(asked: AskedLegs) -> tuple[int, ...]:
    """Numbers of failed legs; raises InputError for anything else, each number 1..6."""
    if isinstance(asked, str):
        return parse_legs(asked, argument("failed_leg"))
    legs = () if asked is None else (asked,) if isinstance(asked, int) else asked
    check_type(
        legs, (tuple, list), argument("failed_leg"), f"{_LEGS}, the leg that fails, or several, as (2, 5)"
    )
    for leg in legs:
        check_type(leg, int, argument("failed_leg"), f"{_LEGS}, the leg that fails")
    return tuple(legs)


def read_healings(asked: Sequence[str | FailureEvent]) -> tuple[FailureEvent, ...]:
    """Healing events of texts such as `5@20` and values; raises InputError for anything else."""
    what, allowed = argument("heal"), f"text {HEALING_FORMS}"
    check_type(asked, (tuple, list), what, f"a list of {allowed}")
    for one in asked:
        check_type(one, (str, FailureEvent), what, allowed)
    events = tuple(parse_healing(one) if isinstance(one, str) else one for one in asked)
    failing = [event for event in events if event.failure is not None]
    if failing:
        raise InputError(f"{what}: got '{failing[0]}', a leg that fails; allowed: {HEALING_FORMS}")
    return events


def parse_leg(text: str, what: str = "") -> int:
    """Number of a leg; raises InputError that names `what` for anything but 1..6."""
    if not _is_leg(text):
        raise InputError(_refusal(text, what) + _LEGS)
    return int(text)


def parse_legs(text: str, what: str = "") -> tuple[int, ...]:
    """Legs of a text such as `2,5`, ascending; raises InputError that names `what` for anything else."""
    parts = [part for part in text.split(",") if part.strip(" ")]
    if not parts or not all(map(_is_leg, parts)):
        raise InputError(_refusal(text, what) + f"{_LEGS}, several with commas such as 2,5")
    return tuple(sorted(map(int, parts)))


def parse_failure(text: str) -> Failure:
    """Failure before a walk, of a text such as `5:stuck:femur:30`; raises InputError for anything else."""
    return _of_leg(text, text, argument("failure"), FORMS, coming=False)


def parse_failure_now(text: str) -> Failure:
    """Failure now, of a text without angle such as `5:stuck:femur`; raises InputError for anything else."""
    return _of_leg(text, text, "LEG:KIND", NOW_FORMS, coming=True)


def parse_failure_event(text: str) -> FailureEvent:
    """Event of a text such as `5:locked@8`, without angle; raises InputError for anything else."""
    what = argument("failure")
    before, at, time_text = text.rpartition("@")
    if not at:
        raise InputError(_refusal(text, what) + "LEG:KIND@SECONDS such as 5:locked@8")
    failure = _of_leg(before, text, what, FORMS, coming=True)
    return FailureEvent(at_s=_seconds(time_text, text, what), leg=failure.leg, failure=failure)


def parse_healing(text: str) -> FailureEvent:
    """Event of a text such as `5@20`, the leg and the time; raises InputError for anything else."""
    leg, at, time_text = text.partition("@")
    if not (at and _is_leg(leg)):
        raise InputError(_refusal(text, argument("heal")) + HEALING_FORMS)
    return FailureEvent(at_s=_seconds(time_text, text, argument("heal")), leg=int(leg))


def parse_kind(leg: int, text: str) -> Failure:
    """Failure of leg 1..6 of a text such as `limp`, `weak:0.3`, `stuck:femur:30`; raises InputError."""
    check_type(text, str, argument("failure"), KINDS)
    return _of_kind(leg, text, _refusal(text, argument("failure")), coming=False)


def parse_coming_kind(leg: int, text: str) -> Failure:
    """Failure of leg 1..6 that happens while it moves, without angle and `unknown`; raises InputError."""
    check_type(text, str, argument("failure"), COMING_KINDS)
    return _of_kind(leg, text, _refusal(text, argument("failure")), coming=True)


def _refusal(text: str, what: str) -> str:
    prefix = f"{what}: " if what else ""
    return f"{prefix}got {text!r}; allowed: "


def _is_leg(text: str) -> bool:
    """Whether a text is a leg's number, with or without spaces around it."""
    return text.strip(" ") in map(str, range(1, N_LEGS + 1))


def _of_leg(part: str, text: str, what: str, forms: str, *, coming: bool) -> Failure:
    """Failure of a part such as `5:limp` of a text; a leg without a kind is locked."""
    check_type(part, str, what, forms)
    leg, colon, kind = part.partition(":")
    refused = _refusal(text, what)
    if not _is_leg(leg) or "@" in kind:
        number = leg.strip().lstrip("-").isdecimal()
        raise InputError(refused + (f"a leg, {_LEGS}, as in 5:limp" if number else forms))
    return _of_kind(int(leg), kind if colon else "locked", refused, coming=coming)


def _of_kind(leg: int, text: str, refused: str, *, coming: bool) -> Failure:
    """Failure of a leg by the text of its kind; `refused` begins errors, `coming` is while it moves."""
    kind, *details = (_known(part) for part in text.split(":"))
    kinds = BROKEN_KINDS if coming else FAILURE_KINDS
    if kind not in kinds or len(details) > _MOST_DETAILS.get(kind, 0):
        forms = COMING_KINDS if coming else KINDS
        raise InputError(f"{refused}{forms}{'' if kind in FAILURE_KINDS else nearest(kind, kinds)}")
    if kind == "weak":
        return _weak(leg, details, refused)
    if kind == "stuck":
        return _stuck(leg, details, refused, coming=coming)
    if details and details[0] not in JOINT_KINDS:
        raise InputError(f"{refused}{kind}:JOINT with {_JOINTS}")
    return Failure(leg=leg, kind=kind, joint=details[0] if details else None)


#: Maximum number of details of a kind.
_MOST_DETAILS = {"stuck": 2, "weak": 2, "limp": 1}


def _weak(leg: int, details: list[str], refused: str) -> Failure:
    joint = details.pop(0) if details and details[0] in JOINT_KINDS else None
    if not details:
        return Failure(leg=leg, kind="weak", joint=joint)
    fraction = _number(details[0], refused)
    if len(details) > 1 or not 0 <= fraction <= 1:
        raise InputError(f"{refused}weak:FRACTION or weak:JOINT:FRACTION, the part of its torque, 0..1")
    return Failure(leg=leg, kind="weak", joint=joint, torque_fraction=fraction)


def _stuck(leg: int, details: list[str], refused: str, *, coming: bool) -> Failure:
    """Leg with a joint jammed at an angle, or where it is."""
    joint = details[0] if details else None
    if coming and len(details) != 1:
        where = "it jams at its current angle" if details else "a leg that keeps its pose is locked"
        raise InputError(f"{refused}stuck:JOINT with {_JOINTS}; {where}")
    degrees = _number(details[1], refused) if len(details) > 1 else 0.0
    if joint not in (None, *JOINT_KINDS) or not math.isfinite(degrees):
        forms = "stuck:JOINT" if coming else "stuck:JOINT:DEGREES"
        raise InputError(f"{refused}{forms} with {_JOINTS}{'' if coming else ' and a finite angle'}")
    return Failure(leg=leg, kind="stuck", joint=joint, angle_rad=math.radians(degrees))


def _known(part: str) -> str:
    """A kind or a joint in canonical spelling, anything else as it is."""
    return known_name(part, (*FAILURE_KINDS, *JOINT_KINDS)) or part


def _number(text: str, refused: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{refused}a number in place of {text!r}") from None


def _seconds(time_text: str, text: str, what: str) -> float:
    """Seconds of a time, 0 or more; `text` is for the message."""
    seconds = _number(time_text, refused := _refusal(text, what))
    if not (math.isfinite(seconds) and seconds >= 0):
        raise InputError(f"{refused}0 s or more in place of {time_text!r}")
    return seconds
