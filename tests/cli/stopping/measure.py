"""The causes for which a robot comes to rest, and how long each takes, many times."""

import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.cli.stopping.drives import Driven, LostDriveError
from tests.cli.stopping.hands import BrowserDriven, KeysDriven, LinkDriven, PadDriven, PageDriven

#: Within what a robot has to be at rest, in s: one that is let go of, and one that hears nothing more.
RELEASE_S, SILENCE_S = 0.3, 0.8

#: How long a robot walks before, at random, once it does.
WALK_S = (0.0, 0.6)

#: Robots at a time, with a browser each, and where each stop costs a start.
LANES, BROWSERS, RESTARTED_LANES = 2, 1, 5

#: Drives that may be lost on the way, as on a machine that was too busy, for each stop that is wanted.
LOST_SHARE = 0.5

#: How often is looked how late this machine is.
PULSE_S = 0.01


@dataclass(frozen=True)
class Cause:
    """Why a robot shall be at rest.

    Attributes:
        what: happens, in words.
        bar_s: within what the robot has to be at rest.
        driven: makes a robot to which it happens.
        lanes: how many such robots at a time.
    """

    what: str
    bar_s: float
    driven: Callable[[Path, random.Random], Driven]
    lanes: int = LANES


def _cause(what: str, bar_s: float, kind: type, how: str, lanes: int = LANES) -> Cause:
    return Cause(what, bar_s, lambda folder, chance: kind(folder, chance, how), lanes)


CAUSES = {
    "pad-released": _cause("hold button of a gamepad let go", RELEASE_S, PadDriven, "released"),
    "finger-lifted": _cause("finger lifted, in a browser", RELEASE_S, BrowserDriven, "lifted", BROWSERS),
    "page-released": _cause("release of a page's client", RELEASE_S, PageDriven, "released"),
    "page-stop": _cause("STOP of the page, a finger still down", RELEASE_S, PageDriven, "stop"),
    "key-stop": _cause("key x", RELEASE_S, KeysDriven, "stop"),
    "space": _cause("space bar", RELEASE_S, KeysDriven, "space"),
    "link-released": _cause("hold button let go, over the link", RELEASE_S, LinkDriven, "released"),
    "pad-ended": _cause("gamepad pulled out, its file ends", SILENCE_S, PadDriven, "ended"),
    "pad-gone": _cause("gamepad pulled out, its device hangs up", SILENCE_S, PadDriven, "gone"),
    "tab-closed": _cause("tab closed, in a browser", SILENCE_S, BrowserDriven, "left", BROWSERS),
    "page-closed": _cause("page's socket closed", SILENCE_S, PageDriven, "closed"),
    "page-killed": _cause("page's client killed", SILENCE_S, PageDriven, "killed"),
    "page-silent": _cause("page's client silent, socket open", SILENCE_S, PageDriven, "silent"),
    "terminal-closed": _cause("terminal closed", SILENCE_S, KeysDriven, "closed", RESTARTED_LANES),
    "terminal-hangup": _cause("SIGHUP", SILENCE_S, KeysDriven, "hangup", RESTARTED_LANES),
    "terminal-killed": _cause("terminal's process killed", SILENCE_S, KeysDriven, "killed", RESTARTED_LANES),
    "terminal-frozen": _cause("terminal silent, as over a lost network", SILENCE_S, KeysDriven, "frozen"),
    "drive-killed": _cause("drive killed, over the link", SILENCE_S, LinkDriven, "killed", RESTARTED_LANES),
    "drive-stopped": _cause("drive frozen, over the link", SILENCE_S, LinkDriven, "stopped", RESTARTED_LANES),
    "link-held": _cause("link passes nothing on", SILENCE_S, LinkDriven, "held", RESTARTED_LANES),
    "link-cut": _cause("link's connections closed", SILENCE_S, LinkDriven, "cut", RESTARTED_LANES),
}


@dataclass(frozen=True)
class Stops:
    """Robots that came to rest, (n,) each.

    Attributes:
        cause: why.
        rest_s: how long after the cause their targets changed last.
        late_s: by how much a thread of ordinary priority was late at most in that time.
        lost: drives that ended before the cause, as on a machine that is too busy.
    """

    cause: Cause
    rest_s: list[float]
    late_s: list[float]
    lost: int

    @property
    def within(self) -> int:
        return sum(rest_s <= self.cause.bar_s for rest_s in self.rest_s)

    def __str__(self) -> str:
        return (
            f"{self.cause.what}: median {np.median(self.rest_s):.2f} s, greatest {max(self.rest_s):.2f} s, "
            f"{self.within} of {len(self.rest_s)} within {self.cause.bar_s:g} s; a thread here was late by "
            f"{np.median(self.late_s):.3f} s on the median, {max(self.late_s):.3f} s at most"
            + (f"; {self.lost} drives lost before" if self.lost else "")
        )


class Pulse:
    """A thread that wakes again and again, and notes how late it does."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []
        self._ended = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()

    def end(self) -> None:
        self._ended.set()

    def late_s(self, from_s: float, to_s: float) -> float:
        return max((late for at, late in list(self._seen) if from_s <= at <= to_s + PULSE_S), default=0.0)

    def _run(self) -> None:
        while not self._ended.is_set():
            due_s = time.monotonic() + PULSE_S
            time.sleep(PULSE_S)
            now_s = time.monotonic()
            self._seen.append((now_s, now_s - due_s))


class Measurement:
    """Stops of one cause, by one or more robots at a time."""

    def __init__(self, name: str, times: int, folder: Path) -> None:
        self._name, self._times, self._folder = name, times, folder
        self._cause = CAUSES[name]
        self._pulse = Pulse()
        self._lock = threading.Lock()
        self._begun = self._lost = 0
        self._found: list[tuple[float, float]] = []
        self._failure: BaseException | None = None

    def run(self) -> Stops:
        lanes = range(min(self._times, self._cause.lanes))
        threads = [threading.Thread(target=self._lane, args=(lane,)) for lane in lanes]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self._pulse.end()
        if self._failure is not None:
            raise self._failure
        rest_s, late_s = zip(*self._found, strict=True)
        return Stops(self._cause, list(rest_s), list(late_s), self._lost)

    def _lane(self, lane: int) -> None:
        chance = random.Random(f"{self._name} {lane}")
        try:
            robots = 0
            while self._wanted():
                robots += 1
                (folder := self._folder / f"{self._name}-{lane}-{robots}").mkdir()
                self._stop_often(folder, chance)
        except BaseException as failure:  # noqa: BLE001  raised where it is waited for
            self._failure = failure

    def _wanted(self) -> bool:
        with self._lock:
            return self._failure is None and self._begun < self._times

    def _stop_often(self, folder: Path, chance: random.Random) -> None:
        try:
            with self._cause.driven(folder, chance) as robot:
                while self._take():
                    self._stop(robot, chance)
                    robot.again()
        except LostDriveError:
            with self._lock:
                self._lost += 1
                self._begun = len(self._found)  # others may do one more
            if self._lost > 2 + LOST_SHARE * self._times:
                raise

    def _take(self) -> bool:
        with self._lock:
            if self._failure is not None or self._begun >= self._times:
                return False
            self._begun += 1
            return True

    def _stop(self, robot: Driven, chance: random.Random) -> None:
        robot.walk()
        time.sleep(chance.uniform(*WALK_S))
        robot.check()
        at_s = robot.cause()
        rest_s = robot.servos.rest_after_s(at_s)
        self._found.append((rest_s, self._pulse.late_s(at_s, at_s + rest_s)))
