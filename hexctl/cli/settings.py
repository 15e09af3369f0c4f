"""Settings as defaults of options: `hexctl.toml` and `HEXCTL_*`.

A setting is parsed and checked like a typed option. Light to import: `hexctl --help` needs it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup
from typer.exceptions import TyperException

from hexctl.cli.commands import COMMANDS as LISTED
from hexctl.cli.console import in_flags, print_message
from hexctl.cli.grouped_help import WIDTH, GroupedHelp, HelpGroup
from hexctl.errors import InputError, shown
from hexctl.robot.plugins import plugin_names
from hexctl.typed_names import nearest

if TYPE_CHECKING:
    from hexctl.settings import OptionPath, Setting, Settings

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

#: Options that must be typed: consent, the end of a stop, unprotected links.
TYPED_ONLY = ("yes", "clear", "ready", "insecure", "ros-drive", "trust", "help-all")

#: Options whose value may be importable code, as `module:Name`.
CODE_OPTIONS = ("backend", "recovery", "optimizer", "objective", "optimizers", "methods")

#: Commands that work even with invalid settings, and report them.
UNSTOPPABLE = (("estop",), ("doctor",))

#: Commands that follow each setting of robot and connection; None: all with the option.
FOLLOWERS: Mapping[str, tuple[tuple[str, ...], ...] | None] = {
    "robot": (
        *(("run",), ("adapt",), ("drive",), ("diagnose",), ("serve",), ("sim", "board"), ("check",)),
        *(("identify",), ("prior", "build")),
    ),
    "backend": (("run",), ("adapt",), ("drive",), ("diagnose",), ("identify",), ("serve",)),
    "world": (("run",), ("adapt",), ("drive",), ("diagnose",), ("serve",)),
    "listen": None,
    "connect": None,
    "port": None,
    "link": None,
    "keys": None,
}

#: Key of a context's `meta` with its settings, by parameter.
_ORIGINS = "hexctl.settings.origins"

#: Key that is there once a command, not only its group, was called.
_BEGUN = "hexctl.begun"


class _FollowsSettings:
    """A command whose omitted options follow the settings."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        text = more.get("help")
        super().__init__(*arguments, **{**more, "help": text if text is None else _unwrapped(text)})

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments with settings as defaults, except for a help text, a completion or a group."""
        if not ctx.resilient_parsing:
            typed, rest, order = self._parsed(ctx, args)
            if _path(ctx) not in UNSTOPPABLE:
                _check_once(order)
            alone = not (rest and isinstance(self, TyperGroup))
            if alone and not (typed.get("help") or typed.get("help_all")):
                said = _said(ctx, {name: value for name, value in typed.items() if value is not None})
                ctx.meta[_ORIGINS] = {name: setting for name, (setting, _) in said.items()}
                ctx.default_map = {name: value for name, (_, value) in said.items()}
        rest = super().parse_args(ctx, args)  # type: ignore[misc]
        _drop_unused(ctx)
        return rest  # type: ignore[no-any-return]

    def _parsed(self, ctx: Any, args: list[str]) -> Any:
        try:
            return self.make_parser(ctx).parse_args(args=list(args))  # type: ignore[attr-defined]
        except TyperException as error:
            vars(error)["ctx"] = ctx  # the message names the command
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run the command; report the settings in use, and name their place in errors about them."""
        if not isinstance(self, TyperGroup):
            ctx.meta[_BEGUN] = True
        origins = ctx.meta.get(_ORIGINS, {})
        for place, options in _by_place(ctx, origins).items():
            print_message(f"{place} sets {', '.join(options)}")
        try:
            return super().invoke(ctx)  # type: ignore[misc]
        except InputError as error:
            text = _with_origin(in_flags(error), ctx, origins)
            if text is None:
                raise
            raise InputError(text) from error.__cause__


class SettingsCommand(GroupedHelp, _FollowsSettings, TyperCommand):
    """A command that follows the settings."""


class SettingsGroup(_FollowsSettings, HelpGroup):
    """A group of commands whose options follow the settings."""


#: Width of help texts, and their options.
_CONTEXT = {"max_content_width": WIDTH, "help_option_names": ["--help", "-h"]}


