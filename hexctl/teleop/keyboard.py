"""The keyboard of a terminal: each key changes the set speed, which holds until another key changes it.

Terminals report no release of a key, and repeat a held one only after half a second, so keys latch. Each
displayed line queries the terminal's status (DSR, ECMA-48 8.3.35). If a terminal has answered before and
then falls silent, as after a lost network, its speed is revoked.
"""

import math
import os
import re
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Self

from hexctl.control.drive.arbiter import Velocity, VelocitySource
from hexctl.errors import printable

#: Change of the speed per key, as a share of the maximum.
STEP = 0.2

#: Effect of keys: forward, left and turn to add, or a request of the session.
SPEED_KEYS = {
    "w": (1, 0, 0),
    "s": (-1, 0, 0),
    "a": (0, 1, 0),
    "d": (0, -1, 0),
    "\x1b[A": (1, 0, 0),
    "\x1b[B": (-1, 0, 0),
    "\x1b[D": (0, 0, 1),
    "\x1b[C": (0, 0, -1),
}
REST_KEYS = (" ", "\x1b", "x")
REQUEST_KEYS = {"q": "quit", "g": "gait", "h": "level", "1": "stand", "0": "sit", "x": "stop"}
REQUEST_KEYS |= {"u": "up", "j": "down", "i": "front down", "k": "front up"}
REQUEST_KEYS |= {"n": "lean left", "m": "lean right", ",": "twist left", ".": "twist right"}
REQUEST_KEYS |= {"W": "shift forward", "S": "shift back", "A": "shift left", "D": "shift right"}

#: Keys that count even with a silent terminal.
LAST_KEYS = (*REST_KEYS, "0", "q")

HELP = (
    "w s or arrows: faster, slower · a d: sideways · left right arrows: turn · space: stand still\n"
    "u j: body up, down · W A S D: shift it · i k: front down, up · n m: lean it · , .: twist it · h: level\n"
    "g: gait · 1: stand up · 0: sit down · x: stop (1 goes on) · q: quit"
)

#: Rounded numbers of a body pose that are not shown.
ZEROS = ("0°", "0.0 cm")

#: Status query of a terminal, and its answer.
ASK_STATUS, STATUS = "\x1b[5n", re.compile(r"\x1b\[[03]n")

#: A terminal without an answer for this long is silent, if it has answered before.
SILENCE_S = 0.5

#: Time to show an unknown key.
UNKNOWN_S = 2.0

#: Keys of more than one character, or their beginning; a space ends one, so that it always counts.
_SEQUENCE = re.compile(r"\x1b(?:\[[0-9:;<=>?]*|O)[@-~]")
_BEGUN = re.compile(r"\x1b(?:\[[0-9:;<=>?]*|O)?")

#: Ticks without input after which an incomplete sequence is the key Esc.
ESCAPE_TICKS = 2

#: Wait for the last answer of a terminal, and its maximum while more arrives.
LAST_ANSWER_S, LAST_ANSWERS_S = 0.1, 0.5

#: Time to show the last line.
LAST_LINE_S = 0.2

#: Bytes of keys per tick.
MOST_BYTES = 256

#: Makes a velocity of shares of the maximum, -1 to 1: forward, left, turn.
Share = Callable[[float, float, float], Velocity]


