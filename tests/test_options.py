"""Options are the fields of a dataclass: order, groups, flags, ranges, and what is refused."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.options import (
    RARE,
    UNTYPED,
    Panel,
    Range,
    Typed,
    check_fields,
    check_names,
    check_used,
    options_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a thing is."""

    PANEL: ClassVar = "Connection"

    connect: str | None = None
    """Where it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing(Place):
    """What a thing does."""

    PANEL: ClassVar = "Walk"

    pace_hz: Annotated[float, Range(low=0, high=10, above=True), RARE] = 1.0
    """Cycles per second, {}."""

    turn_rad: Annotated[float | None, Range(low=-90, high=90, degrees=True), Typed(flag="turn")] = None
    """Degrees to turn, {}."""

    mode: Annotated[Literal["auto", "none"], Panel("Other")] = "auto"
    """What it holds."""

    inner: Annotated[int, UNTYPED] = 0
    """Only for Python."""

    connect: str | None = "here"
    """Where this one is."""


def test_own_options_come_first_each_with_its_flag_group_and_range() -> None:
    found = [(one.name, one.flag, one.panel, one.rare) for one in options_of(Thing)]
    assert found == [
        ("pace_hz", "pace", "Walk", True),
        ("turn_rad", "turn", "Walk", False),
        ("mode", "mode", "Other", False),
        ("connect", "connect", "Connection", False),
    ]
    texts = {one.name: one.text for one in options_of(Thing)}
    assert texts["pace_hz"] == "Cycles per second, above 0 up to 10."
    assert texts["connect"] == "Where this one is."


@pytest.mark.parametrize(
    ("fields", "error", "named"),
    [
        ({"pace_hz": 11.0}, InputError, "pace_hz"),
        ({"pace_hz": "1"}, WrongTypeError, "pace_hz"),
        ({"pace_hz": True}, WrongTypeError, "pace_hz"),
        ({"turn_rad": 3.0}, InputError, "turn_rad"),
        ({"mode": "line"}, InputError, "mode"),
        ({"connect": 5}, WrongTypeError, "connect"),
        ({"inner": 1.5}, WrongTypeError, "inner"),
    ],
)
def test_a_value_that_its_type_does_not_allow_is_refused(
    fields: dict[str, object], error: type[InputError], named: str
) -> None:
    with pytest.raises(error, match=f"^{named}: got"):
        check_fields(Thing(**fields))  # type: ignore[arg-type]


def test_values_that_the_types_allow_pass() -> None:
    check_fields(Thing(pace_hz=2, turn_rad=1.5, mode="none", connect=None))


def test_a_caller_in_python_reads_its_number_in_radians() -> None:
    with pytest.raises(InputError, match=r"^turn_rad: got 90; allowed: -1\.5708\.\.1\.5708$"):
        check_fields(Thing(turn_rad=90.0))


def test_an_option_that_nothing_uses_is_refused_unless_it_is_its_default() -> None:
    check_used(Thing(), ("pace_hz", "connect"), "with a robot")
    with pytest.raises(InputError, match=r"^pace_hz: got 2; allowed: with a robot$"):
        check_used(Thing(pace_hz=2.0), ("pace_hz", "connect"), "with a robot")


def make(*, stop: bool = False, **options: float) -> None:  # noqa: ARG001
    check_names(make, options, Thing)


def test_a_keyword_that_is_no_field_is_refused_with_the_nearest_one() -> None:
    make(pace_hz=2, stop=True)
    with pytest.raises(InputError, match=r"^make: got pace; allowed: .*, stop; did you mean 'pace_hz'\?$"):
        make(pace=2)
