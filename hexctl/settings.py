"""Settings: defaults from files `hexctl.toml` and variables `HEXCTL_*`.

    robot = "lab.yaml"
    backend = "zenoh"
    connect = "tls/hexapod.local:7447"
    keys = "keys"

    [run]
    duration = 20

Variables precede the file of the folder, which precedes the user's own. Light to import: a file is parsed
only if it exists.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, shown
from hexctl.files import read_file
from hexctl.typed_names import nearest_name

FILE = "hexctl.toml"

#: Prefix of the variables; `HEXCTL_SETTINGS` names the only file to read, or `none`.
PREFIX = "HEXCTL_"
CHOSEN = "HEXCTL_SETTINGS"

#: Settings of robot and connection, for every command that uses them.
COMMON = {
    "robot": "a shipped name or a robot file",
    "backend": "what moves, as for `--backend`",
    "connect": "where the robot is: a Zenoh endpoint, or the port of its servos",
    "listen": "where `hexctl serve` listens, a Zenoh endpoint",
    "keys": "folder of certificates",
    "link": "link file",
    "world": "the simulated world",
    "runs": "folder of recordings, sessions, priors and studies",
}

#: Optional table around those of commands: `[commands.keys.new]` next to `keys = "keys"`.
COMMANDS = "commands"

#: Settings with folders, and settings that may be paths.
FOLDERS = ("keys", "runs")
NAMES_OR_PATHS = ("robot", "world", "link")

#: Default folder of runs.
RUNS = Path("runs")

MOST_BYTES = 100_000


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a setting: a file and its key, such as `run.duration`, or a variable without key."""

    place: str
    key: str = ""

    def __str__(self) -> str:
        return f"{self.place}: {self.key}" if self.key else self.place

    @property
    def is_variable(self) -> bool:
        """Whether it is a variable of the environment."""
        return not self.key


@dataclass(frozen=True, slots=True)
class Setting:
    """One value of a file or a variable.

    Attributes:
        folder: base of its relative paths.
        nearby: whether its file is in the working folder or above, and therefore possibly another person's.
    """

    value: Any
    origin: Origin
    folder: Path = Path()
    nearby: bool = False

    def placed(self, text: str) -> str:
        """A path of this setting: relative to `folder` unless absolute, `~` is the home folder."""
        return str(self.folder / _expanded(text))


@dataclass(frozen=True, slots=True)
class Layer:
    """Settings of one file (nested by command) or of the variables; earlier layers have priority."""

    place: str
    values: Mapping[str, Any]
    folder: Path | None
    nearby: bool = False

    def common(self, key: str) -> Setting | None:
        """Setting of robot and connection, by its name in `COMMON`."""
        return self.option((), key)

    def option(self, command: tuple[str, ...], option: str) -> Setting | None:
        """Setting of one option of a command: `("prior", "build"), "worlds"`; None if absent."""
        words = (*command, option)
        if self.folder is None:
            name = PREFIX + "_".join(words).replace("-", "_").upper()
            text = self.values.get(name)
            return Setting(text, Origin(name)) if text else None
        for path in _tables(command):
            if (value := self._table(path).get(option)) is not None:
                origin = Origin(self.place, ".".join((*path, option)))
                return Setting(value, origin, self.folder, self.nearby)
        return None

    def options(self, command: tuple[str, ...]) -> dict[str, Any]:
        """Values of a file for one command, by option; none for the environment."""
        return {key: value for path in _tables(command) for key, value in self._table(path).items()}

    def _table(self, path: tuple[str, ...]) -> dict[str, Any]:
        """Values of a table of a file, without the tables in it; none for the environment."""
        here: Any = self.values if self.folder is not None else None
        for word in path:
            here = here.get(word) if isinstance(here, Mapping) else None
        if not isinstance(here, Mapping):
            return {}
        return {key: value for key, value in here.items() if not isinstance(value, Mapping)}


