"""Programs of a rig in processes of their own: what they say, what they are told, how they end."""

import gc
import io
import multiprocessing
import os
import runpy
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path

from hexctl.waiting import wait_for

ROOT = Path(__file__).resolve().parents[1]

#: Longest a program may take to say what is waited for, on a busy machine.
PATIENCE_S = 40.0

#: Modules that programs import, which takes most of their start.
PRELOADED = [
    "faults.programs.controller",
    "faults.programs.trials",
    "faults.programs.twin_board",
    "hexctl.cli.main",
    "hexctl.cli.network.serve_command",
    "hexctl.server.server",
    "zenoh",
    "mujoco",
    "dm_control.mjcf",
]


class LostError(Exception):
    """A program ended, or never said what was waited for: nothing was measured."""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of loopback that is free now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Program:
    """`python -m ...` with its output in a file, forked from a process that has imported what programs need.

    Args:
        folder: of its input and output.
        name: of its output.
        arguments: behind `-m`.
        variables: of its environment, besides those here.

    Attributes:
        process: the process.
        pid: its number.
    """

    def __init__(self, folder: Path, name: str, *arguments: str, **variables: str) -> None:
        stem = f"{name}-{time.monotonic_ns()}"
        self.name, self._output = name, folder / f"{stem}.out"
        self._output.touch()
        # A stop that is kept for the next server is kept for none of another rig.
        variables = {"XDG_STATE_HOME": str(folder), **variables}
        lines = folder / f"{stem}.in"
        os.mkfifo(lines)
        # Opened for both, a pipe without a reader does not keep the opener waiting.
        self._input: int | None = os.open(lines, os.O_RDWR | os.O_CLOEXEC)
        self.process = _forks().Process(
            target=_run, args=(arguments, variables, str(lines), str(self._output)), name=name
        )
        self.process.start()
        assert self.process.pid is not None
        self.pid: int = self.process.pid

    def said(self, since: int = 0) -> str:
        """What it has printed, from a character on."""
        return self._output.read_text(encoding="utf-8")[since:]

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.is_alive()

    def tell(self, line: str) -> None:
        """Write a line to its input; one that has gone does not hear it."""
        if self.alive and self._input is not None:
            os.write(self._input, f"{line}\n".encode())

    def wait_for(
        self, text: str, since: int = 0, *, or_text: str | None = None, but: str | None = None
    ) -> str:
        """Wait until it has printed a text, or another one; everything it has printed then.

        Raises LostError where it ends before, says `but` instead, or takes too long.
        """

        def there() -> str | None:
            said = self.said(since)
            if text in said or (or_text is not None and or_text in said):
                return said
            if not self.alive or (but is not None and but in said):
                raise LostError(f"{self.name}: {_last_line(said) or 'ended'}")
            return None

        try:
            return wait_for(there, PATIENCE_S, f"{self.name} never says {text!r}")
        except RuntimeError as error:
            raise LostError(f"{error}: {_last_line(self.said(since))}") from error

    def signal(self, number: signal.Signals) -> float:
        """Send a signal; when, on time.monotonic."""
        now_s = time.monotonic()
        self._send(number)
        return now_s

    def end(self, *, softly: bool = False) -> None:
        """End it, frozen or not; softly as Ctrl-C does."""
        if softly:
            self._send(signal.SIGCONT)
            self._send(signal.SIGTERM)
            self.process.join(5)
        self.process.kill()
        self.process.join()
        if self._input is not None:
            os.close(self._input)
            self._input = None

    def _send(self, number: int) -> None:
        if self.alive:
            os.kill(self.pid, number)


def children_of(parent: int) -> list[int]:
    """Numbers of the processes that a process has started and that run."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            if int(fields[1]) == parent:
                found.append(int(path.parent.name))
    return found


@cache
def _forks() -> ForkServerContext:
    """Context whose processes are forked from one that has imported what takes long."""
    os.environ["MUJOCO_GL"] = "disable"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def _run(arguments: Sequence[str], variables: dict[str, str], lines: str, output: str) -> None:
    """Be `python -u -m ...`, in a process forked for it."""
    gc.freeze()  # what was imported before is never garbage, and a look at it copies its pages: 0.1 s
    os.chdir(ROOT)
    os.environ.update(variables)
    sys.path[:0] = variables.get("PYTHONPATH", "").split(os.pathsep)  # it was read before the fork
    os.dup2(os.open(lines, os.O_RDONLY), 0)
    for number in (1, 2):
        os.dup2(os.open(output, os.O_WRONLY | os.O_APPEND), number)
    sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(write_through=True)
    module, *rest = arguments
    sys.argv = [module, *rest]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]