class Keyboard:
    """Keys of a terminal as a source of velocities.

    A set speed is repeated every tick while the terminal answers. A closed terminal ends the session, and a
    silent one has its speed revoked. A speed set before the robot stands up is dropped.
    """

    def __init__(
        self,
        source: VelocitySource,
        share: Share,
        ask: Callable[[str, str], None],
        keys: int,
        show: Callable[[str], None],
        *,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._share, self._ask, self._keys, self._show = source, share, ask, keys, show
        self._now_s = now_s
        self._set, self._forgets = (0.0, 0.0, 0.0), source.forgets
        self._pending, self._pending_ticks = "", 0
        self._answered_at_s: float | None = None
        self._stood = self._gone = False
        self._unknown, self._unknown_at_s = "", 0.0

    def poll(self) -> None:
        """Take the keys since the last tick."""
        if self._gone:
            return
        if self._forgets != self._source.forgets:
            self._set, self._forgets = (0.0, 0.0, 0.0), self._source.forgets
        try:
            ready, _, _ = select.select([self._keys], [], [], 0)
            data = os.read(self._keys, MOST_BYTES) if ready else None
        except OSError:
            data = b""
        if data == b"":
            self._leave()
            return
        silent = self._silent()
        for key in self._keys_of((data or b"").decode(errors="replace")):
            # Keys from a lost network arrive late: they may only stop.
            if not silent or key in LAST_KEYS or STATUS.fullmatch(key):
                self.press(key)
        if any(self._set) and self._silent():
            self._set, self._stood = (0.0, 0.0, 0.0), True
            self._source.release()
        if any(self._set):
            self._source.command(self._share(*self._set))

    def press(self, key: str) -> None:
        """Execute a key, or note an answer of the terminal."""
        if STATUS.fullmatch(key):
            self._answered_at_s = self._now_s()
            return
        if key in SPEED_KEYS:
            self._stood = False
            changed = zip(self._set, SPEED_KEYS[key], strict=True)
            forward, left, turn = (max(-1.0, min(1.0, round(a + STEP * b, 6))) for a, b in changed)
            self._set = forward, left, turn
            if not any(self._set):
                self._source.release()
        elif key in REST_KEYS:
            self._set = 0.0, 0.0, 0.0
            self._source.release()
        known = key in REQUEST_KEYS or key in REST_KEYS or key in SPEED_KEYS
        self._unknown, self._unknown_at_s = "" if known else key, self._now_s()
        if key in REQUEST_KEYS:
            self._ask(REQUEST_KEYS[key], "q" if key == "q" else "")

    def report(self, status: dict[str, Any]) -> None:
        """Show a line, with an unknown key for some time."""
        if self._unknown and self._now_s() - self._unknown_at_s < UNKNOWN_S:
            status = {**status, "said": f"key {self._unknown!r} does nothing"}
        if not self._gone:
            stood = f" · stood still: the terminal was silent for {SILENCE_S:g} s" if self._stood else ""
            self._show(line_of(status) + stood)

    def _silent(self) -> bool:
        return self._answered_at_s is not None and self._now_s() - self._answered_at_s > SILENCE_S

    def _keys_of(self, text: str) -> list[str]:
        """An incomplete sequence waits for its end."""
        self._pending_ticks = 0 if text else self._pending_ticks + 1
        text, self._pending = self._pending + text, ""
        keys = []
        while text:
            begun, whole = _BEGUN.match(text), _SEQUENCE.match(text)
            if whole is not None:
                key = whole[0]
                keys.append("\x1b[" + key[2:] if key[1] == "O" else key)
            elif begun is None:
                keys.append(text[0])
            elif begun.end() == len(text) and self._pending_ticks < ESCAPE_TICKS:
                self._pending = text
                break
            else:
                keys.append("\x1b")
            found = whole or begun
            text = text[1 if found is None else found.end() :]
        return keys

    def _leave(self) -> None:
        self._gone, self._set = True, (0.0, 0.0, 0.0)
        self._source.release()
        self._ask("quit", "the terminal is closed")


def line_of(status: dict[str, Any]) -> str:
    """Status of a robot as a terminal line; a message replaces the distance."""
    battery, said = status["battery_v"], status["said"]
    parts = [
        _command_of(status["velocity"]),
        status["gait"],
        *_pose_in_words(status["body_pose"]),
        status["mode"] if status["stopped"] is None else _stop_in_words(status),
        *([said] if said else _travel_of(status)),
        *([] if battery is None else [f"{battery:.1f} V"]),
        *([] if status["source"] is None else [status["source"]]),
    ]
    return " · ".join(parts)


def _pose_in_words(numbers: Sequence[float]) -> list[str]:
    """The numbers of a body pose other than zero, in degrees and cm."""
    degrees = [_signed(math.degrees(number), 0) + "°" for number in numbers[:3]]
    values = [*degrees, *(_signed(100 * number, 1) + " cm" for number in numbers[3:])]
    names = ("roll", "pitch", "yaw", "forward", "left", "up")
    parts = [f"{name} {value}" for name, value in zip(names, values, strict=True) if value[1:] not in ZEROS]
    return [f"body {' '.join(parts)}"] if parts else []


def _stop_in_words(status: dict[str, Any]) -> str:
    clear = status.get("clear")
    return f"STOPPED: {status['stopped']} ({'' if clear is None else f'after {clear}: '}1 goes on)"


def _command_of(velocity: Sequence[float]) -> str:
    forward, left, turn = (
        _signed(value, places)
        for value, places in zip((*velocity[:2], math.degrees(velocity[2])), (3, 3, 0), strict=True)
    )
    sideways = "" if left == _signed(0.0, 3) else f" left {left}"
    turning = "" if turn == _signed(0.0, 0) else f" turn {turn}°/s"
    return f"forward {forward}{sideways} m/s{turning}"


def _travel_of(status: dict[str, Any]) -> list[str]:
    distance, speed, heading = (status[name] for name in ("distance_m", "speed_m_s", "heading_deg"))
    at_speed = "" if speed is None else f" at {speed:.2f} m/s"
    moved = [] if distance is None else [f"{distance:.1f} m{at_speed}"]
    turned = [] if heading is None else [f"yaw {_signed(heading, 0)}°"]
    return [", ".join([*moved, *turned])] if moved or turned else []


def _signed(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:+.{places}f}"


@contextmanager
def single_keys(terminal: int) -> Iterator[None]:
    """Make a terminal's keys unbuffered and unechoed, without Ctrl-Z (suspend) and Ctrl-S (pause)."""
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        changed = termios.tcgetattr(terminal)
        changed[0] &= ~termios.IXON
        changed[6][termios.VSUSP] = b"\0"
        termios.tcsetattr(terminal, termios.TCSADRAIN, changed)
        yield
    finally:
        with suppress(termios.error, OSError):  # the terminal may be closed
            termios.tcsetattr(terminal, termios.TCSANOW, before)


class KeyTerminal:
    """A terminal with `single_keys`; its lines come from a thread, because a terminal may block."""

    def __init__(self, keys: int, lines: int) -> None:
        self.keys, self._lines = keys, lines
        self._newest = ""
        self._due = threading.Event()
        self._ended = False
        self._shower = threading.Thread(target=self._show_lines, daemon=True)

    def __enter__(self) -> Self:
        self._mode = ExitStack()
        self._mode.enter_context(single_keys(self.keys))
        self._shower.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended = True
        self._due.set()
        self._shower.join(LAST_LINE_S)  # later output must stay the last line
        with suppress(OSError):  # the terminal may be closed
            self._take_last_answers()
        self._mode.close()

    def show(self, line: str) -> None:
        """Replace the line, once the terminal accepts it."""
        self._newest = line
        self._due.set()

    def _take_last_answers(self) -> None:
        """Late answers would be typed into the shell."""
        until_s = time.monotonic() + LAST_ANSWERS_S
        while time.monotonic() < until_s and select.select([self.keys], [], [], LAST_ANSWER_S)[0]:
            if not os.read(self.keys, MOST_BYTES):
                return

    def _show_lines(self) -> None:
        while True:
            self._due.wait()
            self._due.clear()
            if self._ended:
                return
            try:
                width = os.get_terminal_size(self._lines).columns or 80
                shown = f"\r\x1b[K{printable(self._newest)[: width - 1]}{ASK_STATUS}"
                os.write(self._lines, shown.encode())
            except OSError:
                return


def has_keys() -> bool:
    """Whether this process has a terminal for keys."""
    return sys.stdin is not None and sys.stdin.isatty()
