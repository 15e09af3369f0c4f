"""Suggestions in messages about an invalid command line."""

import re
from pathlib import Path
from typing import Any

from typer.exceptions import TyperException

from hexctl.cli import completion
from hexctl.typed_names import nearest_name

#: Commands of the program or of a group, by common synonyms.
SYNONYMS = {
    "walk": "run",
    "simulate": "run",
    "board": "sim board",
    "twin": "sim",
    "gait": "gaits",
    "world": "worlds",
    "search": "adapt",
    "learn": "adapt",
    "train": "adapt",
    "teleop": "drive",
    "control": "drive",
    "stop": "estop",
    "kill": "estop",
    "server": "serve",
    "ros": "serve --ros",
    "open": "view",
    "replay": "view",
    "convert": "export",
    "import": "robot import",
    "camera": "see",
    "scan": "servos scan",
    "ls": "list",
    "rm": "delete",
    "remove": "delete",
    "new": "copy",
}

_NO_COMMAND = re.compile(r"No such command '(.*)'")
_EXTRA = re.compile(r"Got unexpected extra argument")


def usage_text(error: TyperException) -> str:
    """Message about an invalid command line, with a suggestion."""
    context: Any = getattr(error, "ctx", None)
    flag = getattr(error, "option_name", None)
    if context is not None and flag is not None:
        return _option_text(error, flag, context)
    text: str = error.format_message()
    if (found := _NO_COMMAND.match(text)) is not None:
        meant = SYNONYMS.get(found[1].lower(), "")
        known = meant.split(" ")[0] in getattr(context.command, "commands", ())
        return f"{text} Did you mean {meant!r}?" if known and "did you mean" not in text.lower() else text
    if _EXTRA.match(text):
        return text + _as_option(context, text.rpartition("(")[2].rstrip(")"))
    return text


def _option_text(error: TyperException, flag: str, context: Any) -> str:
    """Message about an unknown option, or about the value of one."""
    every = any(param.name == "help_all" for param in context.command.params)
    listed = f"{context.command_path} --help{'-all' if every else ''}"
    if hasattr(error, "possibilities"):
        # The dashes do not count: all flags have them.
        near = nearest_name(flag.lstrip("-"), [each.lstrip("-") for each in error.possibilities or ()])
        near = near or _of_words(flag, context)
        next_step = f"{listed} lists the options" if near is None else f"did you mean --{near}?"
        return f"{error.message}; {next_step}"
    wanted = "got no value" if "requires" in error.message else "got a value; allowed: without one"
    return f"{flag}: {wanted}; {listed} describes it"


def _of_words(flag: str, context: Any) -> str | None:
    """An option of a command with only words of a flag: `legs` for `--failed-leg`."""
    asked = _words(flag)
    flags = (flag for param in context.command.params if not param.hidden for flag in param.opts)
    return next((each.lstrip("-") for each in flags if each[:2] == "--" and _words(each) <= asked), None)


def _words(flag: str) -> set[str]:
    return {word.removesuffix("s") for word in flag.strip("-").split("-")}


def _as_option(context: Any, extra: str) -> str:
    """The option of a command that takes a positional argument as its value; empty for none."""
    flags = {flag for param in context.command.params for flag in param.opts}
    name = extra.split(" ")[0]
    if "--robot" in flags and (name in completion.robots("") or Path(name).suffix in (".yaml", ".yml")):
        return f"; did you mean --robot {name}?"
    if "--gait" in flags and (name in completion.gaits("") or name.isdecimal()):
        return f"; did you mean --gait {name}?"
    return ""
