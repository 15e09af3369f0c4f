"""Options: the fields of a frozen dataclass, each declared once.

A field is an option of the command line, a key of `hexctl.toml`, a variable `HEXCTL_*` and a keyword in
Python. Its annotation has the range, its docstring is the help:

    @dataclass(frozen=True, kw_only=True)
    class Options:
        pace_hz: Annotated[float | None, Range(low=0, high=10, above=True)] = None
        "Gait cycles per second. (default: the robot's)"
"""

import ast
import inspect
import math
import textwrap
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from functools import cache, partial
from itertools import pairwise
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from hexctl.errors import InputError, UnusedError, argument, check_type
from hexctl.typed_names import nearest

#: The Tab key offers the numbers of a range with at most this many whole numbers.
MAX_OFFERED = 10

#: Units at the end of a field's name, which its flag omits.
UNITS = ("_rad_s", "_rad", "_deg", "_hz", "_kg", "_m", "_s", "_c")


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """The numbers that an option accepts; its text appears in the help and in error messages.

    Attributes:
        above: whether `low` itself is excluded.
        degrees: whether the option is in degrees and its field in radians.
    """

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    whole: bool = False
    unit: str = ""
    degrees: bool = False

    def __str__(self) -> str:
        return self._text(to="..", unit="")

    def _text(self, *, to: str, unit: str) -> str:
        low, high = f"{self.low:g}", f"{self.high:{'.15' if float(self.high).is_integer() else ''}g}"
        if math.isinf(self.low):
            return "any finite number"
        if math.isinf(self.high):
            return f"above {low}{unit}" if self.above else f"{low}{unit} or more"
        return f"above {low} up to {high}{unit}" if self.above else f"{low}{to}{high}{unit}"

    def __contains__(self, value: float) -> bool:
        above = value > self.low if self.above else value >= self.low
        # Whole numbers are finite, and may be larger than any float.
        return (isinstance(value, int) or math.isfinite(value)) and above and value <= self.high

    def parse(self, text: str | float) -> int | float:
        """Return the number of a text; raises ValueError outside the range, for nan and for infinity."""
        try:
            value = int(text) if self.whole else float(text)
        except ValueError:
            kind = "a whole number" if self.whole else "a number"
            bounds = "" if math.isinf(self.low) else f", {self._allowed}"
            raise ValueError(f"got {text!r}; allowed: {kind}{bounds}") from None
        if value not in self:
            raise ValueError(f"got {text}; allowed: {self._allowed}")
        return math.radians(value) if self.degrees else value

    def check(self, what: str, value: float) -> None:
        """Raise InputError for a value outside the range or no number; `what` names it."""
        number, kind = (int, "a whole number") if self.whole else (float, "a number")
        if type(value) is not number:
            check_type(value, number, what, f"{kind}, {self._allowed}")
        if value not in self:
            raise InputError(f"{what}: got {value:g}; allowed: {self._allowed}")

    @property
    def of_field(self) -> "Range":
        """The range of the field: in radians for an option in degrees."""
        if not self.degrees:
            return self
        low, high = math.radians(self.low), math.radians(self.high)
        return replace(self, low=low, high=high, unit=self.unit.replace("deg", "rad"), degrees=False)

    def complete(self, incomplete: str) -> list[str]:
        """Completions of the shell: all of a short range of whole numbers, else none."""
        if not self.whole or self.high - self.low >= MAX_OFFERED:
            return []
        numbers = map(str, range(int(self.low), int(self.high) + 1))
        return [number for number in numbers if number.startswith(incomplete)]

    @property
    def _allowed(self) -> str:
        return self._text(to=" to ", unit=f" {self.unit}") if self.unit else str(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Typed:
    """How an option is typed, if it differs from its field.

    Attributes:
        flag: without hyphens; empty for the name of the field without its unit.
        parse: makes the value from a text; raises ValueError with the text and the allowed values.
        words: completion, a name in `hexctl.cli.completion`; empty for files. `{}` in the help lists them.
    """

    flag: str = ""
    short: str = ""
    parse: Callable[[str], Any] | None = None
    words: str = ""


@dataclass(frozen=True, slots=True)
class Panel:
    """Group of an option in the help, if it is not `PANEL` of its first class."""

    name: str


#: Annotation of a field without an option: a keyword in Python.
UNTYPED = object()

#: Annotation of a field that only `--help-all` shows.
RARE = object()


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """A field as an option: its type without annotations, and its help with the range."""

    name: str
    kind: Any
    default: Any
    text: str
    range: Range | None
    typed: Typed
    rare: bool
    panel: str

    @property
    def flag(self) -> str:
        """Flag, without hyphens."""
        return self.typed.flag or flag_name(self.name)


def flag_name(field: str) -> str:
    """Return the flag of a field without hyphens: its name without its unit."""
    unit = next((unit for unit in UNITS if field.endswith(unit)), "")
    return field.removesuffix(unit).replace("_", "-")


def listed(text: str) -> tuple[str, ...]:
    """Parts of a comma-separated text."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def options_of(spec: type) -> tuple[Option, ...]:
    """Return the options of a dataclass: its own in the order of its fields, then those of its bases."""
    hints, helps = get_type_hints(spec, include_extras=True), _docstrings(spec)
    owners = {name: owner for owner in spec.__mro__ for name in inspect.get_annotations(owner)}
    ordered = sorted(fields(spec), key=lambda field: spec.__mro__.index(owners[field.name]))
    options = (
        _option(field, hints[field.name], helps.get(field.name, ""), getattr(owners[field.name], "PANEL", ""))
        for field in ordered
    )
    return tuple(option for option in options if option is not None)


def _option(field: "Field[Any]", hint: Any, text: str, panel: str) -> Option | None:
    kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if UNTYPED in marks:
        return None
    allowed = next((mark for mark in marks if isinstance(mark, Range)), None)
    typed = next((mark for mark in marks if isinstance(mark, Typed)), Typed())
    default = None if field.default is MISSING else field.default
    shown = text if allowed is None else text.replace("{}", str(allowed))
    return Option(
        name=field.name,
        kind=kind,
        default=default,
        text=shown,
        range=allowed,
        typed=typed,
        rare=RARE in marks,
        panel=next((mark.name for mark in marks if isinstance(mark, Panel)), panel),
    )


def chosen_options(spec: Any) -> dict[str, str]:
    """Return the options of a dataclass that differ from their defaults, by flag, as typed."""
    values = ((option, getattr(spec, option.name)) for option in options_of(type(spec)))
    return {option.flag: _typed_text(value) for option, value in values if value != option.default}


def check_names(call: Callable[..., Any], given: Iterable[str], spec: type) -> None:
    """Raise InputError for keywords of a call that are neither fields of its options nor its own."""
    own = [one.name for one in inspect.signature(call).parameters.values() if one.kind != one.VAR_KEYWORD]
    known = list(dict.fromkeys([*(field.name for field in fields(spec)), *own]))
    if unknown := [name for name in given if name not in known]:
        allowed = f"{', '.join(known)}{nearest(unknown[0], known)}"
        raise InputError(f"{call.__name__}: got {', '.join(unknown)}; allowed: {allowed}")


def check_fields(spec: Any) -> None:
    """Check types, choices and ranges of fields; raises WrongTypeError or InputError."""
    for field in fields(spec):
        hint = _hints(type(spec))[field.name]  # type: ignore[arg-type]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        _check_value(argument(field.name), getattr(spec, field.name), kind, marks)


_hints = cache(partial(get_type_hints, include_extras=True))


def check_used(spec: Any, names: Container[str], where: str) -> None:
    """Raise UnusedError for the first set option among unused ones; `where` names their context."""
    for field in fields(spec):
        value = getattr(spec, field.name)
        if field.name in names and value != field.default:
            raise UnusedError(f"{argument(field.name)}: got {_typed_text(value)}; allowed: {where}")


def _typed_text(value: Any) -> str:
    if isinstance(value, tuple | list):
        return ",".join(map(_typed_text, value)) or "none"
    if value is True:
        return "it"
    return f"{value:g}" if isinstance(value, float) else str(getattr(value, "typed", value))


def _check_value(what: str, value: Any, kind: Any, marks: Sequence[Any]) -> None:
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    if (None in kinds or NoneType in kinds) and value is None:
        return
    words = next((get_args(one) for one in kinds if get_origin(one) is Literal), ())
    if words and value not in words:
        raise InputError(f"{what}: got {value}; allowed: {', '.join(map(str, words))}")
    allowed = next((mark for mark in marks if isinstance(mark, Range)), None)
    if allowed is not None:
        allowed.of_field.check(what, value)
    elif not words and Any not in kinds and all(isinstance(one, type) for one in kinds):
        check_type(value, kinds, what)


def _docstrings(spec: type) -> dict[str, str]:
    """First paragraphs of the docstrings of fields, including those of base classes."""
    found: dict[str, str] = {}
    for owner in reversed(spec.__mro__[:-1]):
        (declared,) = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
        body = getattr(declared, "body", [])
        for field, text in pairwise(body):
            match field, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(value=str() as words)):
                    found[name] = " ".join(inspect.cleandoc(words).split("\n\n")[0].split())
    return found
