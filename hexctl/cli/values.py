"""Values of options: numbers, words of a list, and which options were typed.

Light to import: `hexctl --help` needs only these.
"""

from collections.abc import Callable, Mapping
from typing import Any, get_args

import typer

from hexctl.errors import InputError
from hexctl.options import Range


def checked(parse: Callable[[str], Any]) -> Callable[[str], Any]:
    """Parser of an option, of a function that raises ValueError with what it got and what is allowed."""

    def parsed(text: str) -> Any:
        try:
            return parse(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None

    return parsed


def number(flag: str, allowed: Range, text: str) -> Any:
    """Option that takes a number; `{}` in the help text stands for its range."""
    return typer.Option(
        flag, parser=checked(allowed.parse), autocompletion=allowed.complete, help=text.format(allowed)
    )


def choice(flag: str, literal: Any, text: str) -> Any:
    """Option that takes one of the words of a `Literal`, which the shell offers too."""
    words = get_args(literal)

    def parse(word: str) -> str:
        if word not in words:
            raise typer.BadParameter(f"got {word}; allowed: {', '.join(words)}")
        return word

    def complete(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return typer.Option(flag, parser=parse, autocompletion=complete, help=text)


def rare(option: Any) -> Any:
    """Option that `--help` leaves out, for commands with `--help-all`."""
    option.hidden = True
    return option


def given(context: typer.Context) -> Mapping[str, Any]:
    """Values of the options and arguments that were typed, by flag (`--seed`) or by argument name."""
    return {
        next((name for name in parameter.opts if name.startswith("--")), str(parameter.name)): value
        for parameter in context.command.params
        if (value := context.params.get(str(parameter.name))) is not None
        and getattr(context.get_parameter_source(str(parameter.name)), "name", "") == "COMMANDLINE"
    }


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
