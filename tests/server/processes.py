"""Robots and controllers in processes, on loopback and free ports, and a relay that can be cut."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from faults.process import free_port as free_port
from hexctl.cli.main import exit_code
from hexctl.waiting import wait_for
from tests.server.recorded import VARIABLE, ServoLog

ROOT = Path(__file__).parents[2]
RECORDED = "tests.server.recorded:RecordedServos"

#: Longest a process may take to come up on a busy machine.
TIMEOUT_S = 60.0

#: How often a stop is repeated until its session answers.
MOST_STOPS = 10

Answer = TypeVar("Answer")


def wait_until(condition: Callable[[], Any], what: str, timeout_s: float = TIMEOUT_S) -> Any:
    """Value of a condition once it is true; fails when it never is."""
    return wait_for(condition, timeout_s, f"{what} never came")


def stopped_by_session(stop: Callable[[], Answer], answered: Callable[[Answer], bool]) -> Answer:
    """First answer to a stop that came over the session too.

    On a busy machine a robot may be seen at rest by datagram before its session has answered.
    """
    for _ in range(MOST_STOPS):
        if answered(answer := stop()):
            return answer
    raise AssertionError(f"no session has answered: {answer}")


@dataclass
class Program:
    """A running hexctl or test program.

    Attributes:
        process: its process.
        output: file of what it has printed so far, with stderr.
        name: in messages.
    """

    process: subprocess.Popen[str]
    output: Path
    name: str

    def said(self) -> str:
        """Everything it has printed."""
        return self.output.read_text(encoding="utf-8")

    def wait_for(self, text: str) -> None:
        """Wait until it has printed a text."""

        def there() -> bool:
            if text in self.said():
                return True
            assert self.process.poll() is None, f"{self.name} ended: {self.said()}"
            return False

        wait_until(there, f"{text!r} of {self.name}")

    def signal(self, number: signal.Signals) -> float:
        """Send a signal and return when, on time.monotonic."""
        self.process.send_signal(number)
        return time.monotonic()

    def end(self) -> int:
        """End it softly, or by force when that takes too long, and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
        return self.process.wait()

    def wait(self) -> int:
        """Wait for its own end and return its exit code."""
        return self.process.wait(TIMEOUT_S)


@contextmanager
def program(
    folder: Path, name: str, *arguments: str, cwd: Path | str = ROOT, **variables: str
) -> Iterator[Program]:
    """Run `python -m ...` until the block ends, in the checkout or another folder."""
    output = folder / f"{name}.out"
    with output.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(
            [sys.executable, "-u", "-m", *arguments],
            cwd=cwd,
            env={**os.environ, "HEXCTL_RUNS": str(folder / "runs"), **variables},
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # as tests/conftest.py says
        )
    running = Program(process, output, name)
    try:
        yield running
    finally:
        running.end()


@dataclass
class Served(Program):
    """A robot that `hexctl serve` puts on the network.

    Attributes:
        endpoint: where it listens.
        log_path: what its servos were told, for the recorded mock.
        keys: folder of certificates, or None.
    """

    endpoint: str = ""
    log_path: Path = field(default_factory=Path)
    keys: Path | None = None

    @property
    def port(self) -> int:
        """Where it listens for sessions and for datagrams."""
        return int(self.endpoint.rpartition(":")[2])

    def log(self) -> ServoLog:
        """Targets written to its servos so far."""
        return ServoLog.read(self.log_path)

    def status(self) -> dict[str, Any]:
        """Its status, as `hexctl status --json` prints it."""
        keys = () if self.keys is None else ("--keys", str(self.keys))
        answer = hexctl("status", "--json", "--connect", self.endpoint, *keys)
        assert answer.returncode == 0, answer.stderr
        content: dict[str, Any] = json.loads(answer.stdout)
        return content


@contextmanager
def served(
    folder: Path,
    *options: str,
    backend: str = RECORDED,
    port: int | None = None,
    name: str = "robot",
    keys: Path | None = None,
) -> Iterator[Served]:
    """Serve a robot in a separate process until the block ends, over TLS if keys are given.

    A stop is kept in the folder, for a later server of it.
    """
    endpoint = f"{'tcp' if keys is None else 'tls'}/127.0.0.1:{port or free_port()}"
    options = options if keys is None else (*options, "--keys", str(keys))
    log_path = folder / f"{name}.servos"
    log_path.touch()
    arguments = ("hexctl", "serve", "--backend", backend, "--listen", endpoint, *options)
    variables = {VARIABLE: str(log_path), "XDG_STATE_HOME": str(folder / "state")}
    with program(folder, name, *arguments, **variables) as running:
        running.wait_for("serving")
        yield Served(running.process, running.output, name, endpoint, log_path, keys)


@contextmanager
def controlling(folder: Path, endpoint: str, *options: str, name: str = "controller") -> Iterator[Program]:
    """Let a controller of its own process sway all joints until the block ends."""
    with program(folder, name, "tests.server.programs", "sway", endpoint, *options) as running:
        yield running


@contextmanager
def swayed(folder: Path, *, keys: Path | None = None) -> Iterator[Served]:
    """Serve a robot that a controller sways whenever it is not stopped."""
    options = ("again=1",) if keys is None else ("again=1", f"keys={keys}")
    with served(folder, keys=keys) as robot, controlling(folder, robot.endpoint, *options) as controller:
        controller.wait_for("moving")
        yield robot


@contextmanager
def repeated(act: Callable[[], object], period_s: float) -> Iterator[None]:
    """Do something again and again on a thread until the block ends."""
    until = threading.Event()

    def run() -> None:
        while not until.is_set():
            with suppress(OSError):
                act()
            until.wait(period_s)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        until.set()
        thread.join()


def hexctl(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command to its end, in this process: nothing but its start is spared."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(ROOT), redirect_stdout(out), redirect_stderr(err):
        code = exit_code(arguments)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


def hexctl_process(*arguments: str, timeout_s: float = TIMEOUT_S) -> subprocess.CompletedProcess[str]:
    """Run the command to its end in a process of its own, as several at a time must be."""
    return subprocess.run(
        [sys.executable, "-m", "hexctl", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


@contextmanager
def relayed(endpoint: str, *, at: int = 0) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Endpoint and process of a relay to a port of TCP or UDP.

    A frozen relay holds what is sent, as a pulled plug does; a killed one closes the connections, which come
    back once another one listens at its port.
    """
    kind, port = endpoint.partition("/")[0], endpoint.rpartition(":")[2]
    words = [sys.executable, "-u", "-m", "faults.programs.relay", kind, port, "1", str(at)]
    with subprocess.Popen(
        words,
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # as tests/conftest.py says
    ) as process:
        assert process.stdout is not None
        try:
            yield f"{kind}/127.0.0.1:{process.stdout.readline().split()[-1]}", process
        finally:
            process.kill()
