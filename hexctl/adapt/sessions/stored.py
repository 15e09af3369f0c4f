"""Rows of the session store become a session, or are refused with what is wrong with them.

A row may come from another version, a disk that lost a page, or another person: what it holds is checked
before any of it is believed.
"""

import json
import math
import re
from collections.abc import Iterable
from datetime import datetime
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from hexctl.adapt.sessions.search_session import (
    BaselineRecord,
    ConfirmationRecord,
    Session,
    SessionSpec,
    TrialRecord,
)
from hexctl.adapt.space import GaitSpace
from hexctl.control.trial_result import STATUSES
from hexctl.errors import printable, printable_parts
from hexctl.gait.encoding import check_permutation
from hexctl.robot.configs import first_problem

#: The longest name of a folder, in bytes.
MOST_NAME_BYTES = 255

#: What a name that `SessionStore.create` makes begins with. Other folders of `runs/` are not sessions.
_MADE = re.compile(r"\d{8}-\d{6}-leg[1-6]-[\w.-]+")

#: What is raised for what is no session.
DAMAGE = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)


def is_folder_name(name: str) -> bool:
    """Whether a name is that of one folder beside the store: it leads nowhere else."""
    one = name not in ("", ".", "..") and not set("/\\") & set(name) and printable(name) == name
    return one and len(name.encode("utf-8")) <= MOST_NAME_BYTES


def is_made_by_hexctl(name: str) -> bool:
    """Whether a session's name is one that hexctl gives, and so its folder one that hexctl has made."""
    return is_folder_name(name) and _MADE.fullmatch(name) is not None


class _Plain(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="allow")


class _Deviation(_Plain):
    final: float | None
    mean: float | None
    max: float | None
    signed: float | None


class _Outcome(_Plain):
    """What `TrialResult.to_dict` writes."""

    status: Annotated[str, Field(pattern=f"^({'|'.join(STATUSES)})$")]
    duration_s: Annotated[float, Field(ge=0)]
    distance_m: float | None
    ideal_distance_m: float
    deviation_m: _Deviation
    yaw_change_deg: float | None
    self_rotation_deg: float
    clipped_ticks: Annotated[int, Field(ge=0)]
    stopped: str | None
    cause: str | None
    hold: str
    hold_caveat: str | None
    energy_j: float | None
    cost_of_transport: float | None
    tilt_deg: float | None
    steadiness: float | None
    trim_deg: float | None
    turn_trim_deg_s: float | None


class _Expected(_Plain):
    signed_m: float
    low_m: float
    high_m: float
    chance: float


class _Settled(_Plain):
    code: int
    chance: float
    target_m: float


#: Where the pose is not known, a point of a path is NaN.
_Point = Annotated[list[Annotated[float, Field(allow_inf_nan=True)]], Field(min_length=2, max_length=2)]


class _Walk(_Plain):
    slots: list[int]
    score: float
    outcome: _Outcome
    path_m: list[
        Annotated[list[Annotated[float, Field(allow_inf_nan=True)]], Field(min_length=2, max_length=2)]
    ]
    recording: str | None
    wanted_trim_deg: float | None
    wanted_turn_trim_deg_s: float | None
    margin_m: float | None


class _Trial(_Walk):
    index: Annotated[int, Field(ge=1)]
    code: int
    confirms: bool
    expected: _Expected | None


class _Baseline(_Walk):
    gait: str
    code: int | None


class _Confirmation(_Walk):
    code: int | None
    time_step_s: Annotated[float, Field(gt=0)]


_SPEC = TypeAdapter(SessionSpec)


