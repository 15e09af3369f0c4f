"""Programs of a rig in processes of their own: what they say, what they are told, how they end."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from hexctl.waiting import wait_for

ROOT = Path(__file__).resolve().parents[1]

#: Longest a program may take to say what is waited for, on a busy machine.
PATIENCE_S = 40.0


class LostError(Exception):
    """A program ended, or never said what was waited for: nothing was measured."""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of loopback that is free now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Program:
    """`python -m ...` with its output in a file.

    Args:
        folder: of its output.
        name: of its output.
        arguments: behind `-m`.
        variables: of its environment, besides those here.

    Attributes:
        process: the process.
    """

    def __init__(self, folder: Path, name: str, *arguments: str, **variables: str) -> None:
        self.name, self._output = name, folder / f"{name}-{time.monotonic_ns()}.out"
        with self._output.open("w", encoding="utf-8") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-u", "-m", *arguments],
                cwd=ROOT,
                env={**os.environ, "MUJOCO_GL": "disable", **variables},
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
            )

    def said(self, since: int = 0) -> str:
        """What it has printed, from a character on."""
        return self._output.read_text(encoding="utf-8")[since:]

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self.process.poll() is None

    def tell(self, line: str) -> None:
        """Write a line to its input; one that has gone does not hear it."""
        assert self.process.stdin is not None
        with suppress(OSError):
            self.process.stdin.write(f"{line}\n".encode())
            self.process.stdin.flush()

    def wait_for(self, text: str, since: int = 0, *, but: str | None = None) -> str:
        """Wait until it has printed a text; everything it has printed then.

        Raises LostError where it ends before, says `but` instead, or takes too long.
        """

        def there() -> str | None:
            said = self.said(since)
            if text in said:
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
        self.process.send_signal(number)
        return now_s

    def end(self, *, softly: bool = False) -> None:
        """End it, frozen or not; softly as Ctrl-C does."""
        with suppress(ProcessLookupError):
            if softly and self.alive:
                self.process.send_signal(signal.SIGCONT)
                self.process.send_signal(signal.SIGTERM)
                with suppress(subprocess.TimeoutExpired):
                    self.process.wait(5)
            self.process.kill()
        self.process.wait()
        if self.process.stdin is not None:
            with suppress(OSError):
                self.process.stdin.close()


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]
