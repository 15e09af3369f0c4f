"""Gamepads by the kernel's event files, with codes of linux/input-event-codes.h.

The kernel's gamepad specification allows several layouts: a cross of buttons or axes, shoulder buttons as
axes. Joysticks have numbered buttons without known places: they are named, and cannot drive.
"""

import fcntl
import os
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hexctl.control.drive.arbiter import ZERO, VelocitySource
from hexctl.errors import InputError, argument
from hexctl.teleop.keyboard import Share

EVENT = struct.Struct("llHHi")

#: Type, code and value.
Event = tuple[int, int, int]

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3

#: Interval of the search for devices.
LOOK_S = 1.0

#: Bytes per read, and reads at a time.
MOST_BYTES, MOST_READS = 64 * EVENT.size, 64


class EventFile:
    """An open event file; raises OSError if it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self._rest = b""

    def events(self) -> Iterator[Event]:
        """Complete events since the last call; never waits. Raises OSError for a lost device."""
        for _ in range(MOST_READS):
            try:
                data = os.read(self.descriptor, MOST_BYTES)
            except BlockingIOError:
                return
            if not data:
                raise OSError("the device is gone")
            yield from self._events(self._rest + data)
            if len(data) < MOST_BYTES:
                return

    def close(self) -> None:
        """Close the file."""
        os.close(self.descriptor)

    def _events(self, data: bytes) -> Iterator[Event]:
        end = len(data) - len(data) % EVENT.size
        self._rest = data[end:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:end]):
            yield kind, code, value


class EventFiles:
    """Event files, searched once a second and closed when their devices are unplugged."""

    def __init__(
        self,
        find: Callable[[], list[Path]],
        *,
        most: int | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find, self._most = find, most
        self._now_s, self._look_at_s = now_s, -LOOK_S
        self.opened: dict[Path, EventFile] = {}

    def look(self) -> None:
        """Open new devices."""
        now_s = self._now_s()
        if now_s - self._look_at_s < LOOK_S or self._full:
            return
        self._look_at_s = now_s
        for path in self._find():
            if path in self.opened or self._full:
                continue
            try:
                self.opened[path] = EventFile(path)
            except OSError:
                continue

    def events(self) -> Iterator[Event]:
        """Events of all files since the last call; never waits."""
        for path, file in list(self.opened.items()):
            try:
                yield from file.events()
            except OSError:
                self.opened.pop(path).close()

    def close(self) -> None:
        """Close all files."""
        while self.opened:
            self.opened.popitem()[1].close()

    @property
    def _full(self) -> bool:
        return self._most is not None and len(self.opened) >= self._most


SYN_DROPPED = 3

#: Axes: left stick, right stick, the cross, shoulder buttons that report how far they are pressed.
ABS_X, ABS_Y, ABS_RX, ABS_RY, ABS_HAT_Y, ABS_HAT1X, ABS_HAT1Y = 0, 1, 3, 4, 17, 18, 19

#: Right stick and pedals of pads in the layout of Android.
ABS_Z, ABS_RZ, ABS_GAS, ABS_BRAKE = 2, 5, 9, 10

#: Numbered buttons of joysticks, first and last.
BTN_JOYSTICK = range(288, 304)

BTN_SOUTH, BTN_EAST, BTN_NORTH, BTN_WEST = 304, 305, 307, 308
BTN_TL, BTN_TR, BTN_SELECT, BTN_START = 310, 311, 314, 315

#: Up and down of a cross that reports buttons: BTN_DPAD_*, or BTN_TRIGGER_HAPPY3 and 4.
CROSS = {544: "up", 545: "down", 706: "up", 707: "down"}

#: Either shoulder button has to be held to drive, both to move the body; an axis counts as pressed beyond
#: half of its range.
SHOULDERS = (BTN_TL, BTN_TR)
SHOULDER_AXES = (ABS_HAT1X, ABS_HAT1Y)
LEFT_SHOULDER, RIGHT_SHOULDER = {BTN_TL, ABS_HAT1Y}, {BTN_TR, ABS_HAT1X}
PRESSED = 0.5

#: Requests of the other buttons.
BUTTONS = {BTN_EAST: "stop", BTN_START: "stand", BTN_SELECT: "sit", BTN_NORTH: "gait", BTN_WEST: "gait"}
BUTTONS |= CROSS

#: Descriptions of event files.
SYS = Path("/sys/class/input")

#: Dead zone of an axis, as a share of its range.
DEAD = 0.1

#: Moves the body by shares of its range, -1 to 1: forward, left, roll, pitch.
Lean = Callable[[float, float, float, float], None]

#: Range of an axis whose driver does not report it.
USUAL_RANGE = (-32768, 32767)


def find_gamepads(devices: Path = Path("/dev/input"), known: Path = SYS) -> list[Path]:
    """Event files of devices with a south button and a left stick, as described in `known`."""
    return [devices / name for name, keys, axes in _described(known) if not _lacks(keys, axes)]


def find_stop_pads(devices: Path = Path("/dev/input"), known: Path = SYS) -> list[Path]:
    """Event files of gamepads, and of joysticks: any of their buttons can stop."""
    return [devices / name for name, keys, _ in _described(known) if _is_pad(keys)]


def undrivable_pads(devices: Path = Path("/dev/input"), known: Path = SYS) -> dict[Path, str]:
    """Gamepads and joysticks that cannot drive: their names and what they lack, by event file."""
    return {
        devices / name: f"{_name(known / name)} {lack}"
        for name, keys, axes in _described(known)
        if _is_pad(keys) and (lack := _lacks(keys, axes))
    }


def _described(known: Path) -> Iterator[tuple[str, int, int]]:
    """Name of each event file, and bitmaps of its keys and axes."""
    for place in sorted(known.glob("event*")):
        folder = place / "device" / "capabilities"
        try:
            yield place.name, _bits((folder / "key").read_text()), _bits((folder / "abs").read_text())
        except (OSError, ValueError):
            continue


def _is_pad(keys: int) -> bool:
    return bool(keys >> BTN_SOUTH & 1) or any(keys >> button & 1 for button in BTN_JOYSTICK)


def _lacks(keys: int, axes: int) -> str:
    """Why a device cannot drive; empty if it can."""
    if not keys >> BTN_SOUTH & 1:
        return "is a joystick: its buttons are only numbered, so that none can be held to drive"
    if not (axes >> ABS_X & 1 and axes >> ABS_Y & 1):
        return "has no left stick"
    return ""


def _name(place: Path) -> str:
    try:
        return (place / "device" / "name").read_text(errors="replace").strip()
    except OSError:
        return "a device"


def check_gamepad(path: Path, known: Path = SYS) -> None:
    """Raise InputError for a file other than a gamepad, or unreadable; a missing one may still appear."""
    name = argument("gamepad")
    if path.is_file() or path.is_dir():
        raise InputError(f"{name}: got {path}, which is no event file; allowed: such as /dev/input/event5")
    if path.exists() and not os.access(path, os.R_OK):
        raise InputError(f"{name}: {path} may not be read; allowed: for members of its group, often `input`")
    real = path.resolve()
    if said := undrivable_pads(real.parent, known).get(real):
        raise InputError(f"{name}: got {path}: {said}; allowed: a gamepad, whose buttons have known places")


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


def turn_axis(axes: int) -> int:
    """Axis of the right stick, by the bitmap of a pad's axes.

    Pads in the layout of Android have it on Z, and their triggers on GAS and BRAKE. On other pads Z is a
    trigger, which rests at the end of its range.
    """
    android = axes >> ABS_Z & 1 and axes >> ABS_GAS & 1 and axes >> ABS_BRAKE & 1
    return ABS_Z if android and not axes >> ABS_RX & 1 else ABS_RX


def _axes_of(descriptor: int) -> int:
    """Bitmap of the axes of an open event file (EVIOCGBIT); 0 if unknown."""
    try:
        return int.from_bytes(fcntl.ioctl(descriptor, 0x80084523, bytes(8)), "little")
    except OSError:
        return 0


class GamepadEvents:
    """State of a gamepad from its events; `pressed` are requests since it was last emptied."""

    def __init__(self, descriptor: int | None = None) -> None:
        self._turn = ABS_RX if descriptor is None else turn_axis(_axes_of(descriptor))
        self._nod = ABS_RY if self._turn == ABS_RX else ABS_RZ
        sticks = (ABS_X, ABS_Y, self._turn, self._nod)
        self._ranges = {
            axis: USUAL_RANGE if descriptor is None else axis_range(descriptor, axis)
            for axis in (*sticks, *SHOULDER_AXES)
        }
        # A hat without a range reports -1, 0 and 1.
        low, high = USUAL_RANGE if descriptor is None else axis_range(descriptor, ABS_HAT_Y)
        self._hat_pressed = 1 if (low, high) == USUAL_RANGE else max(1.0, PRESSED * max(-low, high))
        self._hat = 0
        self._shares = dict.fromkeys(sticks, 0.0)
        self._shoulders: set[int] = set()
        self.pressed: list[str] = []

    @property
    def enabled(self) -> bool:
        """Whether a hold button is pressed."""
        return bool(self._shoulders)

    @property
    def leans(self) -> bool:
        """Whether both hold buttons are pressed."""
        return bool(self._shoulders & LEFT_SHOULDER and self._shoulders & RIGHT_SHOULDER)

    @property
    def shares(self) -> tuple[float, float, float]:
        """Forward, left and turn, -1 to 1."""
        # Sticks count right and down as positive.
        return -self._shares[ABS_Y], -self._shares[ABS_X], -self._shares[self._turn]

    @property
    def lean_shares(self) -> tuple[float, float, float, float]:
        """Forward, left, roll and pitch, -1 to 1: the body follows the sticks."""
        return (*self.shares[:2], self._shares[self._turn], -self._shares[self._nod])

    def take(self, kind: int, code: int, value: int) -> None:
        """Take an event."""
        if kind == EV_SYN and code == SYN_DROPPED:
            # Events were lost: buttons count as released until they are pressed again.
            self._shoulders.clear()
            self._hat = 0
            self._shares = dict.fromkeys(self._shares, 0.0)
        elif kind == EV_ABS and code in self._shares:
            self._shares[code] = self._share(code, value)
        elif kind == EV_ABS and code == ABS_HAT_Y:
            self._press_hat(value)
        elif kind == EV_ABS and code in SHOULDER_AXES:
            low, high = self._ranges[code]
            # A range with a negative side is that of a second cross's direction, and no shoulder button's.
            pressed = (low >= 0 or (low, high) == USUAL_RANGE) and value > PRESSED * high
            (self._shoulders.add if pressed else self._shoulders.discard)(code)
        elif kind == EV_KEY and code in SHOULDERS and value != 2:  # 2 is a repetition
            (self._shoulders.add if value else self._shoulders.discard)(code)
        elif kind == EV_KEY and code in BUTTONS and value == 1:
            self.pressed.append(BUTTONS[code])

    def _press_hat(self, value: int) -> None:
        """A cross that reports how far it is pressed asks once for each press."""
        hat = 0 if abs(value) < self._hat_pressed else (1 if value > 0 else -1)
        if hat and hat != self._hat:
            self.pressed.append("up" if hat < 0 else "down")
        self._hat = hat

    def _share(self, axis: int, value: int) -> float:
        low, high = self._ranges[axis]
        share = max(-1.0, min(1.0, (2 * value - low - high) / (high - low)))
        if abs(share) <= DEAD:
            return 0.0
        return (abs(share) - DEAD) / (1 - DEAD) * (1 if share > 0 else -1)


class Gamepad:
    """The first gamepad, as a source of velocities; without `path` it is searched repeatedly.

    A shoulder button has to be held to drive. Releasing it, or unplugging the pad, stops the walk. With both
    held, the sticks move the body over its feet, where it stays. A stick that is held during a clear of a
    stop, or a change between the two, is ignored until it was in the middle, or the buttons released.
    """

    def __init__(
        self,
        source: VelocitySource,
        share: Share,
        ask: Callable[[str], None],
        lean: Lean,
        *,
        path: Path | None = None,
        find: Callable[[], list[Path]] = find_gamepads,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._share, self._ask, self._lean = source, share, ask, lean
        self._files = EventFiles(find if path is None else lambda: [path], most=1, now_s=now_s)
        self._file: EventFile | None = None
        self._events = GamepadEvents()
        self._mode = ""
        self._forgets: int | None = source.forgets
        self._leaned = (0.0,) * 4

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
        if self._events.enabled:
            self._drive("lean" if self._events.leans else "walk")
        elif self._mode:
            if self._mode == "lean":
                self._ask("hold body")
            self._mode = ""
            self._source.release()

    def _drive(self, mode: str) -> None:
        events, source = self._events, self._source
        if not self._mode or not (any(events.shares) or any(events.lean_shares)):
            self._forgets = source.forgets
        elif mode != self._mode:
            self._forgets = None
            source.release()
        self._mode = mode
        if self._forgets != source.forgets:
            return
        source.command(self._share(*events.shares) if mode == "walk" else ZERO)
        if mode == "lean" and events.lean_shares != self._leaned:
            self._leaned = events.lean_shares
            self._lean(*self._leaned)

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


class StopButton:
    """Detects presses of any button of any gamepad or joystick."""

    def __init__(
        self,
        find: Callable[[], list[Path]] = find_stop_pads,
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._files = EventFiles(find, now_s=now_s)

    @property
    def connected(self) -> int:
        """Number of gamepads."""
        return len(self._files.opened)

    def pressed(self) -> bool:
        """Whether a button was pressed since the last call; never waits."""
        self._files.look()
        presses = [kind == EV_KEY and value == 1 for kind, _, value in self._files.events()]
        return any(presses)

    def close(self) -> None:
        """Close the gamepads."""
        self._files.close()
