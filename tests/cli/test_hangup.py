"""A terminal that is closed ends a command as Ctrl-C does: the robot at rest, what it recorded whole."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from hexctl.cli.console import StopOnInterrupt
from hexctl.recording.recorded_trial import read_trial
from hexctl.signals import ending_signals
from hexctl.waiting import wait_for
from tests.cli.terminals import WAIT_S, WITH_TERMINAL, OnTerminal
from tests.server.processes import free_port

pytestmark = pytest.mark.realtime


@contextmanager
def on_terminal(folder: Path, command: str, *arguments: str) -> Iterator[OnTerminal]:
    """Run a command on a terminal of its own, which sends it SIGHUP when it goes, until the block ends."""
    made = OnTerminal(arguments, folder, program=WITH_TERMINAL, command=command)
    try:
        yield made
    finally:
        made.end()


def wait_until_it_grows(path: Path) -> None:
    """Wait until some of the walk is in its recording, behind the scene."""
    sizes: set[int] = set()

    def grown() -> bool:
        with suppress(FileNotFoundError):  # a first file only shows that the folder can be written
            sizes.add(path.stat().st_size)
        time.sleep(0.3)
        return len(sizes) > 5

    wait_for(grown, WAIT_S, f"{path} does not grow")


def test_a_walk_ends_with_a_soft_stop_and_a_whole_recording(tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    with on_terminal(tmp_path, "run", "--realtime", "--duration", "600", "--record", str(path)) as terminal:
        wait_until_it_grows(path)
        terminal.close()
        assert terminal.code() == 130
    trial = read_trial(path)
    assert trial.phases[-1] == 3  # the soft stop, to its end
    legs_rad = trial.commanded_rad[-1].reshape(6, 3)
    assert (abs(legs_rad - legs_rad[0]) < 1e-3).all(), "it stands on six legs that are bent alike"
    assert (abs(trial.commanded_rad[-1] - trial.commanded_rad[-2]) < 1e-2).all(), "below 0.5 rad/s"


def test_a_search_ends_and_can_be_resumed(tmp_path: Path) -> None:
    arguments = ("--failed-leg", "5", "--duration", "20", "--budget", "500", "--no-record")
    with on_terminal(tmp_path, "adapt", *arguments) as terminal:
        terminal.wait(r"session \S+")
        terminal.close()
        assert terminal.code() == 130
    listed = subprocess.run(
        [sys.executable, "-m", "hexctl", "sessions", "list", "--json"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        check=True,
    )
    assert len(json.loads(listed.stdout)) == 1


def test_a_server_ends_as_by_ctrl_c(tmp_path: Path) -> None:
    with on_terminal(
        tmp_path, "serve", "--backend", "mock", "--listen", f"tcp/127.0.0.1:{free_port()}"
    ) as terminal:
        terminal.wait("serving|listens|at tcp")
        terminal.close()
        assert terminal.code() == 0


@pytest.fixture
def _hangup() -> Iterator[None]:
    """The handler of before, after the test."""
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("_hangup")
def test_a_hangup_that_is_ignored_stays_so() -> None:
    """As under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with StopOnInterrupt() as interrupt:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not interrupt.requested()
    assert signal.SIGHUP not in ending_signals()


@pytest.mark.usefixtures("_hangup")
def test_two_hangups_are_one_and_ctrl_c_still_ends() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    with StopOnInterrupt() as interrupt:
        for _ in range(2):  # of the kernel and of a shell
            os.kill(os.getpid(), signal.SIGHUP)
        assert interrupt.requested()
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
