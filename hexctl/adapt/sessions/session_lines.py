"""Lines of a session's file, which hold its standing or a walk, and are checked when read."""

import json
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, Settled, TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.errors import InputError, printable_parts

#: A walk that is stored.
Walk = TrialRecord | BaselineRecord | ConfirmationRecord

#: What is raised for a line that is none of a session.
DAMAGE = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Fields of a `Session` without its walks."""

    created: str
    spec: SessionSpec
    ended: str | None
    settled_on: Settled | None

    def __post_init__(self) -> None:
        datetime.fromisoformat(self.created)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    """Standing or walk in a line of a session's file."""

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", allow_inf_nan=False)

    session: Standing | None = None
    trial: TrialRecord | None = None
    state: dict[str, Any] | None = None
    baseline: BaselineRecord | None = None
    confirmation: ConfirmationRecord | None = None


_LINE = TypeAdapter(_Line)

#: A session without a seal was begun by an unknown user, and one without a port has none.
_SPEC_FIELDS = {field.name for field in fields(SessionSpec)} - {"seal", "port"}

#: Names of walks in a line, by their class.
_KINDS = {TrialRecord: "trial", BaselineRecord: "baseline", ConfirmationRecord: "confirmation"}


def standing_line(session: Session) -> bytes:
    """Line of a session's standing; raises TypeError for a value that JSON cannot hold."""
    values = {field.name: getattr(session, field.name) for field in fields(Standing)}
    spec = asdict(session.spec)
    spec |= {name: value.item() for name, value in spec.items() if isinstance(value, np.generic)}
    return _text({"session": {**values, "spec": spec}})


def walk_line(walk: Walk, optimizer_state: dict[str, Any] | None) -> bytes:
    """Line of a walk, with the optimizer's state if it learned from it; TypeError if JSON cannot hold it."""
    state = {} if optimizer_state is None else {"state": optimizer_state}
    return _text({_KINDS[type(walk)]: asdict(walk), **state})


def _text(line: dict[str, Any]) -> bytes:
    return json.dumps(line).encode() + b"\n"


def read_session(name: str, content: bytes) -> tuple[Session, dict[int, str]]:
    """Session of a file's content, and the errors of its damaged lines, by their numbers.

    An incomplete last line is damaged, too. If only a damaged trial reached the target, the search has not
    ended. Raises ValueError without a line with a standing.
    """
    *texts, cut_off = content.split(b"\n")
    lines: dict[int, _Line] = {}
    damaged: dict[int, str] = {}
    for number, text in enumerate(texts, start=1):
        try:
            lines[number] = _read_line(text)
        except DAMAGE as error:
            damaged[number] = damage_text(error)
    if cut_off:
        damaged[len(texts) + 1] = f"it is cut off, {len(cut_off)} bytes are left out"
    standings = [line.session for line in lines.values() if line.session is not None]
    if not standings:
        raise ValueError(next(iter(damaged.values()), "it is empty"))
    last = {field.name: getattr(standings[-1], field.name) for field in fields(Standing)}
    session = Session(name=name, stored_bytes=len(content) - len(cut_off), **last)
    for number, line in lines.items():
        try:
            _take_in_line(session, line)
        except DAMAGE as error:
            damaged[number] = damage_text(error)
    if damaged and session.ended == "target" and not session.met_target:
        session.ended = session.settled_on = None
    return session, dict(sorted(damaged.items()))


def _read_line(text: bytes) -> _Line:
    values = json.loads(text)
    state = values.pop("state", None)  # its optimizer checks it
    spec = (values.get("session") or {}).get("spec") or {}
    if "policy" in spec:  # the former name of `recovery`
        spec["recovery"] = spec.pop("policy")
    if "robot" in spec:  # a session from before this option measured everything
        spec.setdefault("all_sensors", True)
    line = _LINE.validate_python({**printable_parts(values), "state": state})
    if line.session is not None and (missing := _SPEC_FIELDS - set(values["session"]["spec"])):
        raise ValueError(f"spec: {min(missing)} is missing")
    return line


def _take_in_line(session: Session, line: _Line) -> None:
    space = GaitSpace((session.spec.broken.leg,))
    for walk in (line.trial, line.baseline, line.confirmation):
        if walk is None:
            continue
        # A gait that is not in the space, such as a tripod, has no code.
        if walk.code is not None and space.slots_of(walk.code) != walk.slots:
            raise InputError(f"code: {walk.code} is another gait than the slots {walk.slots}")
        if isinstance(walk, TrialRecord) and session.trials and walk.index <= session.trials[-1].index:
            raise InputError(f"trial {walk.index} comes after trial {session.trials[-1].index}")
        walk.as_json(), walk.result
        take_in(session, walk, line.state)


def take_in(session: Session, walk: Walk, optimizer_state: dict[str, Any] | None) -> None:
    """Add a stored walk to its session."""
    match walk:
        case TrialRecord():
            session.trials.append(walk)
            session.optimizer_state = optimizer_state
        case BaselineRecord():
            session.baseline.append(walk)
            session.optimizer_state = optimizer_state or session.optimizer_state
        case ConfirmationRecord():
            session.confirmations.append(walk)


def damage_text(error: BaseException) -> str:
    """Error of a line or a file in words."""
    if isinstance(error, ValidationError):
        problem = error.errors(include_url=False)[0]
        return f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__
