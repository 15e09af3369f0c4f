"""`--view` with a real window: whatever becomes of it, the walk and its recording are whole."""

import json
import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.recording.test_live import ROBOT, rows_at
from tests.server.processes import Program, program, wait_until
from tests.trials import walk as walk_alone
from tests.viewer.conftest import Place

pytestmark = pytest.mark.long

#: Walks this long; with settling before and coming to a stand after.
WALK_S = 2.0


def viewer_of(walk: Program) -> int:
    """The process of the window that a walk has opened."""

    def found() -> int | None:
        assert walk.process.poll() is None, walk.said()
        for status in Path("/proc").glob("[0-9]*/stat"):
            try:
                name, _, rest = status.read_text().partition("(")[2].rpartition(")")
            except OSError:
                continue  # it has ended meanwhile
            if name == "rerun" and int(rest.split()[1]) == walk.process.pid:
                return int(status.parent.name)
        return None

    return int(wait_until(found, "the viewer"))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_window_that_dies_or_hangs_loses_no_tick(how: signal.Signals, place: Place, tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    walking = ("run", "--realtime", "--view", "--json", "--duration", str(WALK_S), "--record", str(path))
    with program(tmp_path, "walk", "hexctl", *walking, **place.home, DISPLAY=place.screen) as walk:
        viewer = viewer_of(walk)
        try:
            wait_until(path.is_file, "the recording")
            time.sleep(1.0)
            os.kill(viewer, how)
            walk.wait_for("realtime_factor")
        finally:
            with suppress(ProcessLookupError):
                os.kill(viewer, signal.SIGKILL)
        assert walk.wait() == 0
    outcome = json.loads(next(line for line in walk.said().splitlines() if line.startswith("{")))
    assert outcome["status"] == "ok"
    assert outcome["ticks"] == len(walk_alone(duration_s=WALK_S).log)
    assert rows_at(path, ROBOT) == outcome["ticks"]
