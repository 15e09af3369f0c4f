"""Values of options: ranges of numbers, words of a list, and which options were typed.

Light to import: `hexctl --help` needs only these.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import typer

from hexctl.errors import InputError

#: A range with no more whole numbers than this is offered by the Tab key.
MAX_OFFERED = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """The numbers that an option takes; its text stands in the help and in error messages.

    Attributes:
        low: lowest value.
        high: highest value.
        above: whether `low` itself is excluded.
        whole: whether only whole numbers are allowed.
        unit: unit, for error messages.
    """

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    whole: bool = False
    unit: str = ""

    def __str__(self) -> str:
        return self._text(to="..", unit="")

    def _text(self, *, to: str, unit: str) -> str:
        low, high = f"{self.low:g}", f"{self.high:.15g}"
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
        """Parse a number; raises BadParameter for anything outside the range, nan and infinity included."""
        try:
            value = int(text) if self.whole else float(text)
        except ValueError:
            kind = "a whole number" if self.whole else "a number"
            bounds = "" if math.isinf(self.low) else f", {self._allowed}"
            raise typer.BadParameter(f"got {text!r}; allowed: {kind}{bounds}") from None
        if value not in self:
            raise typer.BadParameter(f"got {text}; allowed: {self._allowed}")
        return value

    def complete(self, incomplete: str) -> list[str]:
        """Numbers that the shell offers: all of a short range of whole numbers, else none."""
        if not self.whole or self.high - self.low >= MAX_OFFERED:
            return []
        numbers = map(str, range(int(self.low), int(self.high) + 1))
        return [number for number in numbers if number.startswith(incomplete)]

    @property
    def _allowed(self) -> str:
        return self._text(to=" to ", unit=f" {self.unit}") if self.unit else str(self)


def number(flag: str, allowed: Range, text: str) -> Any:
    """Option that takes a number; `{}` in the help text stands for its range."""
    return typer.Option(
        flag, parser=allowed.parse, autocompletion=allowed.complete, help=text.format(allowed)
    )


def choice(flag: str, literal: Any, text: str) -> Any:
    """Option that takes one of the words of a `Literal`, which the shell offers too."""
    words = get_args(literal)

    def parse(word: str) -> str:
        if word not in words:
            raise typer.BadParameter(f"got {word}; allowed: {', '.join(words)}")
        return word

    return typer.Option(flag, parser=parse, help=text)


def in_lower_case(name: str | None) -> str | None:
    """A name as hexctl writes it; what holds a name of somebody else's, after a colon, as it is."""
    return name if name is None or ":" in name else name.strip().lower()


def given(context: typer.Context) -> Mapping[str, Any]:
    """Values of the options and arguments that were typed, by flag (`--seed`) or by argument name."""
    return {
        next((name for name in parameter.opts if name.startswith("--")), str(parameter.name)): value
        for parameter in context.command.params
        if (value := context.params.get(str(parameter.name))) is not None
        and getattr(context.get_parameter_source(str(parameter.name)), "name", "") == "COMMANDLINE"
    }


def is_said(context: typer.Context, name: str) -> bool:
    """Whether a parameter was typed or follows a setting, so that its value is not its default."""
    return getattr(context.get_parameter_source(name), "name", "DEFAULT") != "DEFAULT"


def with_values(**options: Any) -> dict[str, Any]:
    """The options that have a value; for those that are None the library's own defaults hold."""
    return {name: value for name, value in options.items() if value is not None}


def listed(text: str) -> tuple[str, ...]:
    """Parts of a text between commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def refuse_given(options: Mapping[str, object], allowed: str) -> None:
    """Raise InputError for an option, by its flag, that was given: one that is not None.

    Args:
        options: values by flag.
        allowed: where the option is allowed, such as `with --physics`.
    """
    for flag, value in options.items():
        if value is not None:
            told = "allowed: only" if value is True else f"got {value}; allowed:"
            raise InputError(f"{flag}: {told} {allowed}")
