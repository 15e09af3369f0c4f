"""`hexctl drive` whose gamepad, page or terminal is lost: the targets of the robot's servos come to rest."""

import os
import re
import signal
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from hexctl.teleop.gamepad import EVENT
from hexctl.waiting import wait_for
from tests.cli.terminals import COMMAND
from tests.server.processes import RECORDED, ROOT, Program, program
from tests.server.recorded import VARIABLE, ServoLog

pytestmark = [pytest.mark.realtime, pytest.mark.long]

#: A robot whose targets have not changed for this long is at rest: longer than a command holds.
QUIET_S = 0.6

#: Targets that change in each of this many ticks, by more than this in all, are a walk.
WALK_TICKS, WALK_RAD = 15, 0.03

#: How long a robot may take to walk, and to come to rest, on a machine however busy.
PATIENCE_S = 20.0

HOLD, STICK_Y = (1, 310), (3, 1)


def walks(servos: Path) -> bool:
    log = ServoLog.read(servos)
    if len(log.times_s) <= WALK_TICKS or time.monotonic() - log.times_s[-1] > 0.1:
        return False
    last_rad = log.joint_positions_rad[-WALK_TICKS - 1 :]
    changed = (np.diff(last_rad, axis=0) != 0).any(axis=1)
    return bool(changed.all()) and float(np.ptp(last_rad, axis=0).max()) > WALK_RAD


def rests(servos: Path, since_s: float) -> bool:
    return time.monotonic() - since_s > ServoLog.read(servos).moved_after(since_s) + QUIET_S


@contextmanager
def drive(folder: Path, *arguments: str) -> Iterator[Program]:
    """Run `hexctl drive` without a terminal."""
    words = ("hexctl", "drive", "--no-keyboard", "--backend", RECORDED, *arguments)
    with program(folder, "drive", *words, **{VARIABLE: str(folder / "servos")}) as running:
        yield running


@contextmanager
def unplugged_pad(folder: Path) -> Iterator[Callable[[], None]]:
    """Hold a stick of a gamepad. Its event file is a terminal: once closed, it is an error to read."""
    writing, other = os.openpty()
    tty.setraw(other)
    pad = folder / "pad"
    pad.symlink_to(os.ttyname(other))

    def unplug() -> None:
        pad.unlink()
        os.close(writing)
        os.close(other)

    with drive(folder, "--gamepad", str(pad)):
        for what, value in ((STICK_Y, -32767), (HOLD, 1)):
            os.write(writing, EVENT.pack(0, 0, *what, value))
        yield unplug


@contextmanager
def lost_page(folder: Path, number: signal.Signals) -> Iterator[Callable[[], None]]:
    """Drive with the page; its client is killed, or silent with an open socket."""
    with drive(folder, "--page", "127.0.0.1:0", "--gamepad", "none") as running:
        running.wait_for("drive on")
        port = re.search(r"127\.0\.0\.1:(\d+)/", running.said())
        assert port is not None
        words = [sys.executable, "-m", "tests.teleop.flooding", port[1], "valid", "25"]
        with subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE) as client:
            yield lambda: client.send_signal(number)
            client.kill()


#: A terminal's process, which answers status queries, and what it starts: `hexctl drive`.
EMULATOR = """
import os, pty, sys

def shown(terminal):
    data = os.read(terminal, 1024)
    os.write(terminal, b"\\x1b[0n" * data.count(b"\\x1b[5n"))
    return data

pty.spawn(sys.argv[1:], shown)
"""
NAMED = f"import os, pathlib; pathlib.Path('begun').write_text(str(os.getpid())); {COMMAND}"


@contextmanager
def lost_terminal(folder: Path, number: signal.Signals) -> Iterator[Callable[[], None]]:
    """Drive with keys of a terminal of another process, which is killed or frozen."""
    shown = folder / "terminal.out"
    words = ["drive", "--backend", RECORDED, "--gamepad", "none"]
    with ExitStack() as stack:
        terminal = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-c", EMULATOR, sys.executable, "-c", NAMED, *words],
                cwd=folder,
                env={**os.environ, VARIABLE: str(folder / "servos")},
                stdin=subprocess.PIPE,
                stdout=stack.enter_context(shown.open("wb")),
                stderr=subprocess.STDOUT,
            )
        )
        stack.callback(kill, folder / "begun")
        stack.callback(terminal.kill)
        assert terminal.stdin is not None
        wait_for(lambda: b"driving" in shown.read_bytes(), PATIENCE_S, "it does not drive")
        terminal.stdin.write(b"wwwww")
        terminal.stdin.flush()
        yield lambda: terminal.send_signal(number)


def kill(named: Path) -> None:
    """Kill the drive, whose terminal may be frozen."""
    with suppress(FileNotFoundError, ProcessLookupError):
        os.kill(int(named.read_text()), signal.SIGKILL)


@pytest.mark.parametrize(
    "lost",
    [
        unplugged_pad,
        lambda folder: lost_page(folder, signal.SIGKILL),
        lambda folder: lost_page(folder, signal.SIGSTOP),
        lambda folder: lost_terminal(folder, signal.SIGKILL),
        lambda folder: lost_terminal(folder, signal.SIGSTOP),
    ],
    ids=["pad unplugged", "page killed", "page silent", "terminal killed", "terminal frozen"],
)
def test_a_robot_whose_driver_is_lost_comes_to_rest(
    lost: Callable[[Path], AbstractContextManager[Callable[[], None]]], tmp_path: Path
) -> None:
    servos = tmp_path / "servos"
    servos.touch()
    with lost(tmp_path) as lose:
        wait_for(lambda: walks(servos), PATIENCE_S, "the robot does not walk")
        since_s = time.monotonic()
        lose()
        wait_for(lambda: rests(servos, since_s), PATIENCE_S, "the robot does not come to rest")
