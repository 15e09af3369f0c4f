"""The `hexctl` command: its sub-commands, and the conversion of errors to a line and an exit code."""

import importlib
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand
from typer.exceptions import TyperException
from typer.main import get_command, get_group

from hexctl.cli.commands import COMMANDS, MODULES, Command
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
    shown,
)
from hexctl.robot.plugins import custom_failure, find_plugin, plugin_names, plugins, show_traceback


class _Loaded(Mapping[str, Any]):
    """Commands by name, each built when it is first looked up; metadata is read for an unknown name."""

    def __init__(self) -> None:
        self._built: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._built:
            self._built[name] = _build(name, self.declared(name))
        return self._built[name]

    def __contains__(self, name: object) -> bool:
        return name in COMMANDS or name in plugin_names("commands")

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*COMMANDS, *plugin_names("commands"))))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def declared(self, name: str) -> Command:
        """Group and summary of a command; raises KeyError for an unknown name."""
        if name in COMMANDS:
            return COMMANDS[name]
        offered = {one.entry.name: one.summary for one in plugins("commands")}
        return Command(None, "Plug-ins", offered[name])


class _Commands(HelpGroup):
    """The commands; each is imported when it is called, for a fast help and a fast stop."""

    commands: _Loaded  # type: ignore[assignment]  # commands are not replaced

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands, self._listing = _Loaded(), False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; for a help text only its name and summary."""
        if self._listing:
            declared = self.commands.declared(cmd_name)
            return TyperCommand(cmd_name, help=declared.summary, rich_help_panel=declared.panel)
        if cmd_name not in self.commands:
            return None
        try:
            return self.commands[cmd_name]
        except InputError:
            if not ctx.resilient_parsing:
                raise
            return TyperCommand(cmd_name)  # completes to nothing: the shell has no place for messages

    def invoke(self, ctx: Any) -> Any:
        """Run a command; an unexpected error of custom code becomes one line that names it."""
        try:
            return super().invoke(ctx)
        except (TyperException, typer.Exit, typer.Abort, BrokenPipeError):
            raise
        except Exception as error:
            show_traceback(error)
            if isinstance(error, HexctlError | MemoryError) or (text := custom_failure(error)) is None:
                raise
            raise HexctlError(text) from error

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return list(self.commands)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False


def _build(name: str, declared: Command) -> Any:
    module, found = _load(name, declared.folder)
    raise_deferred()
    app = Commands()
    if isinstance(found, typer.Typer):
        app.add_typer(found, name=name, rich_help_panel=declared.panel)
    else:
        kind = getattr(module, "COMMAND_CLASS", SettingsCommand)
        app.command(name, rich_help_panel=declared.panel, cls=kind)(found)
    built = get_group(app).commands[name]
    built.help = built.help or declared.summary
    if isinstance(found, typer.Typer):
        built.context_settings.setdefault("help_option_names", ["--help", "-h", "--help-all"])
    return built


def _load(name: str, folder: str | None) -> tuple[ModuleType, Any]:
    """Module and function of a command, or its Typer; raises InputError for a plug-in without either."""
    if folder is not None:
        module = importlib.import_module(f"hexctl.cli.{folder}.{MODULES.get(name, name)}_command")
        return module, getattr(module, name)
    plugin = find_plugin("commands", name)
    if plugin is None:
        raise InputError(f"{name}: its entry point is missing; install hexctl again")
    found = plugin.load()
    if not callable(found) or isinstance(found, type):
        raise InputError(f"{plugin}: got {shown(found)}; allowed: a function or a typer.Typer")
    return sys.modules[plugin.entry.module], found


app = Commands(
    name="hexctl",
    cls=_Commands,
    epilog="Defaults are read from hexctl.toml in the working folder or ~/.config/hexctl, such as "
    'robot = "phantomx".',
    pretty_exceptions_enable=False,
)


def _print_version(asked: bool) -> None:
    if asked:
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
