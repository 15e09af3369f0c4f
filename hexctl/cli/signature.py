"""Turns the fields of a dataclass into options of a command, and ranges and words into their parsers."""

import inspect
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial, wraps
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer

from hexctl.cli import completion
from hexctl.cli.console import FLAGS
from hexctl.errors import HexctlError, UnusedError
from hexctl.options import Option, Range, options_of


def with_options(
    spec: type, *, but: Container[str] = (), rare: Container[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of a dataclass, as a dict by field in its first argument.

    Args:
        but: fields without an option in this command.
        rare: additional rare fields of this command.
    """
    options = [
        replace(option, rare=option.rare or option.name in rare)
        for option in options_of(spec)
        if option.name not in but
    ]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        _, *own = inspect.signature(command).parameters.values()
        parameters = [
            *map(_parameter, options),
            *(one.replace(kind=one.KEYWORD_ONLY) for one in own),
            *([_HELP_ALL] if any(option.rare for option in options) else []),
        ]

        @wraps(command)
        def called(**values: Any) -> None:
            values.pop(_HELP_ALL.name, None)
            command({option.name: _frozen(values.pop(option.name)) for option in options}, **values)

        vars(called)["unused"] = partial(_unused, spec, options)
        vars(called)["__signature__"] = inspect.Signature(parameters)
        called.__annotations__ = {one.name: one.annotation for one in parameters}
        return called

    return decorate


def _unused(
    spec: type, options: Sequence[Option], values: Mapping[str, Any], said: Container[str]
) -> dict[str, Any]:
    """Defaults of unused options that settings give (`said`), by field."""
    asked = {one.name: _frozen(values[one.name]) for one in fields(spec) if one.name in values}
    defaults, usual = dict[str, Any](), {option.name: option.default for option in options}
    while True:
        try:
            built = spec(**asked | defaults)
            if hasattr(built, "check"):
                built.check()
        except UnusedError as error:
            if error.field not in said or error.field in defaults or error.field not in usual:
                return defaults  # typed: the command refuses it
            defaults[error.field] = usual[error.field]
        except (HexctlError, TypeError):
            return defaults  # another error, which the command reports
        else:
            return defaults


def _frozen(value: Any) -> Any:
    """Dataclass defaults are hashable: a list becomes a tuple."""
    return tuple(value) if isinstance(value, list) else value


def _help_all(context: typer.Context, asked: bool) -> None:
    if not asked:
        return
    for parameter in context.command.params:
        vars(parameter)["hidden"] = parameter.name == _HELP_ALL.name
    typer.echo(context.get_help())
    raise typer.Exit


_HELP_ALL = inspect.Parameter(
    "help_all",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[
        bool,
        typer.Option(
            "--help-all",
            is_eager=True,
            hidden=True,
            callback=_help_all,
            help="Show all options.",
        ),
    ],
)


def _parameter(option: Option) -> inspect.Parameter:
    kind, info = _kind_of(option)
    info.hidden, info.rich_help_panel = option.rare, option.panel or None
    if option.typed.short:
        info.param_decls = (*info.param_decls, f"-{option.typed.short}")
    FLAGS[option.name] = f"--{option.flag}"
    default = list(option.default or ()) if kind == list[str] else option.default
    return inspect.Parameter(
        option.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
    )


def _kind_of(option: Option) -> tuple[Any, Any]:
    flag, typed = f"--{option.flag}", option.typed
    kinds = get_args(option.kind) if get_origin(option.kind) in (Union, UnionType) else (option.kind,)
    if option.range is not None:
        return (int if option.range.whole else float) | None, number(flag, option.range, option.text)
    words = next((one for one in kinds if get_origin(one) is Literal), None)
    if words is not None:
        return words | None, choice(flag, words, option.text)
    if option.kind is bool:
        switch = f"{flag}/--no-{option.flag}" if option.default else flag
        return bool, typer.Option(switch, help=option.text)
    offered, text = getattr(completion, typed.words) if typed.words else None, option.text
    if offered is not None and "{}" in text:
        text = text.replace("{}", ", ".join(offered("")))
    if typed.parse is not None:
        return Any, typer.Option(
            flag, parser=_parser(typed.parse), metavar="TEXT", autocompletion=offered, help=text
        )
    if any(map(_is_texts, kinds)):
        return list[str], typer.Option(flag, autocompletion=offered, help=text)
    kind = Path if Path in kinds and not typed.words else str
    return kind | None, typer.Option(flag, autocompletion=offered, help=text)


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


def _is_texts(kind: Any) -> bool:
    """Whether a type is a sequence of texts, for an option that can be repeated."""
    items = get_args(kind)
    return get_origin(kind) is Sequence and str in (get_args(items[0]) or items)


def _parser(parse: Callable[[str], Any]) -> Callable[[Any], Any]:
    parsed = checked(parse)
    return lambda value: parsed(value) if isinstance(value, str) else value
