"""Viewers that subscribe and never read keep out no controller."""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from tests.server.processes import Served, hexctl_process, program, served

pytestmark = pytest.mark.realtime

#: Viewers of each process.
TOGETHER = 20

#: Viewers and turns: in the ordinary tests, and in the soak test.
FEW, MANY = (40, 2), (200, 20)

#: After this the robot has noticed that they are silent, and closes their connections, each for 10 s.
CLOSING_S = 12.0

COMMANDS = (
    ("status",),
    ("estop", "--clear"),
    ("run", "--backend", "zenoh", "--duration", "1", "--no-record"),
)


@contextmanager
def frozen_viewers(folder: Path, robot: Served, count: int) -> Iterator[None]:
    """Viewers whose processes are stopped, so that nothing is read."""
    with ExitStack() as stack:
        viewers = [
            stack.enter_context(
                program(folder, f"viewers-{number}", "tests.server.viewing", robot.endpoint, str(TOGETHER))
            )
            for number in range(count // TOGETHER)
        ]
        for one in viewers:
            one.wait_for("viewing")
        for one in viewers:
            one.signal(signal.SIGSTOP)
        try:
            yield
        finally:
            for one in viewers:
                one.signal(signal.SIGKILL)


def commands_work(folder: Path, viewers: int, turns: int) -> None:
    """Every command of an operator comes through, in each turn."""
    with served(folder) as robot, frozen_viewers(folder, robot, viewers):
        time.sleep(CLOSING_S)
        for turn in range(turns):
            for command in COMMANDS:
                result = hexctl_process(*command, "--connect", robot.endpoint)
                assert result.returncode == 0, (turn, command, result.stderr)
    sys.stderr.write(f"\n{viewers} frozen viewers: each command worked {turns} of {turns} times\n")


def test_frozen_viewers_keep_out_no_controller(tmp_path: Path) -> None:
    commands_work(tmp_path, *FEW)


@pytest.mark.soak
def test_two_hundred_frozen_viewers_keep_out_no_controller(tmp_path: Path) -> None:
    commands_work(tmp_path, *MANY)
