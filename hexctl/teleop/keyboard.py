"""The keyboard of a terminal: each key changes the speed that is set, which holds until another changes it.

Terminals tell no release of a key, and repeat one that is held only after half a second, so keys latch.
"""

import math
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, Self

from hexctl.control.drive.arbiter import Velocity, VelocitySource

#: By how much a key changes the speed, of the greatest.
STEP = 0.2

#: What keys do: forward, left and turn to add, or a request of the session.
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
REQUEST_KEYS = {"q": "quit", "g": "gait", "u": "up", "j": "down", "1": "stand", "0": "sit", "x": "stop"}

HELP = (
    "w s or arrows: faster, slower · a d: sideways · left right arrows: turn · space: stand still\n"
    "g: gait · u j: body up, down · 1: stand up · 0: sit down · x: stop (1 goes on) · q: quit"
)

#: Bytes of keys that are read in one tick.
MOST_BYTES = 256

#: What makes a velocity of shares of the greatest, -1 to 1: forward, left, turn.
Share = Callable[[float, float, float], Velocity]


class Keyboard:
    """Keys of a terminal as a source of velocities.

    While a speed is set it is repeated every tick, as long as the terminal is there; a terminal that has gone
    ends the session.

    Args:
        source: of the arbiter.
        share: makes velocities.
        ask: takes requests and why.
        keys: file descriptor to read keys from; it may block.
        show: takes a line that says what the robot does; None shows nothing.
    """

    def __init__(
        self,
        source: VelocitySource,
        share: Share,
        ask: Callable[[str, str], None],
        keys: int,
        show: Callable[[str], None] | None = None,
    ) -> None:
        self._source, self._share, self._ask, self._keys, self._show = source, share, ask, keys, show
        self._set = (0.0, 0.0, 0.0)
        self._pending = ""
        self._gone = False

    def poll(self) -> None:
        """Take the keys since the last tick."""
        if self._gone:
            return
        try:
            ready, _, _ = select.select([self._keys], [], [], 0)
            data = os.read(self._keys, MOST_BYTES) if ready else None
        except OSError:
            data = b""
        if data == b"":
            self._leave()
            return
        for key in self._keys_of((data or b"").decode(errors="replace")):
            self.press(key)
        if any(self._set):
            self._source.command(self._share(*self._set))

    def press(self, key: str) -> None:
        """Do what a key says."""
        if key in SPEED_KEYS:
            changed = zip(self._set, SPEED_KEYS[key], strict=True)
            forward, left, turn = (max(-1.0, min(1.0, round(a + STEP * b, 6))) for a, b in changed)
            self._set = forward, left, turn
            if not any(self._set):
                self._source.release()
        elif key in (" ", "\x1b") or key == "x":
            self._set = 0.0, 0.0, 0.0
            self._source.release()
        if key in REQUEST_KEYS:
            self._ask(REQUEST_KEYS[key], "q" if key == "q" else "")

    def report(self, status: dict[str, Any]) -> None:
        """Show a line."""
        if self._show is not None and not self._gone:
            self._show(line_of(status))

    def _keys_of(self, text: str) -> list[str]:
        """Keys of a text; the beginning of an arrow key waits for its end until the next tick."""
        text, self._pending = self._pending + text, ""
        keys = []
        while text:
            if text[0] == "\x1b" and text[:2] in ("\x1b[", "\x1bO") and len(text) >= 3:
                keys.append("\x1b[" + text[2])
                text = text[3:]
            elif text in ("\x1b[", "\x1bO"):
                self._pending, text = text, ""
            else:
                keys.append(text[0])
                text = text[1:]
        return keys

    def _leave(self) -> None:
        self._gone, self._set = True, (0.0, 0.0, 0.0)
        self._source.release()
        self._ask("quit", "the terminal has gone")


def line_of(status: dict[str, Any]) -> str:
    """What a robot does, in a line of a terminal."""
    forward, left, turn = status["velocity"]
    battery = status["battery_v"]
    parts = [
        f"forward {forward:+.3f} left {left:+.3f} m/s turn {math.degrees(turn):+.0f} deg/s",
        status["gait"],
        status["mode"] if status["stopped"] is None else f"STOPPED: {status['stopped']} (1 goes on)",
        *([] if status["source"] is None else [status["source"]]),
        *([] if battery is None else [f"{battery:.1f} V"]),
        *([status["said"]] if status["said"] else []),
    ]
    return " · ".join(parts)


class KeyTerminal:
    """A terminal whose keys come one by one, unechoed, while this is open; lines are shown in one place.

    Ctrl-Z is switched off: a robot must not be left to a process that stands still. What is shown goes
    through a thread, so that a terminal that takes no more, as after Ctrl-S, costs no tick.

    Args:
        keys: file descriptor of the terminal.
        lines: file descriptor that lines are written to.
    """

    def __init__(self, keys: int, lines: int) -> None:
        self.keys, self._lines = keys, lines
        self._newest = ""
        self._due = threading.Event()
        self._ended = False
        self._shower = threading.Thread(target=self._show_lines, daemon=True)

    def __enter__(self) -> Self:
        self._before = termios.tcgetattr(self.keys)
        tty.setcbreak(self.keys)
        changed = termios.tcgetattr(self.keys)
        changed[6][termios.VSUSP] = b"\0"
        termios.tcsetattr(self.keys, termios.TCSADRAIN, changed)
        self._shower.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._due.set()
        with suppress(termios.error):  # the terminal may have gone
            termios.tcsetattr(self.keys, termios.TCSANOW, self._before)

    def show(self, line: str) -> None:
        """Show a line instead of the last one, as soon as the terminal takes it."""
        self._newest = line
        self._due.set()

    def _show_lines(self) -> None:
        while True:
            self._due.wait()
            self._due.clear()
            if self._ended:
                return
            try:
                width = os.get_terminal_size(self._lines).columns or 80
                os.write(self._lines, f"\r\x1b[K{self._newest[: width - 1]}".encode())
            except OSError:
                return


def has_keys() -> bool:
    """Whether this process has a terminal to read keys from."""
    return sys.stdin is not None and sys.stdin.isatty()
