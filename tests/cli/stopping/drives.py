"""Robots that are driven, and when their servos were told to go elsewhere last."""

import os
import random
import re
import signal
import subprocess
import sys
import time
import tty
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from hexctl.teleop.gamepad import EVENT
from hexctl.waiting import wait_for
from tests.server.processes import RECORDED, ROOT
from tests.server.recorded import VARIABLE, ServoLog

#: A robot whose targets have not changed for so long is at rest: longer than a command holds.
QUIET_S = 0.6

#: Targets that change in each of so many ticks on end, by more than this in all, are a walk.
WALK_TICKS, WALK_RAD = 15, 0.03

#: How long a robot may take to walk, and to come to rest, on a machine however busy.
PATIENCE_S = 20.0

HOLD, STICK_X, STICK_Y, TURN = (1, 310), (3, 0), (3, 1), (3, 3)


class LostDriveError(Exception):
    """The drive ended, or did not begin, before anything was measured."""


@dataclass(frozen=True)
class Servos:
    """Servos of a robot in another process, by the log that they write."""

    path: Path

    def walking(self) -> bool:
        log = ServoLog.read(self.path)
        if len(log.times_s) <= WALK_TICKS or time.monotonic() - log.times_s[-1] > 0.1:
            return False
        last_rad = log.joint_positions_rad[-WALK_TICKS - 1 :]
        new = (np.diff(last_rad, axis=0) != 0).any(axis=1)
        return bool(new.all()) and float(np.ptp(last_rad, axis=0).max()) > WALK_RAD

    def told_after(self, at_s: float) -> bool:
        log = ServoLog.read(self.path)
        return bool((log.times_s > at_s).any())

    def rest_after_s(self, at_s: float) -> float:

        def rested() -> list[float]:
            now_s = time.monotonic()
            last_s = ServoLog.read(self.path).moved_after(at_s)
            return [last_s] if now_s - at_s > last_s + QUIET_S else []

        return wait_for(rested, PATIENCE_S, "the robot does not come to rest", poll_s=0.02)[0]


class Driven(ABC):
    """A robot that is driven, again and again: `walk`, `cause`, `again`.

    Args:
        folder: for its files, empty.
        chance: of what it is told.
        how: its walks end.
    """

    def __init__(self, folder: Path, chance: random.Random, how: str) -> None:
        self.folder, self.chance, self._how = folder, chance, how
        self.drive: Process | None = None
        self.servos = Servos(folder / "servos")
        self.servos.path.touch()

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    @abstractmethod
    def begin(self) -> None:
        """Start what takes long."""

    def end(self) -> None:
        if self.drive is not None:
            self.drive.end()

    @abstractmethod
    def command(self) -> None:
        """Tell the robot to walk somewhere."""

    @abstractmethod
    def cause(self) -> float:
        """What is to end the walk; when it began, on time.monotonic."""

    def alive(self) -> bool:
        return self.drive is not None and self.drive.alive()

    def said(self) -> str:
        return "" if self.drive is None else self.drive.said()

    def again(self) -> None:
        return

    def walk(self) -> None:
        self.command()
        wait_for(lambda: self.servos.walking() or not self.alive(), PATIENCE_S, "the robot does not walk")
        self.check()

    def check(self) -> None:
        if not self.alive():
            raise LostDriveError(self.said())

    def shares(self) -> tuple[float, float, float]:
        angle = self.chance.choice([0.0, 0.25, 0.5, 0.75]) + self.chance.uniform(-0.1, 0.1)
        turn = self.chance.choice([0.0, self.chance.uniform(-1, 1)])
        return float(np.cos(2 * np.pi * angle)), float(np.sin(2 * np.pi * angle)), turn


class Process:
    """`hexctl drive` without a terminal, its output in a file."""

    def __init__(self, folder: Path, log: Path, *arguments: str) -> None:
        self.output = folder / "drive.out"
        with self.output.open("w", encoding="utf-8") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-u", "-m", "hexctl", "drive", "--no-keyboard", *arguments],
                cwd=ROOT,
                env={**os.environ, VARIABLE: str(log)},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )

    def said(self) -> str:
        return self.output.read_text(encoding="utf-8")

    def wait_for(self, pattern: str) -> re.Match[str]:

        def found() -> list[re.Match[str] | None]:
            match = re.search(pattern, self.said())
            return [match] if match or self.process.poll() is not None else []

        match = wait_for(found, PATIENCE_S, f"{pattern} is not said")[0]
        if match is None:
            raise LostDriveError(self.said())
        return match

    def alive(self) -> bool:
        return self.process.poll() is None

    def signal(self, number: signal.Signals) -> float:
        now_s = time.monotonic()
        self.process.send_signal(number)
        return now_s

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


class Pad:
    """A gamepad: an event file that comes and goes, either a pipe, or a terminal whose driver leaves it.

    A pipe without a writer reads as ended; the file of a device that has gone is an error to read.
    """

    def __init__(self, path: Path, *, pipe: bool) -> None:
        self.path, self._pipe = path, pipe
        self._writing = self._other = -1

    def plug_in(self) -> None:
        if self._pipe:
            os.mkfifo(self.path)
            self._writing = os.open(self.path, os.O_RDWR)
            return
        self._writing, self._other = os.openpty()
        tty.setraw(self._other)
        self.path.symlink_to(os.ttyname(self._other))

    def press(self, forward: float, left: float, turn: float) -> None:
        for axis, share in ((STICK_Y, -forward), (STICK_X, -left), (TURN, -turn)):
            self._send(axis, round(32767 * share))
        self._send(HOLD, 1)

    def release(self) -> float:
        now_s = time.monotonic()
        self._send(HOLD, 0)
        return now_s

    def plug_out(self) -> float:
        self.path.unlink(missing_ok=True)
        now_s = time.monotonic()
        for end in (self._writing, self._other):
            if end >= 0:
                os.close(end)
        self._writing = self._other = -1
        return now_s

    def _send(self, what: tuple[int, int], value: int) -> None:
        with suppress(BrokenPipeError):
            os.write(self._writing, EVENT.pack(0, 0, *what, value))


def local(folder: Path, servos: Servos, *arguments: str) -> Process:
    """A drive whose robot is in its own process."""
    return Process(folder, servos.path, "--backend", RECORDED, *arguments)