def stored_session(
    name: str,
    head: tuple[Any, Any, Any, Any],
    trials: Iterable[tuple[Any, Any, Any]],
    baseline: Iterable[Any],
    confirmations: Iterable[Any] = (),
) -> Session:
    """Session of what a store holds.

    Args:
        name: of the session.
        head: when it was created, its spec, why it ended and what it settled on.
        trials: number, record and state of the optimizer after it, by number.
        baseline: records of its walks with other gaits.
        confirmations: records of its walks at a finer time step.

    Raises ValueError that says what is wrong.
    """
    if not is_folder_name(name):
        raise ValueError("its name is none of a folder")
    created, spec, ended, settled_on = head
    session = Session(
        name=name,
        created=_checked("created", _time, created),
        spec=_checked("spec", _spec, spec),
        ended=_checked("ended", _text, ended),
        settled_on=None if settled_on is None else _checked("settled_on", _of, settled_on, _Settled),
    )
    space = GaitSpace((session.spec.failed_leg,))
    for number, (stored, record, state) in enumerate(trials, start=1):
        if stored != number:
            raise ValueError(f"trial {number} is missing")
        session.trials.append(_checked(f"trial {number}", _trial, record, number, space))
        session.optimizer_state = _checked(f"state after trial {number}", _mapping, state)
    for number, record in enumerate(baseline, start=1):
        session.baseline.append(_checked(f"walk {number} of the baseline", _baseline, record, space))
    for number, record in enumerate(confirmations, start=1):
        session.confirmations.append(_checked(f"confirmation {number}", _confirmation, record, space))
    if session.settled_on is not None:
        _checked("settled_on", space.slots_of, session.settled_on["code"])
    _checked("trials", Session.as_json, session)
    return session


def _checked(what: str, read: Any, *values: Any) -> Any:
    """What a reader makes of stored values; raises ValueError that names them."""
    try:
        return read(*values)
    except DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{what}: {reason}") from error


def _text(value: Any) -> str | None:
    if value is not None and not isinstance(value, str):
        raise TypeError("it is no text")
    return None if value is None else printable(value)


def _time(value: Any) -> str:
    datetime.fromisoformat(value)
    return str(value)


def _mapping(text: Any) -> dict[str, Any]:
    values = json.loads(text)
    if not isinstance(values, dict):
        raise TypeError("it is no mapping")
    return dict(printable_parts(values))


def _spec(text: Any) -> SessionSpec:
    values = _mapping(text)
    try:
        spec: SessionSpec = _SPEC.validate_json(text, strict=True)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}") from error
    if unknown := set(values) - set(spec.as_json()):
        raise ValueError(f"unknown key {sorted(unknown)[0]}")
    if missing := set(spec.as_json()) - set(values):
        raise ValueError(f"{sorted(missing)[0]} is missing")
    for key, value in spec.as_json().items():
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{key}: {value} is not finite")
        if isinstance(value, str) and printable(value) != value:
            raise ValueError(f"{key}: {value!r} is no line of text")
    _ = spec.broken
    return spec


def _of(text: Any, model: type[BaseModel]) -> dict[str, Any]:
    """The mapping of a text, which a model takes."""
    values = _mapping(text)
    try:
        model.model_validate(values)
    except ValidationError as error:
        raise ValueError(first_problem(model, error)) from error
    return values


def _trial(text: Any, number: int, space: GaitSpace) -> TrialRecord:
    values = _of(text, _Trial)
    check_permutation(values["slots"])
    if space.slots_of(values["code"]) != tuple(values["slots"]):
        raise ValueError(f"code: {values['code']} is another gait than the slots {values['slots']}")
    trial = TrialRecord(**{**values, "slots": tuple(values["slots"])})
    if trial.index != number:
        raise ValueError(f"it is that of trial {trial.index}")
    _ = trial.result
    return trial


def _baseline(text: Any, space: GaitSpace) -> BaselineRecord:
    values = _of(text, _Baseline)
    if values["code"] is not None:  # a gait that is not in the space, such as a tripod, has none
        space.slots_of(values["code"])
    walk = BaselineRecord(**{**values, "slots": tuple(values["slots"])})
    _ = walk.result
    return walk


def _confirmation(text: Any, space: GaitSpace) -> ConfirmationRecord:
    values = _of(text, _Confirmation)
    if values["code"] is not None:  # a gait that is not in the space, such as a tripod, has none
        space.slots_of(values["code"])
    walk = ConfirmationRecord(**{**values, "slots": tuple(values["slots"])})
    _ = walk.result
    return walk
