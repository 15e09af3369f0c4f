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

#: Variable of the robot's endpoint.
CONNECT = "HEXCTL_CONNECT"

#: Settings of robot and connection, for every command that uses them.
COMMON = {
    "robot": "a shipped name or a robot file",
    "backend": "what moves, as for `--backend`",
    "connect": "where the robot listens, PROTOCOL/HOST:PORT, such as tls/hexapod.local:7447",
    "port": "port of its servos, such as /dev/ttyUSB0",
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

#: A command and its option, such as `("prior", "build", "worlds")`; without a command: `("robot",)`.
OptionPath = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Setting:
    """One value of a file or a variable.

    Attributes:
        place: file, or variable.
        key: key in the file, such as `run.duration`; empty for a variable.
        folder: base of its relative paths.
        nearby: whether its file is in the working folder or above, and therefore possibly another person's.
    """

    value: Any
    place: str
    key: str = ""
    folder: Path = Path()
    nearby: bool = False

    def __str__(self) -> str:
        return f"{self.place}: {self.key}" if self.key else self.place

    @property
    def is_variable(self) -> bool:
        """Whether it is a variable of the environment."""
        return not self.key

    def path_of(self, text: str) -> str:
        """A path of this setting: relative to `folder` unless absolute, `~` is the home folder."""
        return str(self.folder / _expanded(text))


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of files and variables, for programs and for the command line.

    Attributes:
        variables: those that are not empty, by name; they have priority.
        files: settings of each file, by priority.
        problems: why a file or a variable is invalid, one line each.
    """

    variables: Mapping[str, str] = field(default_factory=dict)
    files: tuple[Mapping[OptionPath, Setting], ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, str]:
        """Settings of robot and connection by name in `COMMON`; paths relative to the current folder."""
        return {key: _text(key, setting) for key, setting in self._common.items()}

    @property
    def origins(self) -> dict[str, str]:
        """Origin of each of `values`."""
        return {key: str(setting) for key, setting in self._common.items()}

    @property
    def runs(self) -> Path:
        """Folder of recordings, sessions, priors and studies."""
        return Path(self.values.get("runs", RUNS))

    def of(self, *command: str) -> dict[str, Any]:
        """Options in files for one command, such as `of("run")` or `of("prior", "build")`, by option."""
        files = (file.items() for file in reversed(self.files))
        return {path[-1]: setting.value for file in files for path, setting in file if path[:-1] == command}

    def find(self, *paths: OptionPath) -> Setting | None:
        """Value of the first of these options that is set: in a variable, else in the nearest file."""
        for path in paths:
            name = PREFIX + "_".join(path).replace("-", "_").upper()
            if name in self.variables:
                return Setting(self.variables[name], name)
        found = (file[path] for file in self.files for path in paths if path in file)
        return next(found, None)

    @property
    def _common(self) -> dict[str, Setting]:
        return {key: setting for key in COMMON if (setting := self.find((key,))) is not None}


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
    variables = {name: text for name, text in os.environ.items() if name.startswith(PREFIX) and text}
    files: list[Mapping[OptionPath, Setting]] = []
    problems: list[str] = []
    for path in settings_files(folder):
        try:
            content = _content(path)
        except InputError as error:
            problems.append(str(error))
            continue
        wrong = [key for key in COMMON if (key,) in content and not _is_text(content[key,].value)]
        for key in wrong:
            setting = content.pop((key,))
            problems.append(f"{setting}: got {shown(setting.value)}; allowed: text, {COMMON[key]}")
        if (connect := content.get(("connect",))) is not None and not _is_endpoint(connect.value):
            problems.append(_no_endpoint(content.pop(("connect",))))
        files.append(content)
    if not _is_endpoint(variables.get(CONNECT, "tcp/")):
        problems.append(_no_endpoint(Setting(variables.pop(CONNECT), CONNECT)))
    problems += _misspelt(variables)
    return Settings(variables=variables, files=tuple(files), problems=tuple(problems))


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value)


def _is_endpoint(place: object) -> bool:
    return "/" in str(place) and str(place).partition("/")[0].isalpha()


def _no_endpoint(setting: Setting) -> str:
    return (
        f"{setting}: got {shown(setting.value)}; allowed: PROTOCOL/HOST:PORT, such as "
        "tls/hexapod.local:7447; the port of servos is `port`"
    )


def settings_files(folder: Path = Path()) -> tuple[Path, ...]:
    """Files with settings for a folder, by priority.

    The nearest `hexctl.toml` upwards, as far as the root of the repository or the home folder; outside of
    both only the folder's own. Then the user's, in the configuration folder.
    """
    if os.environ.get(CHOSEN):
        return _own_files()
    near = (place / FILE for place in _upwards(folder, _expanded("~")))
    return (*islice(filter(os.path.lexists, near), 1), *filter(os.path.lexists, _own_files()))


def _own_files() -> tuple[Path, ...]:
    chosen = os.environ.get(CHOSEN, "")
    if chosen:
        return () if chosen == "none" else (_expanded(chosen),)
    config = _expanded(os.environ.get("XDG_CONFIG_HOME") or "~/.config")
    # Without a home folder `~` stays, and would be a folder of the working folder.
    return (config / "hexctl" / FILE,) if config.is_absolute() else ()


def _expanded(text: str) -> Path:
    """Path with `~` expanded, if the home folder is known."""
    return Path(os.path.expanduser(text))


def _upwards(folder: Path, home: Path) -> Iterator[Path]:
    try:
        here = folder.resolve()
    except OSError:
        return
    parents = (here, *here.parents)
    roots = [place for place in parents if place == home or (place / ".git").exists()]
    yield folder
    if roots:
        yield from parents[1 : parents.index(roots[0]) + 1]


def shown_path(path: Path) -> str:
    """Path in messages: relative in the current folder, with `~` in the home folder."""
    home = _expanded("~")
    if path.is_absolute() and path.is_relative_to(home) and home != Path("/"):
        return f"~/{path.relative_to(home)}"
    return str(path)


def _content(path: Path) -> dict[OptionPath, Setting]:
    """Settings of a file, with the keys in the spelling of options; raises InputError that names it."""
    import tomllib

    name = shown_path(path)
    try:
        values = list(_flat(tomllib.loads(read_file(path, MOST_BYTES).decode("utf-8"))))
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: cannot be read as text: {error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: is not valid TOML: {error}") from error
    found: dict[OptionPath, Setting] = {}
    nearby = path not in _own_files()
    for words, value in values:
        setting = Setting(value, name, ".".join(words), path.parent, nearby)
        option = words[1:] if words[0] == COMMANDS and len(words) > 2 else words
        if option in found:
            raise InputError(f"{setting}: is given twice, as {found[option].key}; allowed: once")
        if "\0" in str(value):  # no path and no name has one
            raise InputError(f"{setting}: got {shown(value)}; allowed: text without null characters")
        found[option] = setting
    return found


def _flat(table: Mapping[str, Any], path: OptionPath = ()) -> Iterator[tuple[OptionPath, Any]]:
    for key, value in table.items():
        words = (*path, key.strip().casefold().replace("_", "-"))
        if isinstance(value, dict):
            yield from _flat(value, words)
        else:
            yield words, value


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
    return setting.path_of(text) if is_path(key, text) else text


def is_path(key: str, text: str) -> bool:
    """Whether the text of a setting is a path, which begins at the folder of its file."""
    return key in FOLDERS or (key in NAMES_OR_PATHS and ("/" in text or bool(Path(text).suffix)))