class Commands(typer.Typer):
    """A group of commands that follow the settings."""

    def __init__(self, **more: Any) -> None:
        """Make a group with plain help texts, because boxes would import more."""
        more.setdefault("cls", HelpGroup)
        super().__init__(rich_markup_mode=None, context_settings=_CONTEXT, no_args_is_help=True, **more)

    def command(self, *arguments: Any, **more: Any) -> Callable[[FunctionT], FunctionT]:
        """Register a command, as Typer does."""
        more.setdefault("cls", SettingsCommand)
        return super().command(*arguments, **more)


def _unwrapped(text: str) -> str:
    """One line per paragraph: Typer would wrap wrapped lines again."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in cleandoc(text).split("\n\n"))


def has_begun(context: Any) -> bool:
    """Whether the command of a context, or of one below it, was called."""
    return _BEGUN in context.meta


def origin_of(error: typer.BadParameter) -> "Setting | None":
    """The setting that an error is about; None for a typed value."""
    origins = {} if error.ctx is None else error.ctx.meta.get(_ORIGINS, {})
    return None if error.param is None else origins.get(error.param.name)


def runs_folder() -> Path:
    """Folder of recordings, sessions, priors and studies: `runs` by default."""
    from hexctl.settings import find_settings

    return find_settings().runs


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


def _said(ctx: Any, typed: Mapping[str, Any]) -> "dict[str, tuple[Setting, Any]]":
    """Typed values of settings that a command follows; raises InputError unless in `UNSTOPPABLE`."""
    from hexctl.settings import find_settings

    path, settings = _path(ctx), find_settings()
    problems = [*settings.problems, *_problems(ctx.find_root().command, settings, "".join(path[:1]))]
    said: dict[str, tuple[Setting, Any]] = {}
    params = {param.name: param for param in ctx.command.params}
    for name, setting in _Following(ctx, path, settings, typed).settings().items():
        try:
            value = _as_typed(params[name], setting)
            _check_no_code(_flag(params[name]), setting)
            said[name] = setting, value
        except InputError as error:
            problems.append(str(error))
    if problems and path not in UNSTOPPABLE:
        raise InputError(problems[0])
    for problem in dict.fromkeys(problems):
        print_message(problem)
    return said


def _check_once(typed: Sequence[Any]) -> None:
    """Raise InputError for an option with one value that is typed twice; flags may repeat."""
    for param in typed:
        single = param.param_type_name == "option" and not (param.multiple or param.is_flag)
        if single and typed.count(param) > 1:
            several = ", several values with commas" if "with commas" in (param.help or "") else ""
            raise InputError(f"--{_flag(param)}: typed {typed.count(param)} times; allowed: once{several}")


def _drop_unused(ctx: Any) -> None:
    """Drop settings that the typed options make unused: in a file they do no harm."""
    origins, unused = ctx.meta.get(_ORIGINS), getattr(ctx.command.callback, "unused", None)
    for name, default in unused(ctx.params, origins).items() if origins and unused else ():
        ctx.params[name] = default
        ctx.set_parameter_source(name, type(ctx.get_parameter_source(name)).DEFAULT)
        del origins[name]


def _path(ctx: Any) -> tuple[str, ...]:
    return () if ctx.parent is None else (*_path(ctx.parent), ctx.info_name)


class _Following:
    """Selects the settings that one call of a command follows."""

    def __init__(
        self, ctx: Any, path: tuple[str, ...], settings: "Settings", typed: Mapping[str, Any]
    ) -> None:
        self._path, self._settings, self._typed = path, settings, typed
        self._options = {_flag(param): param for param in ctx.command.params if _flag(param)}
        self._found: dict[str, Setting] = {}

    def settings(self) -> "dict[str, Setting]":
        if "resume" in self._typed:  # a session keeps its settings
            return {}
        # The use of other options depends on these, in this order.
        first = [option for option in ("backend", "link", "connect", "listen") if option in self._options]
        for option in dict.fromkeys((*first, *self._options)):
            if self._options[option].name in self._typed or option in TYPED_ONLY:
                continue
            setting = self._setting(option)
            if setting is not None:
                self._found[option] = setting
        return {self._options[option].name: setting for option, setting in self._found.items()}

    def _setting(self, option: str) -> "Setting | None":
        common = [(option,)] if self._follows(option) else []
        return self._settings.find((*self._path, option), *common)

    def _follows(self, option: str) -> bool:
        """Whether an option follows the setting of robot and connection of its name.

        That is if it has a use with the values typed and found so far.
        """
        if option not in FOLLOWERS or self._path not in (FOLLOWERS[option] or (self._path,)):
            return False
        if option == "robot":
            return "robot_name" not in self._typed
        if option == "backend":
            return self._path != ("serve",) or self._any("backend") != "zenoh"
        if option == "world":
            return True  # dropped if the backend has none
        if option == "port":
            return self._path != ("sim", "board") and ":" not in str(self._backend)
        served = self._backend in (None, "zenoh") or self._path == ("serve",)
        return served and self._link_follows(option)

    def _link_follows(self, option: str) -> bool:
        typed = {"connect", "listen", "link"} & self._typed.keys()
        if self._path == ("sim", "board") or self._typed.get("no_link"):
            return False
        if self._path == ("view",) and not typed:
            return False  # recordings are viewed
        if option != "keys":
            return not typed
        place = self._value("listen") if self._path == ("serve",) else self._value("connect")
        return self._value("link") is not None or str(place).startswith(("tls/", "quic/"))

    @property
    def _backend(self) -> str | None:
        if "backend" not in self._options:
            return None
        return str(self._value("backend") or self._options["backend"].default or "sim").lower()

    def _value(self, option: str) -> Any:
        if option in self._found:
            return self._found[option].value
        return self._typed.get(self._options[option].name) if option in self._options else None

    def _any(self, common: str) -> Any:
        setting = self._settings.find((common,))
        return None if setting is None else setting.value


def _problems(root: Any, settings: "Settings", running: str) -> Iterator[str]:
    """A line for each key of a file, and each variable of a command, that matches no option.

    A plug-in other than the running command is not imported, because a stop must not depend on it.
    """
    from hexctl.settings import COMMANDS, Setting

    for name, text in settings.variables.items():
        if _is_plugin(_words(name)[0], running):
            continue
        command, path = _meant(root, name)
        if command is not root and (problem := _problem(root, path, Setting(text, name))) is not None:
            yield problem
    for file in settings.files:
        for path, setting in file.items():
            if _is_plugin(path[1 if path[0] == COMMANDS and len(path) > 1 else 0], running):
                continue
            if (problem := _problem(root, path, setting)) is not None:
                yield problem


def _problem(root: Any, path: "OptionPath", setting: "Setting") -> str | None:
    """Problem of a setting that matches no option, or None."""
    from hexctl.settings import COMMANDS, COMMON

    around = 1 if path[0] == COMMANDS and len(path) > 1 else 0
    command, depth = _command(root, path[around:])
    depth += around
    below = getattr(command, "commands", {})
    options = _flags(command)
    if command is root and not around:
        options = list(COMMON)
    key, more = path[depth], len(path) - depth - 1
    origin = f"{setting.place}: {setting.key.rsplit('.', more)[0]}" if more else str(setting)
    if key in TYPED_ONLY and depth:
        return f"{origin}: got {shown(setting.value)}; allowed: only typed, as --{key}"
    if key in options:
        return f"{origin}: got a table; allowed: one value" if more else None
    if key in below:
        table = ".".join(path)
        return f"{origin}: got {shown(setting.value)}; allowed: a table [{table}] of the command's options"
    known = [*options, *below]
    what = "setting or command" if not depth else "option" if options else "command"
    hint = nearest(key, known) or ("" if depth else _owner_hint(below, key))
    return f"{origin}: unknown {what}; allowed: {', '.join(dict.fromkeys(known))}{hint}"


def _owner_hint(commands: Mapping[str, Any], key: str) -> str:
    owner = next((name for name in commands if key in _flags(commands[name])), None)
    return "" if owner is None else f"; an option of a command stands in its table, such as [{owner}]"


def _command(root: Any, path: "OptionPath") -> tuple[Any, int]:
    """The command named by the first words of a path, and the number of these words."""
    command, depth = root, 0
    while depth < len(path) - 1 and path[depth] in getattr(command, "commands", {}):
        command, depth = command.commands[path[depth]], depth + 1
    return command, depth


def is_option(root: Any, variable: str) -> bool:
    """Whether a variable such as `HEXCTL_RUN_SEED` is an option that may be a setting, or of a plug-in."""
    if _is_plugin(_words(variable)[0]):
        return True
    command, path = _meant(root, variable)
    return command is not root and path[-1] in _flags(command) and path[-1] not in TYPED_ONLY


def _meant(root: Any, variable: str) -> "tuple[Any, OptionPath]":
    """The command of a variable, the root for none, and the path of its option."""
    words = _words(variable)
    command, depth = _command(root, words)
    return command, (*words[:depth], "-".join(words[depth:]))


def _words(variable: str) -> tuple[str, ...]:
    from hexctl.settings import PREFIX

    return tuple(variable.removeprefix(PREFIX).lower().split("_"))


def _is_plugin(name: str, running: str = "") -> bool:
    """Whether a command is behind an entry point, and not the running one."""
    if name in LISTED:
        return LISTED[name].folder is None and name != running
    return name != running and name in plugin_names("commands")


def _flags(command: Any) -> list[str]:
    return [flag for param in command.params if (flag := _flag(param))]


def _flag(param: Any) -> str:
    return next((name[2:] for name in param.opts if name.startswith("--")), "")


def _check_no_code(option: str, setting: "Setting") -> None:
    """Refuse code in a file of the working folder, which may be another person's."""
    if setting.nearby and option in CODE_OPTIONS and ":" in str(setting.value):
        raise InputError(
            f"{setting}: got {shown(setting.value)}, code to be imported; allowed here: names that "
            f"hexctl ships; if you trust it, type --{option}, or set it in ~/.config/hexctl/hexctl.toml"
        )


