"""The `hexctl` command: its sub-commands, and the conversion of errors to a line and an exit code."""

import importlib
import os
import sys
from collections import UserDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.exceptions import TyperException
from typer.main import get_command, get_group

from hexctl.cli.console import BAD_INPUT, FAULT, INTERRUPTED, discard_stdout, in_flags, print_note
from hexctl.cli.grouped_help import HelpGroup
from hexctl.cli.interrupts import not_begun, raise_deferred
from hexctl.cli.network.early_stop import COMPLETION
from hexctl.cli.settings import Commands, SettingsCommand, has_begun, origin_of
from hexctl.cli.suggestions import usage_text
from hexctl.errors import (
    EXTRAS,
    HexctlError,
    InputError,
    LimitError,
    MissingExtraError,
    ReachError,
    is_of_disk,
    printable,
    room_hint,
    shortened,
)


@dataclass(frozen=True, slots=True)
class Command:
    """A command as the help lists it, and the folder of its module."""

    folder: str
    panel: str
    summary: str


#: Commands by group and in the order of the help: folder in `hexctl.cli`, and summary.
GROUPS = {
    "Walk and adapt": {
        "run": ("walk", "Walk, record the walk, and report the result."),
        "adapt": ("walk", "Find a gait for a failed leg in few trials; each is kept and recorded."),
        "drive": ("walk", "Drive a robot by hand: keyboard, gamepad, or a page for a phone."),
        "view": (
            "results",
            "Open recordings or sessions in the Rerun viewer until it is closed, or watch a robot.",
        ),
        "demo": ("walk", "Break a leg of a simulated robot in mid-walk, and see it recover."),
        "sessions": ("results", "List, compare and delete sessions of hexctl adapt."),
        "export": ("results", "Write a robot, recordings or a session in a format of other programs."),
    },
    "Your robot": {
        "check": (
            "robot",
            "Check whether a robot can walk a gait: reach, angles, speeds, torques and servo pulses.",
        ),
        "robot": ("robot", "List the shipped robots, and make robot files."),
        "gaits": ("robot", "List the named gaits."),
        "worlds": ("robot", "List the shipped simulated worlds."),
        "diagnose": ("walk", "Find which leg and joint failed, and how, in 12 s of small motions at rest."),
        "identify": (
            "robot",
            "Find stiffness, damping, rotor inertia, friction and dead time of a robot's servos.",
        ),
        "see": (
            "network",
            "Measure a robot's position with a camera and printed tags, and send it to the robot, "
            "until Ctrl-C.",
        ),
        "calibrate": (
            "bus",
            "Find direction, offset and limits of each servo, and write them to the robot file.",
        ),
        "ports": ("bus", "List serial ports with a device, and their adapters."),
        "doctor": ("robot", "Report what this computer has and what works on it, for a bug report."),
        "servos": (
            "bus",
            "Scan, identify and set up the servos of a serial bus, with or without a robot file.",
        ),
        "sim": ("network", "Simulate servo boards, servo buses and a camera, and let simulated legs fail."),
    },
    "Over the network": {
        "serve": (
            "network",
            "Serve a robot, real or simulated, on the network, with its own guard and stop.",
        ),
        "status": (
            "network",
            "Show who commands a robot on the network, why it is stopped, and which messages were dropped.",
        ),
        "estop": ("network", "Stop a robot on the network from anywhere, whichever client commands it."),
        "keys": ("network", "Make and show certificates for robots beyond this computer."),
    },
    "Simulate a lot": {
        "study": (
            "study",
            "Repeat the paper's experiments: all gaits of each failed leg, all optimizers, one report.",
        ),
        "prior": ("study", "Make and show priors: what hexctl adapt believes before its first trial."),
    },
}

COMMANDS = {
    name: Command(folder, panel, summary)
    for panel, commands in GROUPS.items()
    for name, (folder, summary) in commands.items()
}

#: Commands in the module of another one.
MODULES = {"gaits": "robot", "worlds": "robot"}


class _Loaded(UserDict[str, Any]):
    """Commands by name, each built from its declaration when it is first looked up."""

    def __getitem__(self, name: str) -> Any:
        found = super().__getitem__(name)
        if isinstance(found, Command):
            found = self[name] = _build(name, found)
        return found


class _Commands(HelpGroup):
    """The commands; each is imported when it is called, for a fast help and a fast stop."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands, self._listing = _Loaded(COMMANDS), False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a help text only its name and summary."""
        if cmd_name not in COMMANDS:
            return None
        if not self._listing:
            return self.commands[cmd_name]
        declared = COMMANDS[cmd_name]
        return TyperCommand(cmd_name, help=declared.summary, rich_help_panel=declared.panel)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(COMMANDS)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def _build(name: str, declared: Command) -> Any:
    module = importlib.import_module(f"hexctl.cli.{declared.folder}.{MODULES.get(name, name)}_command")
    raise_deferred()
    found, app = getattr(module, name), Commands()
    if isinstance(found, typer.Typer):
        own: dict[str, Any] = {} if found.registered_callback else {"help": declared.summary}
        app.add_typer(found, name=name, rich_help_panel=declared.panel, **own)
    else:
        kind = getattr(module, "COMMAND_CLASS", SettingsCommand)
        app.command(name, rich_help_panel=declared.panel, cls=kind)(found)
    return get_group(app).commands[name]


