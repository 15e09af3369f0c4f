"""Commands whose modules are imported when they are called, for a fast help and a fast stop."""

import importlib
from collections import UserDict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_group

from hexctl.cli.grouped_help import HelpGroup
from hexctl.cli.interrupts import raise_deferred
from hexctl.cli.settings import Commands


@dataclass(frozen=True, slots=True)
class Command:
    """A command as the help lists it: its module below `hexctl.cli`, and its class if special."""

    module: str
    panel: str
    summary: str
    kind: str = ""


class _Loaded(UserDict[str, Any]):
    """Commands by name, each built from its declaration when it is first looked up."""

    def __getitem__(self, name: str) -> Any:
        found = super().__getitem__(name)
        if isinstance(found, Command):
            found = self[name] = _build(name, found)
        return found


class LazyCommands(HelpGroup):
    """A group that imports the module of a command when the command is called."""

    def __init__(self, declared: Mapping[str, Command], **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _Loaded(declared)
        self._declared, self._listing = declared, False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a help text only its name and summary."""
        if cmd_name not in self._declared:
            return None
        if not self._listing:
            return self.commands[cmd_name]
        declared = self._declared[cmd_name]
        return TyperCommand(cmd_name, help=declared.summary, rich_help_panel=declared.panel)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(self._declared)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def _build(name: str, declared: Command) -> Any:
    module = importlib.import_module(f"hexctl.cli.{declared.module}")
    raise_deferred()
    found, app = getattr(module, name), Commands()
    if isinstance(found, typer.Typer):
        own: dict[str, Any] = {} if found.registered_callback else {"help": declared.summary}
        app.add_typer(found, name=name, rich_help_panel=declared.panel, **own)
    else:
        kind = getattr(module, declared.kind) if declared.kind else None
        app.command(name, rich_help_panel=declared.panel, **({"cls": kind} if kind else {}))(found)
    return get_group(app).commands[name]
