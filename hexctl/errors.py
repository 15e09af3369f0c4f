"""Errors that hexctl raises, each of which is also a built-in error, and their wording."""

import errno
import re
from collections.abc import Callable
from numbers import Integral, Real
from reprlib import Repr
from typing import Any

#: The name of an argument in a message, between marks that no text has.
_ARGUMENT = re.compile("\0([a-z0-9_.]+)\0")

#: Characters that no line may contain: line ends, control codes, bidirectional marks, invalid UTF-8.
_UNPRINTABLE = re.compile("[\0-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")

#: A very long value in a message: one word, or a quoted text; paths and commands are shorter.
_LONG = re.compile("(?<=got ')[^'\0]{401,}(?=')|[^\\s'\"\0]{401,}")

#: Remaining characters of such a value.
_LONG_SHOWN = 200


def argument(name: str) -> str:
    """Name of an argument in the message of a `HexctlError`: on the command line its flag.

    raise InputError(f"{argument('seed')}: got {seed}; allowed: 0 or more")
    # str(error): seed: got -1; allowed: 0 or more
    # hexctl run: --seed: got -1; allowed: 0 or more
    """
    return f"\0{name}\0"


def printable(text: str) -> str:
    """Text as one line for every terminal and encoding, with unprintable characters escaped."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def printable_parts(value: Any) -> Any:
    """JSON value of an untrusted source with `printable` texts."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, list):
        return [printable_parts(part) for part in value]
    if isinstance(value, dict):
        return {printable(str(name)): printable_parts(part) for name, part in value.items()}
    return value


def _line_of(message: str) -> str:
    """A message as one printable line, in which arguments keep their marks."""
    parts = _ARGUMENT.split(message)  # texts and names by turns
    return "".join(argument(part) if number % 2 else printable(part) for number, part in enumerate(parts))


def shortened(text: str) -> str:
    """A message with very long values cut: `got 'aaaa... (5000 characters)'`."""
    return _LONG.sub(lambda found: f"{found[0][:_LONG_SHOWN]}... ({len(found[0])} characters)", text)


class HexctlError(Exception):
    """Base class of hexctl's errors.

    The text is one line, with unprintable characters escaped and very long values cut.
    """

    def __init__(self, message: str = "") -> None:
        self._message = shortened(_line_of(str(message)))
        super().__init__(_ARGUMENT.sub(r"\1", self._message))

    def worded(self, name: Callable[[str], str]) -> str:
        """The text, with `name(argument)` in place of each argument."""
        return _ARGUMENT.sub(lambda found: name(found[1]), self._message)


class InputError(HexctlError, ValueError):
    """An invalid value from the user: option, file or argument."""


class UnusedError(InputError):
    """An unused option `field`: by default the first one that the message names.

    It is refused if typed, and harmless in a file of settings.
    """

    def __init__(self, message: str = "", *, field: str = "") -> None:
        super().__init__(message)
        self.field = field or next(iter(_ARGUMENT.findall(message)), "")


class WrongTypeError(InputError, TypeError):
    """A value of an invalid type."""


class MissingExtraError(HexctlError, ImportError):
    """A missing optional part of hexctl."""

    def __init__(self, what: str, extra: str) -> None:
        from hexctl.installation import install_command

        super().__init__(f'{what} needs the "{extra}" extra: {install_command(extra)}')
        self._what, self._extra = what, extra

    def __reduce__(self) -> tuple[type, tuple[str, str]]:
        return type(self), (self._what, self._extra)


#: Extras by optional package.
EXTRAS = {
    "mujoco": "sim",
    "dm_control": "sim",
    "rerun": "view",
    "rerun_cli": "view",
    "lz4": "view",
    "pyarrow": "study",
    "matplotlib": "study",
    "distributed": "study",
    "jinja2": "study",
    "smbus2": "i2c",
    "websockets": "page",
    "pandas": "data",
    "av": "pictures",
    "PIL": "pictures",
    "cv2": "see",
    "pyapriltags": "see",
    "reportlab": "see",
    "trimesh": "browser",
    "viser": "browser",
    "onnxruntime": "policy",
}