def _tables(command: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Tables with the options of a command; the empty command has the settings above all tables."""
    return (command, (COMMANDS, *command)) if command else ((),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of files and variables, for programs and for the command line.

    Attributes:
        layers: variables and files, by priority.
        problems: why a file or a variable is invalid, one line each.
    """

    layers: tuple[Layer, ...] = ()
    problems: tuple[str, ...] = ()
    _common: Mapping[str, Setting] = field(default_factory=dict, repr=False)

    @property
    def values(self) -> dict[str, str]:
        """Settings of robot and connection by name in `COMMON`; paths relative to the current folder."""
        return {key: _text(key, setting) for key, setting in self._common.items()}

    @property
    def origins(self) -> dict[str, str]:
        """Origin of each of `values`."""
        return {key: str(setting.origin) for key, setting in self._common.items()}

    @property
    def runs(self) -> Path:
        """Folder of recordings, sessions, priors and studies."""
        return Path(self.values.get("runs", RUNS))

    def of(self, *command: str) -> dict[str, Any]:
        """Options in files for one command, such as `of("run")` or `of("prior", "build")`, by option."""
        options: dict[str, Any] = {}
        for layer in reversed(self.layers):
            options |= layer.options(command)
        return options


def read_settings(folder: Path | str = ".") -> Settings:
    """Settings in force in a folder.

    settings = hexctl.read_settings()
    hexctl.run(robot=settings.values.get("robot", "ant"), record_folder=settings.runs)

    Raises InputError for a file that cannot be read or is not TOML, and for a value of `COMMON` with no
    text. Options of commands are checked by the commands.
    """
    settings = find_settings(Path(folder))
    if settings.problems:
        raise InputError(settings.problems[0])
    return settings


def find_settings(folder: Path = Path()) -> Settings:
    """Settings in force in a folder; errors are in their `problems`."""
    variables = {name: text for name, text in os.environ.items() if name.startswith(PREFIX)}
    layers, problems = [Layer("environment", variables, None)], []
    for path in settings_files(folder):
        try:
            layers.append(Layer(shown_path(path), _content(path), path.parent, path not in _own_files()))
        except InputError as error:
            problems.append(str(error))
    common: dict[str, Setting] = {}
    for layer in reversed(layers):
        for key in COMMON:
            if (setting := layer.common(key)) is None:
                continue
            if isinstance(setting.value, str) and setting.value:
                common[key] = setting
            else:
                problems.append(f"{setting.origin}: got {shown(setting.value)}; allowed: text, {COMMON[key]}")
    problems += _misspelt(variables)
    return Settings(layers=tuple(layers), problems=tuple(problems), _common=common)


def is_endpoint(place: object) -> bool:
    """Whether a setting `connect` is a Zenoh endpoint, `PROTOCOL/HOST:PORT`."""
    return "/" in str(place) and str(place).partition("/")[0].isalpha()


def is_port(place: object) -> bool:
    """Whether a setting `connect` is a port of servos: a device, the number of an I2C bus, or UDP."""
    return str(place).startswith(("/", "udpin:", "udpout:")) or str(place).isdecimal()


def settings_files(folder: Path = Path()) -> tuple[Path, ...]:
    """Files with settings for a folder, by priority.

    The nearest `hexctl.toml` upwards, as far as the root of the repository or the home folder; outside of
    both only the folder's own. Then the user's, in the configuration folder.
    """
    if os.environ.get(CHOSEN):
        return _own_files()
    near = (place / FILE for place in _upwards(folder, _home()))
    return (*islice(filter(_is_there, near), 1), *filter(_is_there, _own_files()))


def _own_files() -> tuple[Path, ...]:
    chosen, users, home = os.environ.get(CHOSEN, ""), os.environ.get("XDG_CONFIG_HOME"), _home()
    if chosen:
        return () if chosen == "none" else (_expanded(chosen),)
    config = Path(users) if users else None if home is None else home / ".config"
    return () if config is None else (config / "hexctl" / FILE,)


def _expanded(text: str) -> Path:
    """Path with `~` expanded, if the home folder is known."""
    path = Path(text)
    with suppress(RuntimeError, ValueError):
        return path.expanduser()
    return path


def _is_there(path: Path) -> bool:
    try:
        path.lstat()
    except (OSError, ValueError):
        return False
    return True


def _upwards(folder: Path, home: Path | None) -> Iterator[Path]:
    try:
        here = folder.resolve()
    except OSError:
        return
    parents = (here, *here.parents)
    roots = [place for place in parents if place == home or (place / ".git").exists()]
    yield folder
    if roots:
        yield from parents[1 : parents.index(roots[0]) + 1]


def _home() -> Path | None:
    try:
        return Path.home()
    except RuntimeError:
        return None


def shown_path(path: Path) -> str:
    """Path in messages: relative in the current folder, with `~` in the home folder."""
    home = _home()
    if path.is_absolute() and home is not None and path.is_relative_to(home) and home != Path("/"):
        return f"~/{path.relative_to(home)}"
    return str(path)


def _content(path: Path) -> dict[str, Any]:
    """Keys get hyphens; raises InputError that names the file."""
    import tomllib

    name = shown_path(path)
    try:
        content = tomllib.loads(read_file(path, MOST_BYTES).decode("utf-8"))
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: cannot be read as text: {error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: is not valid TOML: {error}") from error
    try:
        values = _hyphenated(content, name)
    except RecursionError as error:
        raise InputError(f"{name}: has tables in tables without end; allowed: those of commands") from error
    if isinstance(below := values.get(COMMANDS), dict):
        _check_once(values, below, name, ())
    return values


def _hyphenated(table: Mapping[str, Any], place: str) -> dict[str, Any]:
    """Table with keys in the spelling of options; raises InputError for one key in two spellings."""
    plain: dict[str, Any] = {}
    for key, value in table.items():
        name = key.strip().casefold().replace("_", "-")
        if name in plain:
            raise InputError(f"{place}: {key}: is given twice; allowed: once")
        plain[name] = _hyphenated(value, place) if isinstance(value, dict) else value
    return plain


def _check_once(
    table: Mapping[str, Any], below: Mapping[str, Any], place: str, path: tuple[str, ...]
) -> None:
    """Raise InputError for an option both in a table and below `COMMANDS`."""
    for key in table.keys() & below.keys():
        tables = isinstance(table[key], dict), isinstance(below[key], dict)
        if all(tables):
            _check_once(table[key], below[key], place, (*path, key))
        elif not any(tables):
            raise InputError(f"{place}: {'.'.join((COMMANDS, *path, key))}: is given twice; allowed: once")


def _misspelt(variables: Mapping[str, str]) -> Iterator[str]:
    """Report only variables similar to `COMMON`, because others may belong to other programs."""
    for name in variables:
        word = name.removeprefix(PREFIX).lower()
        if word in COMMON or "_" in word or name == CHOSEN or (meant := nearest_name(word, COMMON)) is None:
            continue
        known = ", ".join(PREFIX + key.upper() for key in COMMON)
        yield f"{name}: unknown variable; allowed: {known}; did you mean '{PREFIX}{meant.upper()}'?"


def _text(key: str, setting: Setting) -> str:
    text = str(setting.value)
    return setting.placed(text) if is_path(key, text) else text


def is_path(key: str, text: str) -> bool:
    """Whether the text of a setting is a path, which begins at the folder of its file."""
    return key in FOLDERS or (key in NAMES_OR_PATHS and ("/" in text or bool(Path(text).suffix)))