app = Commands(
    name="hexctl",
    cls=_Commands,
    epilog="Defaults are read from hexctl.toml in the working folder or ~/.config/hexctl, such as "
    'robot = "phantomx".',
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"hexctl {version('hexctl')}")
        raise typer.Exit


@app.callback()
def every_command(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version),
    ] = False,
) -> None:
    """Walk a six-legged robot, simulated or real, at 50 Hz."""


def exit_code(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; `help run` is `run --help`."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    if given[:1] == ["help"]:
        given = [*given[1:], "--help"]
    command, context = get_command(app), None
    if os.environ.get(COMPLETION):
        command.main(args=given, prog_name="hexctl")  # which ends the process
    try:  # not by main(), which would end an interrupted command silently
        with command.make_context("hexctl", given) as context:
            code = command.invoke(context)
    except typer.Exit as error:
        return error.exit_code
    except typer.BadParameter as error:
        return _print_error(_bad_value(error), BAD_INPUT)
    except TyperException as error:
        return _print_error(usage_text(error), error.exit_code)
    except (InputError, LimitError, ReachError, MissingExtraError) as error:
        return _print_error(_worded(error), FAULT if is_of_disk(error.__cause__) else BAD_INPUT)
    except HexctlError as error:
        return _print_error(_worded(error), FAULT)
    except BrokenPipeError:
        discard_stdout()
        return 1
    except OSError as error:
        if not isinstance(error.filename, str | bytes) and not is_of_disk(error):
            raise
        place = os.fsdecode(error.filename or "output")
        text = f"{place}: {error.strerror}{room_hint(error)}"
        return _print_error(text, FAULT if is_of_disk(error) else BAD_INPUT)
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        return _print_error(str(MissingExtraError("this", extra)), BAD_INPUT)
    except (ImportError, MemoryError, RuntimeError) as error:
        if (why := _worded_end(error)) is None:
            raise
        return _print_error(why, FAULT)
    except UnicodeEncodeError as error:
        if printable(error.object) == error.object:
            raise
        return _print_error(f"file: got {error.object!r}; allowed: a name in UTF-8; rename it", BAD_INPUT)
    except KeyboardInterrupt:
        began = context is not None and has_begun(context)
        return _print_error("interrupted" if began else not_begun(given), INTERRUPTED)
    return code if isinstance(code, int) else 0


#: Words of errors if the memory is low.
OF_MEMORY = ("start new thread", "failed to map", "Cannot allocate memory")


def _worded_end(error: Exception) -> str | None:
    """Text of an error of low memory, or of a library that cannot be loaded; None for another one."""
    if isinstance(error, MemoryError) or any(words in str(error) for words in OF_MEMORY):
        return f"not enough memory{f' ({error})' if str(error) else ''}; end other programs, or do less here"
    if not isinstance(error, ImportError):
        return None
    library, missing, _ = str(error).partition(": cannot open shared object file")
    step = f"install {library} with your system's packages" if missing else "install hexctl again"
    return f"{error.name or 'a library'} cannot be loaded ({error}); {step}"


def _worded(error: HexctlError) -> str:
    """Text of an error, with the next step on a full disk unless it names one."""
    text = in_flags(error)
    return text if "; free some space" in text else f"{text}{room_hint(error.__cause__)}"


#: Commands that list the values of an argument, by its name in the help text.
LISTED_BY = {"SESSION": "hexctl sessions list"}


def _bad_value(error: typer.BadParameter) -> str:
    if (origin := origin_of(error)) is not None:
        return f"{origin}: {error.message}"
    if error.param is not None and not error.message and error.param.metavar in LISTED_BY:
        return f"{error.format_message().rstrip('.')}; {LISTED_BY[error.param.metavar]} prints the names"
    if error.param is not None and not error.message and error.ctx is not None:
        return f"{error.format_message().rstrip('.')}; {error.ctx.get_usage().replace('Usage', 'usage')}"
    if error.param is None or "; allowed: " not in error.message:
        return error.format_message()
    flag = next((name for name in error.param.opts if name.startswith("--")), error.param.name)
    return f"{flag}: {error.message}"


def _print_error(message: str, code: int) -> int:
    """Errors are one line, a help text is printed as it is; returns the exit code."""
    if not message.strip():
        return code
    text = (
        message if message.lstrip().startswith("Usage") else f"hexctl: {shortened(' '.join(message.split()))}"
    )
    print_note(text)
    return code
