"""What a recorded walk keeps in memory does not grow with its length, nor with the number of recordings."""

import gc
import subprocess
import sys
import tracemalloc
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import PACED_BLOCK_TICKS, Recorders, TickLog
from hexctl.control.table import Table
from hexctl.control.trial import run_trial
from hexctl.recording import recording
from hexctl.recording.recording import Recording
from hexctl.robot.loader import load_robot
from tests.recording.conftest import make_plan

#: Rows of a chunk: the chunks that are kept are full after 4 s.
CHUNK_ROWS = 50

#: By then everything has happened once.
WARM_S = 15.0

#: Half a minute of rows alone would be ten times as much.
MOST_BYTES = 200_000


@dataclass
class Watch:
    """Notes how much Python has in memory, once a second."""

    bytes: list[int] = field(default_factory=list)
    block_ticks: int | None = 50

    def write_block(self, _log: TickLog, _start: int, _stop: int) -> None:
        gc.collect()
        self.bytes.append(tracemalloc.get_traced_memory()[0])


@pytest.mark.long
def test_memory_does_not_grow_with_the_length_of_a_walk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(Table.__init__.__kwdefaults__, "chunk_rows", CHUNK_ROWS)  # type: ignore[arg-type]
    monkeypatch.setattr(recording, "BLOCK_TICKS", 50)
    robot, watch, path = load_robot("ant"), Watch(), tmp_path / "walk.rrd"
    plan = make_plan(robot, duration_s=3 * WARM_S)
    with SimServos(robot) as servos, Recording(path, robot, plan, title="a walk") as recorded:
        recorders = Recorders(recorded, watch, block_ticks=PACED_BLOCK_TICKS)
        tracemalloc.start(1)
        try:
            run_trial(Guard(servos), plan, recorders=recorders)
        finally:
            tracemalloc.stop()
    assert not recorders.failures
    late = watch.bytes[int(WARM_S) :]
    assert len(late) > 2 * WARM_S - 2
    # The least of some seconds: a piece that is just being written does not count.
    assert min(late[-8:]) - min(late[:8]) < MOST_BYTES


CLOSED = """
import os, sys
from pathlib import Path
from hexctl.recording.recording import Recording
from hexctl.recording.rrd import load_rerun
from hexctl.robot.loader import load_robot
from hexctl.waiting import wait_for
load_rerun()  # before the tests do, without hexctl's choice of what Rerun logs
from tests.recording.conftest import make_plan

def threads():
    return len(os.listdir("/proc/self/task"))

robot = load_robot("ant")
plan = make_plan(robot)
first = None
for index in range(6):
    with Recording(Path(sys.argv[1]) / f"{index}.rrd", robot, plan, title="one of many"):
        pass
    first = first or threads()
# Two threads of each that is kept; one or two may be on their way out.
wait_for(lambda: threads() <= first + 2, 60, "closed recordings keep their threads")
print("freed")
"""


@pytest.mark.slow
def test_closed_recordings_are_let_go(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CLOSED, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("freed\n", "")


OF_THE_PROGRAM = """
import sys
from pathlib import Path
import rerun as rr
from hexctl.recording.recording import Recording
from hexctl.robot.loader import load_robot
from tests.recording.conftest import make_plan

rr.init("a program of its own")
rr.save(sys.argv[1] + "/own.rrd")
own = rr.get_global_data_recording().get_recording_id()
robot = load_robot("ant")
Recording(Path(sys.argv[1]) / "walk.rrd", robot, make_plan(robot), title="beside it").close()
assert rr.get_global_data_recording().get_recording_id() == own
"""


@pytest.mark.slow
def test_a_recording_of_the_program_itself_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-c", OF_THE_PROGRAM, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
