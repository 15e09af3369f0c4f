"""Commands on pseudo-terminals, and programs of `python -c`."""

import os
import pty
import re
import select
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

import pytest

from hexctl.waiting import wait_for
from tests.server.processes import ROOT

WAIT_S = 60.0

#: How long the test's end waits for output at a time.
READ_S = 0.05

#: How long the output of a process that has ended may take to be read.
READ_END_S = 2.0

#: Programs for `python -c`: the command, as it is; and as a shell starts it, with the terminal its own, which
#: then sends it SIGHUP when it goes.
COMMAND = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from hexctl.cli.entry import main; main()"
WITH_TERMINAL = f"import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); {COMMAND}"


def type_in(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Put a text on stdin, as if a user had typed it."""
    reading, writing = os.pipe()
    os.write(writing, text.encode())
    os.close(writing)
    monkeypatch.setattr(sys, "stdin", os.fdopen(reading))


def run_program(program: str, *arguments: str, **variables: str) -> "subprocess.CompletedProcess[str]":
    """Run a program of `python -c` to its end."""
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


#: A program whose files may have so many bytes, and the words of hexctl.
FULL_DISK = """
import resource, signal, sys
from hexctl.cli.main import exit_code
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
sys.exit(exit_code(sys.argv[2:]))
"""


class OnTerminal:
    """A command in a process, on a terminal whose other end the test holds, until the block ends.

    Args:
        folder: it works in.
        arguments: of the command.
        command: of hexctl.
        program: for `python -c`.
        variables: added to the environment.
    """

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        command: str = "drive",
        program: str = COMMAND,
        variables: Mapping[str, str] | None = None,
    ) -> None:
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", program, command, *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            cwd=folder,
            env={**os.environ, **(variables or {})},
        )
        os.close(slave)
        self.shown = ""
        self._closing = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.close()

    def _read(self) -> None:
        while not self._closing:
            # A read that waits would keep the terminal open after its close.
            ready, _, _ = select.select([self.master], [], [], READ_S)
            if not ready:
                continue
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            if not data:
                return
            self.shown += data.decode(errors="replace")

    def wait(self, pattern: str) -> str:
        """What the terminal shows, once a pattern is in it."""
        wait_for(
            lambda: re.search(pattern, self.shown) is not None or self.process.poll() is not None,
            WAIT_S,
            f"{pattern!r} is not shown",
        )
        if self.process.poll() is not None:
            self._reader.join(READ_END_S)  # what it said last may not be read yet
        assert re.search(pattern, self.shown), self.shown[-600:]
        return self.shown

    def type(self, keys: str) -> None:
        """Press keys."""
        os.write(self.master, keys.encode())

    def close(self) -> None:
        """Close the terminal."""
        self._closing = True
        self._reader.join()
        if self.master >= 0:
            os.close(self.master)
            self.master = -1

    def code(self) -> int:
        """Exit code, once it has ended."""
        return self.process.wait(WAIT_S)


def wait_until_it_grows(path: Path) -> None:
    """Wait until some of the walk is in its recording, behind the scene."""
    sizes: set[int] = set()

    def grown() -> bool:
        with suppress(FileNotFoundError):  # a first file only shows that the folder can be written
            sizes.add(path.stat().st_size)
        time.sleep(0.3)
        return len(sizes) > 5

    wait_for(grown, WAIT_S, f"{path} does not grow")
