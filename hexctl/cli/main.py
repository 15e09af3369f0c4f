"""The `hexctl` command: its sub-commands, and how errors become a line and an exit code."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.exceptions import TyperException

from hexctl.cli.bus.board import board
from hexctl.cli.bus.calibrate import calibrate
from hexctl.cli.bus.servos import ports, servos
from hexctl.cli.check import check
from hexctl.cli.console import BAD_INPUT, FAULT, INTERRUPTED, in_flags, print_note
from hexctl.cli.doctor import doctor
from hexctl.cli.network.estop import estop
from hexctl.cli.network.keys import keys
from hexctl.cli.network.serve import ServeCommand, serve
from hexctl.cli.network.status import status
from hexctl.cli.network.twin import twin
from hexctl.cli.results.export import export
from hexctl.cli.results.sessions import sessions
from hexctl.cli.results.view import view
from hexctl.cli.robot import robot
from hexctl.cli.see.group import see
from hexctl.cli.settings import Commands, origin_of
from hexctl.cli.study.prior import prior
from hexctl.cli.study.study import study
from hexctl.cli.walk.adapt import adapt
from hexctl.cli.walk.demo import demo
from hexctl.cli.walk.diagnose import diagnose
from hexctl.cli.walk.drive import drive
from hexctl.cli.walk.run import run
from hexctl.errors import (
    EXTRAS,
    HexctlError,
    InputError,
    LimitError,
    MissingExtraError,
    ReachError,
    is_of_disk,
    shortened,
)


class _CutOffError(Exception):
    """Ctrl-C during a command that does not handle it."""


@contextmanager
def _cut_off() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise _CutOffError from None


class _Commands(TyperGroup):
    """The commands; an interrupt of one passes through Typer, which would end it without a word."""

    def make_context(self, *arguments: Any, **more: Any) -> Any:
        with _cut_off():
            return super().make_context(*arguments, **more)

    def invoke(self, ctx: Any) -> Any:
        with _cut_off():
            return super().invoke(ctx)


app = Commands(
    name="hexctl",
    cls=_Commands,
    help="Walk a six-legged robot, simulated or real, at 50 Hz.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
WALK, ROBOT, NETWORK, STUDY = "Walk and adapt", "Your robot", "Over the network", "Simulate a lot"

app.command(rich_help_panel=WALK)(run)
app.command(rich_help_panel=WALK)(adapt)
app.command(rich_help_panel=WALK)(drive)
app.command(rich_help_panel=WALK)(view)
app.command(rich_help_panel=WALK)(demo)
app.add_typer(sessions, name="sessions", rich_help_panel=WALK)
app.command(rich_help_panel=WALK)(export)
app.command(rich_help_panel=ROBOT)(check)
app.add_typer(robot, name="robot", rich_help_panel=ROBOT)
app.command(rich_help_panel=ROBOT)(diagnose)
app.add_typer(see, name="see", rich_help_panel=ROBOT)
app.command(rich_help_panel=ROBOT)(calibrate)
app.command(rich_help_panel=ROBOT)(board)
app.command(rich_help_panel=ROBOT)(ports)
app.command(rich_help_panel=ROBOT)(doctor)
app.add_typer(servos, name="servos", rich_help_panel=ROBOT)
app.command(rich_help_panel=NETWORK, cls=ServeCommand)(serve)
app.command(rich_help_panel=NETWORK)(status)
app.command(rich_help_panel=NETWORK)(estop)
app.add_typer(twin, name="twin", rich_help_panel=NETWORK)
app.add_typer(keys, name="keys", rich_help_panel=NETWORK)
app.command(rich_help_panel=STUDY)(study)
app.add_typer(prior, name="prior", rich_help_panel=STUDY)


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
    """Run the command line and return its exit code."""
    try:
        code = app(args=arguments, prog_name="hexctl", standalone_mode=False)
    except typer.BadParameter as error:
        return _print_error(_bad_value(error), BAD_INPUT)
    except TyperException as error:
        if near := getattr(error, "possibilities", None):
            vars(error)["possibilities"] = near[:1]  # best first, where the message would sort them by name
        return _print_error(error.format_message(), error.exit_code)
    except (InputError, LimitError, ReachError, MissingExtraError) as error:
        return _print_error(in_flags(error), FAULT if is_of_disk(error.__cause__) else BAD_INPUT)
    except HexctlError as error:
        return _print_error(in_flags(error), FAULT)
    except OSError as error:
        if not isinstance(error.filename, str | bytes):
            raise
        text = f"{os.fsdecode(error.filename)}: {error.strerror}"
        return _print_error(text, FAULT if is_of_disk(error) else BAD_INPUT)
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        return _print_error(str(MissingExtraError("this", extra)), BAD_INPUT)
    except (KeyboardInterrupt, _CutOffError):
        return _print_error("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


#: Commands that print what an argument may be, by its name in the help text.
LISTED_BY = dict.fromkeys(("SESSION", "SESSION SESSION..."), "hexctl sessions list")


def _bad_value(error: typer.BadParameter) -> str:
    """Message about a value that is not allowed: which option or argument, what it got, what is allowed."""
    if (origin := origin_of(error)) is not None:
        return f"{origin}: {error.message}"
    if error.param is not None and not error.message and error.param.metavar in LISTED_BY:
        return f"{error.format_message().rstrip('.')}; {LISTED_BY[error.param.metavar]} prints the names"
    if error.param is None or "; allowed: " not in error.message:
        return error.format_message()
    flag = next((name for name in error.param.opts if name.startswith("--")), error.param.name)
    return f"{flag}: {error.message}"


def _print_error(message: str, code: int) -> int:
    """Print an error as one line, a help text as it is; the exit code."""
    if not message.strip():
        return code
    text = (
        message if message.lstrip().startswith("Usage") else f"hexctl: {shortened(' '.join(message.split()))}"
    )
    print_note(text)
    return code