class ReachError(HexctlError, ValueError):
    """A foot position that a leg cannot reach."""


class LimitError(HexctlError, ValueError):
    """A joint angle or speed outside its limits."""


class CommandRefusedError(HexctlError, ValueError):
    """A command that the guard did not accept; the last accepted targets stay in force."""


class EStopError(HexctlError, RuntimeError):
    """A latched stop of the guard; nothing moves until it is cleared explicitly."""


class RobotFaultError(HexctlError, RuntimeError):
    """A fault of the robot, or of the link to it."""


class SimulationDivergedError(RobotFaultError):
    """An unstable simulation; its later states are meaningless."""


class MessageError(HexctlError, ValueError):
    """An invalid message from the network; it is dropped and counted."""


class RecordingError(HexctlError, OSError):
    """A recording that could not be written or opened."""


#: System errors of a full or broken disk, an exceeded quota, or a file of maximum size.
_OF_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def is_of_disk(error: BaseException | None) -> bool:
    """Whether an error is that of a full or broken disk, which is always a fault."""
    return isinstance(error, OSError) and error.errno in _OF_DISK


def room_hint(error: BaseException | None) -> str:
    """The end of a message about a full disk: the next step; empty for other errors."""
    full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
    return "; free some space, or write elsewhere" if full else ""


#: Number types: the accepted abstract type (a bool is not one), and its name.
_NUMBERS: dict[type, tuple[type, str]] = {float: (Real, "a number"), int: (Integral, "a whole number")}

_NAMES = {str: "text", bool: "True or False", type(None): "None"}

#: Maximum characters of a value in a message.
MOST_SHOWN = 160


def check_type(value: object, kind: type | tuple[type, ...], what: str, allowed: str | None = None) -> None:
    """Raise WrongTypeError unless a value is of a type, or of one of several.

    `float` accepts any number and `int` any whole number, including numpy's, but no bool.

        check_type(gait, Gait, "plan.gait", "a Gait, as make_gait(robot, 'tripod') gives")
        # plan.gait: got 'tripod' (str); allowed: a Gait, as make_gait(robot, 'tripod') gives

    Args:
        what: the name of the argument.
        allowed: the end of the message; None makes it from the types.
    """
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if any(_is_a(value, one) for one in kinds):
        return
    allowed = allowed or " or ".join(_type_name(one) for one in kinds)
    raise WrongTypeError(f"{what}: got {shown(value)} ({type(value).__name__}); allowed: {allowed}")


def check_callable(value: object, what: str, allowed: str) -> None:
    """Raise WrongTypeError unless a value is callable or None, worded as by `check_type`."""
    if value is not None and not callable(value):
        raise WrongTypeError(f"{what}: got {shown(value)} ({type(value).__name__}); allowed: {allowed}")


def shown(value: object) -> str:
    """Short text of a value on one line, whatever its size."""
    short = Repr()
    short.maxlevel, short.maxlist, short.maxstring, short.maxother = 3, 20, 60, 60
    try:
        text = re.sub(" at 0x[0-9a-f]+", "", short.repr(value).replace("\n", " "))
    except ValueError:  # Python writes no whole number of more than 4300 digits
        text = f"a {type(value).__name__} that is too long to show"
    return text if len(text) <= MOST_SHOWN else text[:MOST_SHOWN] + "..."


def _is_a(value: object, kind: type) -> bool:
    if kind in _NUMBERS:
        return isinstance(value, _NUMBERS[kind][0]) and not isinstance(value, bool)
    return isinstance(value, kind)


def _type_name(kind: type) -> str:
    if kind in _NUMBERS:
        return _NUMBERS[kind][1]
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    return _NAMES.get(kind, f"{article} {kind.__name__}")
