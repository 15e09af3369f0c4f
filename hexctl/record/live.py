"""A walk shown while it goes on: rows leave by a pipe that never makes the robot wait."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from hexctl.backends.sim.terrain import Floor
from hexctl.control.log import COLUMNS, TickLog
from hexctl.control.plan import TrialPlan
from hexctl.errors import RecordingError
from hexctl.record.viewer import LOCAL, free_port, viewer_binary, web_options, web_url
from hexctl.robot.model import Robot

#: Ticks of one block: ten pictures a second.
LIVE_BLOCK_TICKS = 5

#: What may wait for a slow viewer before the live view is given up: a minute of a walk.
MAX_WAITING_BYTES = 8_000_000

#: How long the feeder may take to pass on its last rows.
END_PATIENCE_S = 5.0


class LiveView:
    """Shows walks in a Rerun viewer while they run: a recorder of `run_trial`.

    Rows go through a pipe to a process of their own, which talks to the viewer. A viewer or feeder that dies
    or hangs costs the robot nothing: what does not fit into the pipe waits, and beyond a bound the live view
    is given up.

    Attributes:
        lost: why nothing is shown any more, or None.
        block_ticks: ticks of the blocks that it wants from a log.
        url: where a browser finds it, or None for a window.
    """

    def __init__(self, *, web: bool = False, options: Sequence[str] = ()) -> None:
        """Start viewer and feeder; `web` serves the viewer to a browser instead of opening a window.

        Args:
            web: whether a browser shows it.
            options: more of Rerun's own, such as `--save FILE`.

        Raises RecordingError when they cannot start, MissingExtraError without Rerun.
        """
        self.lost: str | None = None
        self.block_ticks: int | None = LIVE_BLOCK_TICKS
        self._waiting = b""
        port, web_port = free_port(), free_port()
        self.url = web_url(port, web_port) if web else None
        where = web_options(port, web_port) if web else ["--bind", LOCAL, "--port", str(port)]
        command = [str(viewer_binary()), *where, *options]
        self._viewer = _start(command)
        feeder = [sys.executable, "-m", "hexctl.record.live_feed", str(port)]
        self._feeder = _start(feeder, stdin=subprocess.PIPE)
        assert self._feeder.stdin is not None  # noqa: S101  asked for
        self._pipe = self._feeder.stdin.fileno()
        os.set_blocking(self._pipe, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def begin(
        self,
        robot: Robot,
        plan: TrialPlan,
        *,
        title: str,
        floor: Floor | None = None,
        looks: str | None = None,
    ) -> None:
        """Say that another walk begins, and of whom; `looks` is the robot file whose meshes are drawn."""
        self._send({"robot": robot, "plan": plan, "title": title, "floor": floor, "looks": looks})

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Pass rows [start, stop) of a log on."""
        rows = {name: log.rows(name, start, stop) for name, _, _ in COLUMNS}
        facts = {"frame": log.frame, "pose_known": log.pose_known, "contacts_known": log.contacts_known}
        self._send({"rows": rows, "at_s": time.time(), **facts})

    @property
    def open(self) -> bool:
        """Return whether the viewer is still there."""
        return self._viewer.poll() is None

    def wait(self) -> None:
        """Wait until the viewer is closed by whoever looks at it."""
        self._viewer.wait()

    def close(self, *, leave_viewer: bool = True) -> None:
        """End the feeder, by force if it hangs; the viewer stays open unless told otherwise."""
        until_s = time.monotonic() + END_PATIENCE_S
        while self._waiting and self.lost is None and time.monotonic() < until_s:
            self._push()
            time.sleep(0.01)
        stdin = self._feeder.stdin
        if stdin is not None and not stdin.closed:
            stdin.close()
        try:
            self._feeder.wait(max(0.1, until_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._feeder.kill()
            self._feeder.wait()
        if not leave_viewer:
            self._viewer.kill()
            self._viewer.wait()

    def _send(self, message: dict[str, Any]) -> None:
        """Put a message into the pipe as far as it goes; never waits."""
        if self.lost is not None:
            return
        data = pickle.dumps(message, protocol=5)
        self._waiting += len(data).to_bytes(4, "little") + data
        self._push()
        if len(self._waiting) > MAX_WAITING_BYTES:
            self.lost = "the live view is too slow and was given up"

    def _push(self) -> None:
        """Write what waits, as far as the pipe takes it."""
        try:
            self._waiting = self._waiting[os.write(self._pipe, self._waiting) :]
        except BlockingIOError:
            pass
        except OSError:
            self.lost = "the live view has ended"


def _start(command: Sequence[str], stdin: int = subprocess.DEVNULL) -> "subprocess.Popen[bytes]":
    """Start a process that neither speaks in our terminal nor hears its Ctrl-C."""
    try:
        return subprocess.Popen(
            command,
            stdin=stdin,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        raise RecordingError(f"{command[0]}: does not start: {error.strerror}") from error
