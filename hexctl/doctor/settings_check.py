"""The settings of a computer: files and variables in force, and their values."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexctl.robot.plugins import DEBUG
from hexctl.settings import CHOSEN, COMMON, PREFIX, find_settings

#: Settings that name other computers, by the last word of their key; their values are hidden.
ADDRESSES = ("connect", "listen", "camera", "dask", "ros", "page", "host", "port")


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingFound:
    """One setting in force; its value is `given` if it may name another computer."""

    key: str
    value: str
    origin: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SettingsFound:
    """Settings in force, lines on invalid files and variables, and unknown variables `HEXCTL_*`."""

    values: tuple[SettingFound, ...]
    problems: tuple[str, ...]
    unknown: tuple[str, ...] = ()


def no_option(_variable: str) -> bool:
    """False: without the command line no variable is known to be an option of a command."""
    return False


def read_settings_found(is_option: Callable[[str], bool] = no_option) -> SettingsFound:
    """Settings in force in the current folder; `is_option` recognizes variables of commands."""
    settings = find_settings()
    found: dict[str, SettingFound] = {}
    unknown: list[str] = []
    for name, text in settings.variables.items():
        word = name.removeprefix(PREFIX).lower()
        key = word if word in COMMON else name
        if key in COMMON or is_option(key):
            found[key] = SettingFound(key=key, value=_anonymous(key, text), origin="environment")
        elif name not in (CHOSEN, DEBUG):
            unknown.append(name)
    for file in settings.files:
        for setting in file.values():
            key, value = setting.key, _anonymous(setting.key, setting.value)
            found.setdefault(key, SettingFound(key=key, value=value, origin=setting.place))
    return SettingsFound(
        values=tuple(found.values()), problems=settings.problems, unknown=tuple(sorted(unknown))
    )


def _anonymous(key: str, value: Any) -> str:
    """Text of a value, without the names of persons and of other computers."""
    last = key.lower().replace("_", ".").replace("-", ".").rpartition(".")[2]
    if last in ADDRESSES:
        return "given"
    return without_home(str(value))


def without_home(text: str) -> str:
    """A text without the name of the person's home folder."""
    home = str(Path("~").expanduser())
    return text if home in ("/", "~") else text.replace(home, "~")
