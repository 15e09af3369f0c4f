"""Values of options: numbers, words of a list, and which options were typed. Imports light."""

from collections.abc import Callable, Mapping
from typing import Any, get_args

import typer

from hexctl.options import Range


def checked(parse: Callable[[str], Any]) -> Callable[[str], Any]:
    """Option's parser from a function that raises ValueError with the value and the allowed ones."""

    def parsed(text: str) -> Any:
        try:
            return parse(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None

    return parsed


def number(flag: str, allowed: Range, text: str) -> Any:
    """Option with a number; `{}` in the help text stands for its range."""
    shown = text.replace("{}", str(allowed))
    return typer.Option(flag, parser=checked(allowed.parse), autocompletion=allowed.complete, help=shown)


def choice(flag: str, literal: Any, text: str) -> Any:
    """Option with one of the words of a `Literal`, which the shell completes."""
    words = get_args(literal)

    def parse(word: str) -> str:
        if word not in words:
            raise typer.BadParameter(f"got {word}; allowed: {', '.join(words)}")
        return word

    def offered(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return typer.Option(flag, parser=parse, autocompletion=offered, help=text)


def rare(option: Any) -> Any:
    """Option that `--help` hides, for commands with `--help-all`."""
    option.hidden = True
    return option


def given(context: typer.Context) -> Mapping[str, Any]:
    """Values of the typed options and arguments, by flag (`--seed`) or by argument name."""
    return {
        next((name for name in parameter.opts if name.startswith("--")), str(parameter.name)): value
        for parameter in context.command.params
        if (value := context.params.get(str(parameter.name))) is not None
        and is_typed(context, str(parameter.name))
    }


def is_typed(context: typer.Context, name: str) -> bool:
    """Whether a parameter was typed."""
    return getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"


def is_said(context: typer.Context, name: str) -> bool:
    """Whether a parameter was typed or follows a setting."""
    return getattr(context.get_parameter_source(name), "name", "DEFAULT") != "DEFAULT"
