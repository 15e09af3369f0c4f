"""Programs that stood still say so themselves, and blame neither the robot nor the link. Real processes."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hexctl.backends.zenoh.subscriber import GONE_AFTER_S
from tests.server.processes import Program, Served, program, served, wait_until

pytestmark = pytest.mark.realtime

STOOD_STILL = "this program stood still for"

#: The other program may have had no time on a busy machine, which it says then.
ATTEMPTS = 4


@contextmanager
def walking(folder: Path, robot: Served) -> Iterator[Program]:
    """A walk over the link that has begun."""
    options = ("--backend", "zenoh", "--connect", robot.endpoint, "--duration", "60", "--no-record")
    with program(folder, "run", "hexctl", "run", *options) as run:
        wait_until(lambda: robot.status()["posture"] == "commanded" or run.process.poll() is not None, "it")
        yield run


def freeze(frozen: Program, duration_s: float) -> None:
    """Stop a process for a time."""
    frozen.signal(signal.SIGSTOP)
    time.sleep(duration_s)
    frozen.signal(signal.SIGCONT)


@pytest.mark.parametrize("duration_s", [1.0, GONE_AFTER_S + 0.5])
def test_a_controller_that_was_frozen_says_so(tmp_path: Path, duration_s: float) -> None:
    with served(tmp_path, backend="sim") as robot, walking(tmp_path, robot) as run:
        freeze(run, duration_s)
        assert run.wait() == 3
        assert STOOD_STILL in " ".join(run.said().split())
        assert "start hexctl serve again" not in run.said()


def test_a_server_that_was_frozen_says_so_and_its_controller_does_not_blame_itself(tmp_path: Path) -> None:
    for attempt in range(ATTEMPTS):
        (place := tmp_path / str(attempt)).mkdir()
        with served(place, backend="sim") as robot, walking(place, robot) as run:
            freeze(robot, 1.0)
            run.wait()
            robot.wait_for(STOOD_STILL)
            robot.wait_for("STOPPED: expired")
        said = " ".join(run.said().split())
        if STOOD_STILL not in said:
            break
    assert "the program that serves it, was silent" in said
    assert robot.said().index(STOOD_STILL) < robot.said().index("STOPPED: expired")