def _as_typed(param: Any, setting: "Setting") -> Any:
    """Value of a setting in the form of the command line; raises InputError for another type."""
    value = setting.value
    if param.is_flag:
        return _switched(setting)
    if param.multiple:
        texts = value.split() if setting.is_variable else value if isinstance(value, list) else [value]
        return [_one_text(param, setting, one) for one in texts]
    if isinstance(value, list):
        return ",".join(_one_text(param, setting, one) for one in value)
    return _one_text(param, setting, value)


def _switched(setting: "Setting") -> bool:
    words = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    value = setting.value
    if setting.is_variable and str(value).lower() in words:
        return words[str(value).lower()]
    if isinstance(value, bool):
        return value
    raise InputError(f"{setting}: got {shown(value)}; allowed: true, false")


def _one_text(param: Any, setting: "Setting", value: Any) -> str:
    """A relative path starts at the file's folder."""
    from hexctl.settings import is_path

    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise InputError(f"{setting}: got {shown(value)}; allowed: text or a number")
    text = str(value)
    relative = param.type_descriptor.annotation is Path or text.startswith(("./", "../", "~/"))
    starts_there = isinstance(value, str) and (relative or is_path(_flag(param), text))
    return setting.path_of(text) if starts_there else text


def _by_place(ctx: Any, origins: "Mapping[str, Setting]") -> dict[str, list[str]]:
    """Options that follow settings, as typed, by file or variable."""
    lines: dict[str, list[str]] = {}
    for param in ctx.command.params:
        if (origin := origins.get(param.name)) is not None:
            value = ctx.default_map[param.name]
            texts = value if isinstance(value, list) else [value]
            flag = f"--{_flag(param)}"
            switched = {True: [flag], False: param.secondary_opts}
            for one in texts:
                said = switched[one] if isinstance(one, bool) else [f"{flag} {one}"]
                lines.setdefault(origin.place, []).extend(said)
    return {place: options for place, options in lines.items() if options}


def _with_origin(text: str, ctx: Any, origins: "Mapping[str, Setting]") -> str | None:
    """Text of an error with the place of its setting; None if it is about none."""
    for param in ctx.command.params:
        origin = origins.get(param.name)
        for beginning in (f"--{_flag(param)}: ", f"{_flag(param)}: "):
            if origin is not None and text.startswith(beginning):
                return f"{origin}: {text.removeprefix(beginning)}"
    return None
