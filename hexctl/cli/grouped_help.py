"""Help texts: options and commands in groups, as plain text."""

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from typer.core import TyperGroup

#: A command with more options than this shows them in groups.
MOST_UNGROUPED = 8

#: Group of options without one: output and help.
LAST = "Output"

#: Maximum width of a help text, in characters.
WIDTH = 100

#: Metavariables in the help, by those of Typer.
METAVARS = {"<int>": "N", "<float>": "N", "<path>": "FILE"}


class GroupedHelp:
    """A command that shows its options in groups."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments; `--help-all` is `--help` without hidden options."""
        if args[:1] == ["--help-all"] and all(one.name != "help_all" for one in ctx.command.params):
            args = ["--help"]
        return super().parse_args(ctx, args)  # type: ignore[misc, no-any-return]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then options."""
        every = self.get_params(ctx)  # type: ignore[attr-defined]
        params = [one for one in every if not getattr(one, "hidden", False)]
        options = [one for one in params if one.param_type_name == "option"]
        arguments = [one for one in params if one not in options and one.help]
        _write(
            "Arguments", [(one.metavar or one.name.upper(), _text(one, ctx)) for one in arguments], formatter
        )
        for title, members in _grouped(options).items():
            _write(title, [(_flags(one, ctx), _text(one, ctx)) for one in members], formatter)
        if len(every) > len(params) + 1:  # --help-all
            formatter.write_paragraph()
            formatter.write_text(
                f"{len(every) - len(params) - 1} more options: {ctx.command_path} --help-all"
            )


class HelpGroup(GroupedHelp, TyperGroup):
    """A group that shows its commands in groups."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write commands, then options."""
        commands: list[Any] = [self.get_command(ctx, name) for name in self.list_commands(ctx)]
        for panel, members in groupby(commands, lambda one: str(one.rich_help_panel or "Commands")):
            _write(panel, [(one.name, _first_paragraph(one.help or "")) for one in members], formatter)
        super().format_options(ctx, formatter)


def _write(title: str, rows: Iterable[tuple[str, str]], formatter: Any) -> None:
    rows = list(rows)
    if rows:
        with formatter.section(title):
            formatter.write_dl(rows)


def _first_paragraph(text: str) -> str:
    return text.partition("\n\n")[0]


def _grouped(options: Sequence[Any]) -> dict[str, list[Any]]:
    """Options by group, in the order of their first options; output is last."""
    if len(options) - 1 <= MOST_UNGROUPED:  # without --help
        return {"Options": list(options)}
    groups: dict[str, list[Any]] = {}
    for option in options:
        groups.setdefault(str(option.rich_help_panel or LAST), []).append(option)
    return {**{title: groups[title] for title in groups if title != LAST}, LAST: groups[LAST]}


def _flags(option: Any, ctx: Any) -> str:
    names = sorted(option.opts, key=lambda name: not name.startswith("--"))  # those of --help have no order
    flags = ", ".join((*names, *option.secondary_opts))
    metavar = option.metavar
    if metavar is None:
        metavar = "" if option.is_flag else METAVARS.get(option.display_type_rich(ctx=ctx), "TEXT")
    return f"{flags} {metavar}".rstrip()


def _text(param: Any, ctx: Any) -> str:
    """Help of a parameter, with its default unless the text has it."""
    text, default = param.help or "", param.get_default(ctx, call=False)
    if not isinstance(default, str | float | int) or default is False or not text or "(default: " in text:
        return str(text)
    return f"{text} (default: {f'{default:g}' if isinstance(default, float) else default})"
