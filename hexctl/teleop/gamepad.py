"""Gamepads by the kernel's event files, with codes of linux/input-event-codes.h."""

import fcntl
import os
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hexctl.control.drive.arbiter import VelocitySource
from hexctl.errors import InputError, argument
from hexctl.teleop.event_file import EV_ABS, EV_KEY, EV_SYN, EventFile, EventFiles
from hexctl.teleop.keyboard import Share

SYN_DROPPED = 3

#: Axes: left stick, right stick, the cross.
ABS_X, ABS_Y, ABS_RX, ABS_HAT_Y = 0, 1, 3, 17

BTN_SOUTH, BTN_EAST, BTN_NORTH, BTN_WEST = 304, 305, 307, 308
BTN_TL, BTN_TR, BTN_SELECT, BTN_START = 310, 311, 314, 315

#: Either shoulder button has to be held to drive.
HOLD = (BTN_TL, BTN_TR)

#: Requests of the other buttons.
BUTTONS = {BTN_EAST: "stop", BTN_START: "stand", BTN_SELECT: "sit", BTN_NORTH: "gait", BTN_WEST: "gait"}

#: Dead zone of an axis, as a share of its range.
DEAD = 0.1

#: Range of an axis whose driver does not report it.
USUAL_RANGE = (-32768, 32767)


def find_gamepads(devices: Path = Path("/dev/input"), known: Path = Path("/sys/class/input")) -> list[Path]:
    """Event files of devices with a south button and a left stick, as described in `known`."""
    found = []
    for place in sorted(known.glob("event*")):
        folder = place / "device" / "capabilities"
        try:
            keys, axes = _bits((folder / "key").read_text()), _bits((folder / "abs").read_text())
        except (OSError, ValueError):
            continue
        if keys >> BTN_SOUTH & 1 and axes >> ABS_X & 1 and axes >> ABS_Y & 1:
            found.append(devices / place.name)
    return found


def check_gamepad(path: Path) -> None:
    """Raise InputError for a file that is no gamepad or not readable; a missing one may still appear."""
    name = argument("gamepad")
    if path.is_file() or path.is_dir():
        raise InputError(f"{name}: got {path}, which is no event file; allowed: such as /dev/input/event5")
    if path.exists() and not os.access(path, os.R_OK):
        raise InputError(f"{name}: {path} may not be read; allowed: for members of its group, often `input`")


def _bits(text: str) -> int:
    """A bitmap in sysfs: words of 64 bits in hexadecimal, the highest first."""
    bits = 0
    for word in text.split():
        bits = bits << 64 | int(word, 16)
    return bits


def axis_range(descriptor: int, axis: int) -> tuple[int, int]:
    """Lowest and highest value of an axis by its driver (EVIOCGABS)."""
    try:
        answer = fcntl.ioctl(descriptor, 0x80184540 + axis, bytes(24))
    except OSError:
        return USUAL_RANGE
    _, low, high, *_ = struct.unpack("6i", answer)
    return (low, high) if high > low else USUAL_RANGE


class GamepadEvents:
    """State of a gamepad from its events; `pressed` are requests since it was last emptied."""

    def __init__(self, descriptor: int | None = None) -> None:
        axes = (ABS_X, ABS_Y, ABS_RX)
        self._ranges = {
            axis: USUAL_RANGE if descriptor is None else axis_range(descriptor, axis) for axis in axes
        }
        self._shares = dict.fromkeys(self._ranges, 0.0)
        self._holds: set[int] = set()
        self.pressed: list[str] = []

    @property
    def held(self) -> bool:
        """Whether a hold button is pressed."""
        return bool(self._holds)

    @property
    def shares(self) -> tuple[float, float, float]:
        """Forward, left and turn, -1 to 1."""
        # Sticks count right and down as positive.
        return -self._shares[ABS_Y], -self._shares[ABS_X], -self._shares[ABS_RX]

    def take(self, kind: int, code: int, value: int) -> None:
        """Take an event."""
        if kind == EV_SYN and code == SYN_DROPPED:
            # Events were lost: buttons count as released until they are pressed again.
            self._holds.clear()
            self._shares = dict.fromkeys(self._shares, 0.0)
        elif kind == EV_ABS and code in self._shares:
            self._shares[code] = self._share(code, value)
        elif kind == EV_ABS and code == ABS_HAT_Y and value:
            self.pressed.append("up" if value < 0 else "down")
        elif kind == EV_KEY and code in HOLD and value != 2:  # 2 is a repetition
            (self._holds.add if value else self._holds.discard)(code)
        elif kind == EV_KEY and code in BUTTONS and value == 1:
            self.pressed.append(BUTTONS[code])

    def _share(self, axis: int, value: int) -> float:
        low, high = self._ranges[axis]
        share = max(-1.0, min(1.0, (2 * value - low - high) / (high - low)))
        if abs(share) <= DEAD:
            return 0.0
        return (abs(share) - DEAD) / (1 - DEAD) * (1 if share > 0 else -1)


class Gamepad:
    """The first gamepad, as a source of velocities; without `path` it is searched repeatedly.

    A shoulder button has to be held to drive. Releasing it, or unplugging the pad, stops the walk. A stick
    that is held during a clear of a stop is ignored until it was in the middle, or the button released.
    """

    def __init__(
        self,
        source: VelocitySource,
        share: Share,
        ask: Callable[[str], None],
        *,
        path: Path | None = None,
        find: Callable[[], list[Path]] = find_gamepads,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._share, self._ask = source, share, ask
        self._files = EventFiles(find if path is None else lambda: [path], most=1, now_s=now_s)
        self._file: EventFile | None = None
        self._events = GamepadEvents()
        self._driving, self._forgets = False, source.forgets

    @property
    def connected(self) -> bool:
        """Whether there is a gamepad now."""
        return bool(self._files.opened)

    def poll(self) -> None:
        """Take the events since the last tick."""
        self._files.look()
        self._follow()
        for event in self._files.events():
            self._events.take(*event)
        self._follow()
        for request in self._events.pressed:
            self._ask(request)
        self._events.pressed.clear()
        if self._events.held:
            shares = self._events.shares
            if not self._driving or not any(shares):
                self._driving, self._forgets = True, self._source.forgets
            if self._forgets == self._source.forgets:
                self._source.command(self._share(*shares))
        elif self._driving:
            self._driving = False
            self._source.release()

    def report(self, status: dict[str, Any]) -> None:
        """Nothing: a gamepad has no display."""

    def close(self) -> None:
        """Close the gamepad."""
        self._files.close()
        self._follow()

    def _follow(self) -> None:
        file = next(iter(self._files.opened.values()), None)
        if file is not self._file:
            self._file = file
            self._events = GamepadEvents(None if file is None else file.descriptor)
