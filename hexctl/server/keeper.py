"""The keeper: a process that lets a robot on a bus sit down after its server has died or hangs.

Most servos hold their last goal without a program. The keeper waits on a pipe for the ticks of the server.
When the pipe closes, or no tick comes for a second, it kills the server, opens the port, and lets the robot
sit down softly or hold, as set in its robot file. A stopped robot holds because a person may be touching
it.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from types import TracebackType
from typing import IO, Self

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.pwm.servos import PwmServos
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, HexctlError
from hexctl.robot.loader import load_robot_file
from hexctl.signals import ending_signals
from hexctl.types import JOINT_NAMES, FloatArray, JointTargets, RobotState

#: A server without a tick for this long hangs.
SILENT_S = 1.0

#: Byte of a tick, of a tick with a stopped robot, and the byte with which the server dismisses the keeper.
TICK, STOPPED, GOODBYE = b".", b"s", b"q"

LOST = "the keeper has ended: nothing lets the robot down if this process dies"

#: Time for joints to settle, and how near to their goals they then are.
SETTLES_S, ARRIVED_RAD = 0.4, 0.35

#: If more joints do not follow (those of two legs), the robot may not have sat down.
MOST_LEFT = 6

#: Period and duration of attempts to open the port: its lock ends with the server's process.
TRY_S, TRIES_S = 0.1, 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class KeeperSpec:
    """Robot that a keeper looks after.

    Attributes:
        robot: name or path of the robot file.
        port: of the bus; None takes that of the robot file.
        sits: whether the robot sits down; otherwise it holds.
    """

    backend: str
    robot: str
    port: str | None
    sits: bool

    def servos(self) -> LegServos:
        """The servos, not connected."""
        return make_servos(self.backend, _options(self.robot, self.port))


@lru_cache(maxsize=1)
def _options(robot: str, port: str | None) -> BackendOptions:
    """Options of the servos; the robot file is read once, in advance."""
    file = load_robot_file(robot)
    return BackendOptions(robot=file.robot, robot_file=file, port=port)


class Keeper:
    """The server's end of a keeper."""

    def __init__(self, spec: KeeperSpec) -> None:
        words = {**asdict(spec), "server": os.getpid()}
        self._process = subprocess.Popen(
            # -P: no file in the working folder replaces a module.
            [sys.executable, "-P", "-m", "hexctl.server.keeper", json.dumps(words)],
            stdin=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in the terminal is for the server
        )
        assert self._process.stdin is not None  # noqa: S101  for the type
        self._pipe: IO[bytes] = self._process.stdin
        os.set_blocking(self._pipe.fileno(), False)
        self._lost = False

    def tick(self, *, stopped: bool) -> str | None:
        """Report that the server lives, and whether the robot holds after a stop; never waits.

        Returns a line when the keeper is found to have ended.
        """
        if not self._lost:
            try:
                os.write(self._pipe.fileno(), STOPPED if stopped else TICK)
            except BlockingIOError:
                pass
            except OSError:
                self._lost = True
                return LOST
        return None

    def goodbye(self) -> None:
        """Report that the server begins an orderly end."""
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), GOODBYE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the keeper, or leave the robot to it if the server ends by an error."""
        if error is None:
            self.goodbye()
        with contextlib.suppress(OSError):
            self._pipe.close()
        if error is None:
            self._process.wait()


def wait_for_the_end(pipe: int, silent_s: float = SILENT_S) -> tuple[str, bool] | None:
    """Wait for the server's end: `gone` (pipe closed) or `hangs` (silent after a tick); None after a goodbye.

    The second value is whether the robot was stopped at the last tick.
    """
    timeout_s: float | None = None
    data = b""
    while True:
        if not select.select([pipe], [], [], timeout_s)[0]:
            return "hangs", data.endswith(STOPPED)
        last, data = data, os.read(pipe, 4096)
        if GOODBYE in data:
            return None
        if not data:
            return ("gone", last.endswith(STOPPED)) if timeout_s is not None else None
        timeout_s = silent_s


def take_over(spec: KeeperSpec) -> str:
    """Let the robot sit down, or hold; return a description. Raises RobotFaultError without a bus."""
    servos = _connected(spec)
    with Guard(servos, expiry_s=MAX_EXPIRY_S) as guard:
        if isinstance(servos, BusServos | PwmServos) and not servos.holds:
            return "had no torque"
        if isinstance(servos, PwmServos) and not servos.powered.all():
            return _without_some_pulses(guard, sits=spec.sits)
        if not spec.sits:
            return "holds"  # with its last goals: goals at the measured angles would let it sag
        here, end = guard.read().joint_positions_rad.copy(), sitting_angles_rad(guard.robot)
        state = _move(guard, here, end)
        left = np.flatnonzero(np.abs(state.joint_positions_rad - end) >= ARRIVED_RAD).tolist()
        names = ", ".join(JOINT_NAMES[joint].replace("_", " ") for joint in left)
        if len(left) > MOST_LEFT:
            return f"did not sit down: {names} do not follow; it holds"
        guard.disable_torque()
        time.sleep(TRY_S)
    return f"sat down{f' without {names}, which did not follow' if left else ''}, and its torque is off"


def _without_some_pulses(guard: Guard, *, sits: bool) -> str:
    """Fewer than six legs carry, and limp servos would jump to any pose."""
    if not sits:
        return "holds, where its servos still have pulses"
    guard.disable_torque()
    time.sleep(TRY_S)
    return "had lost the pulses of some servos, and its torque is off"


def _move(guard: Guard, here: FloatArray, end: FloatArray) -> RobotState:
    """Move softly between joint angles (18,); only a bus fault ends it, because servos must not stay hot."""
    begin_s, share = guard.clock.tick().time_s, 0.0
    while True:
        passed_s = guard.clock.now_s - begin_s
        share = min(1.0, passed_s / SITTING_S)
        if guard.stopped is not None:
            guard.clear()
        with contextlib.suppress(EStopError, CommandRefusedError):
            guard.write(JointTargets((1 - share) * here + share * end, guard.clock.now_s))
        guard.clock.tick()
        state = guard.read()
        if passed_s > SITTING_S + SETTLES_S:
            return state


def _connected(spec: KeeperSpec) -> LegServos:
    until_s = time.monotonic() + TRIES_S
    while True:
        servos = spec.servos()
        try:
            servos.connect()
        except HexctlError:
            servos.close()
            if time.monotonic() > until_s:
                raise
            time.sleep(TRY_S)
            continue
        return servos


def main(words: str, *, pipe: int = 0) -> int:
    """Run a keeper until its server ends; return the exit code."""
    for number in ending_signals():  # signals are for the server
        signal.signal(number, signal.SIG_IGN)
    given = json.loads(words)
    server = given.pop("server")
    spec = KeeperSpec(**given)
    spec.servos()  # imports modules and reads files in advance
    end = wait_for_the_end(pipe)
    if end is None:
        return 0
    how, stopped = end
    if how == "hangs" and os.getppid() == server:
        os.kill(server, signal.SIGKILL)
    try:
        done = take_over(replace(spec, sits=spec.sits and not stopped))
    except HexctlError as error:
        print(f"hexctl: serve {how}, and the keeper failed: {error}", file=sys.stderr)  # noqa: T201
        return 3
    print(f"hexctl: serve {how}: the robot {done}", file=sys.stderr)  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
