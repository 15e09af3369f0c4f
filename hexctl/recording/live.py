"""Live view: walks and robots on the network, shown in a viewer through a non-blocking pipe."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Self

from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.sim.terrain import Floor
from hexctl.columns import COLUMN_NAMES
from hexctl.control.log import TickLog
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import RecordingError, RobotFaultError
from hexctl.gait.gait import make_gait
from hexctl.recording.viewer import (
    LOCAL,
    check_display,
    free_port,
    start_process,
    viewer_binary,
    web_options,
    web_url,
)
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import yaw_rad
from hexctl.types import JointTargets, RobotState
from hexctl.waiting import comes_true

LIVE_BLOCK_TICKS = 5

#: Bytes that may wait for a slow viewer before the live view is given up: a minute of walking.
MAX_WAITING_BYTES = 8_000_000

#: Time in which the feeder has to pass on its last rows.
END_TIMEOUT_S = 5.0


#: After an hour of states a new recording begins: recordings are kept in memory, here and by the feeder.
MAX_WATCHED_TICKS = 180_000


class LiveView:
    """Shows walks in a Rerun viewer while they run: a recorder of `run_trial`.

    Rows go through a pipe to a feeder process. A viewer or feeder that dies or hangs does not delay the
    robot: rows wait, and beyond a bound the view is `lost`. `url` is for a browser, None for a window.
    """

    def __init__(self, *, web: bool = False, options: Sequence[str] = ()) -> None:
        """Start viewer and feeder, with further options of Rerun, such as `--save FILE`.

        Raises RecordingError when they cannot start, MissingExtraError without Rerun.
        """
        self.lost: str | None = None
        self.block_ticks: int | None = LIVE_BLOCK_TICKS
        self._waiting = bytearray()
        port, web_port = free_port(), free_port()
        self.url = web_url(port, web_port) if web else None
        where = web_options(web_port) if web else ["--bind", LOCAL]
        command = [str(viewer_binary()), *where, "--port", str(port), *options]
        self._viewer = _start(command)
        # -P: no file in the working folder replaces a module.
        feeder = [sys.executable, "-P", "-m", "hexctl.recording.live_feed", str(port)]
        self._feeder = _start(feeder, stdin=subprocess.PIPE)
        assert self._feeder.stdin is not None  # noqa: S101  asked for
        self._pipe = self._feeder.stdin.fileno()
        os.set_blocking(self._pipe, False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(
        self,
        robot: Robot,
        plan: TrialPlan,
        *,
        title: str,
        floor: Floor | None = None,
        looks: str | None = None,
        watched: bool = False,
        servos: bool = False,
    ) -> None:
        """Begin another walk, with arguments as for a `Recording`; `looks` is a robot file with meshes."""
        shown = {"floor": floor, "looks": looks, "watched": watched, "servos": servos}
        self._send({"robot": robot, "plan": plan, "title": title, **shown})

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Pass rows [start, stop) of a log on; an exception is also stored in `lost`."""
        try:
            self._send({**rows_of(log, start, stop), "at_s": time.time()})
        except Exception as error:
            self.lost = f"the live view failed: {error}"
            raise

    @property
    def open(self) -> bool:
        """Whether the viewer still runs."""
        return self._viewer.poll() is None

    def wait(self) -> None:
        """Wait until the user closes the viewer."""
        self._viewer.wait()

    def close(self, *, leave_viewer: bool = True) -> None:
        """End the feeder, by force if it hangs; the viewer stays open unless `leave_viewer` is False."""
        deadline_s = time.monotonic() + END_TIMEOUT_S
        comes_true(self._passed_on, END_TIMEOUT_S)  # a feeder that hangs is ended below
        stdin = self._feeder.stdin
        if stdin is not None and not stdin.closed:
            stdin.close()
        try:
            self._feeder.wait(max(0.1, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            self._feeder.kill()
            self._feeder.wait()
        if not leave_viewer:
            self._viewer.kill()
            self._viewer.wait()

    def _send(self, message: dict[str, Any]) -> None:
        if self.lost is not None:
            return
        self._waiting += pickle.dumps(message, protocol=5)
        self._push()
        if len(self._waiting) > MAX_WAITING_BYTES:
            self.lost = "the live view is too slow and was given up"

    def _passed_on(self) -> bool:
        if self._waiting and self.lost is None:
            self._push()
        return not self._waiting or self.lost is not None

    def _push(self) -> None:
        try:
            del self._waiting[: os.write(self._pipe, self._waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self.lost = "the live view has ended"


def rows_of(log: TickLog, start: int, stop: int) -> dict[str, Any]:
    """Rows [start, stop) of a log and their events, as `append` of the feeder takes them."""
    return {
        "start": start,
        "rows": {name: log.rows(name, start, stop) for name in COLUMN_NAMES},
        "frame": log.frame,
        "servo_rows": log.servo_rows.between(start, stop),
        "notes": [note for note in log.notes if start <= note[0] < stop],
        "leg_changes": [change for change in log.leg_changes if start <= change.row < stop],
    }


def open_window(on_problem: Callable[[RecordingError], object]) -> LiveView | None:
    """Window for a walk; without a screen `on_problem` gets the reason."""
    try:
        check_display()
    except RecordingError as error:
        on_problem(error)
        return None
    return LiveView()


def watch_states(
    live: LiveView,
    robot: Robot,
    read: Callable[[float], RobotState],
    *,
    place: str,
    stop_requested: Callable[[], bool],
    failures: Callable[[], tuple[Failure, ...] | None],
) -> None:
    """Show a robot's states at 50 Hz until the viewer is closed or a stop is requested.

    Args:
        read: returns the latest state; its argument and the state's stamp are in s on one clock.
        failures: current failures of a simulation, or None if unknown.

    Raises RobotFaultError when the live view is lost, and what `read` raises.
    """
    # The layout needs a plan, and a viewer does not know that of the robot's controller.
    plan = TrialPlan(gait=make_gait(robot, "demo"))
    while not stop_requested() and live.open:
        title = f"{robot.name} at {place}, from {time.strftime('%H:%M:%S')}"
        live.begin(robot, plan, title=title, servos=True)
        _watch_recording(live, read, stop_requested, failures)
        if live.lost is not None:
            raise RobotFaultError(f"{live.lost}; {place} itself is as it was")


def _watch_recording(
    live: LiveView,
    read: Callable[[float], RobotState],
    stop_requested: Callable[[], bool],
    failures: Callable[[], tuple[Failure, ...] | None],
) -> None:
    log = TickLog()
    log.phase = "walk"
    clock = WallClock(PERIOD_S)
    while not stop_requested() and live.lost is None and live.open and len(log) < MAX_WATCHED_TICKS:
        tick = clock.tick()
        state = read(tick.time_s)
        if log.frame is None and state.base_position_world is not None:
            quaternion = state.base_quaternion_world
            yaw = 0.0 if quaternion is None else float(yaw_rad(quaternion))
            log.frame = TrialFrame(state.base_position_world, yaw, yaw)
        joint_positions_rad = state.joint_positions_rad
        log.note_failures("world", failures())
        log.record(tick, state, joint_positions_rad, JointTargets(joint_positions_rad, tick.time_s))
        if len(log) % LIVE_BLOCK_TICKS == 0:
            live.write_block(log, len(log) - LIVE_BLOCK_TICKS, len(log))


def _start(command: Sequence[str], stdin: int = subprocess.DEVNULL) -> "subprocess.Popen[bytes]":
    """Detached from our terminal: no output there, no Ctrl-C from there."""
    quiet = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    return start_process(command, stdin=stdin, **quiet, start_new_session=True)
