"""Sends the stop of `hexctl estop` before the slower import of the command line.

Only a datagram, and only if arguments and settings are unambiguous; the command continues the stop.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexctl.client.stop_client import ReadyStop
    from hexctl.settings import Setting, Settings

#: Wait for the robot's confirmation before the command line is loaded, in s.
CONFIRM_S = 0.05

#: Options without effect on the robot's address, and those that give it.
FLAGS, PLACE_OPTIONS = ("json", "insecure"), ("connect", "keys")

#: Set by the shell during completion, which must not stop anything.
COMPLETION = "_HEXCTL_COMPLETE"

_begun: "list[ReadyStop]" = []


def begin_stop(arguments: Sequence[str]) -> None:
    """Send the stop of `hexctl estop` with these arguments; errors are left to the command."""
    try:
        place = place_of(arguments)
        if place is not None:
            from hexctl.client.stop_client import ReadyStop

            stop = ReadyStop(**place, again=False)
            _begun.append(stop)
            stop.press_by_datagram(CONFIRM_S)
    except Exception:  # noqa: BLE001  the command reports it
        return


def take_stop(place: Mapping[str, Any]) -> "ReadyStop | None":
    """Return the running stop, once; None if there is none, or it goes to another place."""
    from hexctl.wire.links import load_link

    if not _begun:
        return None
    stop = _begun.pop()
    if stop.link == load_link(**place):
        return stop
    stop.end_datagrams()
    return None


def place_of(arguments: Sequence[str]) -> dict[str, Any] | None:
    """Return arguments of `ReadyStop` from the command line and the settings; None if ambiguous."""
    typed = _typed(arguments)
    if typed is None or any(name.startswith(COMPLETION) for name in os.environ):
        return None
    from hexctl.settings import find_settings

    settings = find_settings()
    if settings.problems:
        return None
    connect, keys = typed.get("connect"), typed.get("keys")
    if _setting(settings, "link", common=connect is None) is not None:
        return None  # a file that takes long to read
    if connect is None:
        setting = _setting(settings, "connect", common=True)
        connect = None if setting is None else setting.value
    if keys is None:
        setting = _setting(settings, "keys", common=str(connect).startswith(("tls/", "quic/")))
        keys = None if setting is None else setting.path_of(setting.value)
    credentials = None if keys is None else Path(keys)
    return {"connect": connect, "credentials": credentials, "insecure": "insecure" in typed}


def _typed(arguments: Sequence[str]) -> dict[str, str] | None:
    typed: dict[str, str] = {}
    words = iter(arguments)
    for word in words:
        option, equals, value = word.removeprefix("--").partition("=")
        if not word.startswith("--") or option in typed or option not in (*FLAGS, *PLACE_OPTIONS):
            return None
        if option in PLACE_OPTIONS:
            typed[option] = value if equals else next(words, "")
            if not typed[option] or typed[option].startswith("-"):
                return None
        elif equals:
            return None
        else:
            typed[option] = ""
    return typed


def _setting(settings: "Settings", option: str, *, common: bool) -> "Setting | None":
    return settings.find(("estop", option), *([(option,)] if common else []))
