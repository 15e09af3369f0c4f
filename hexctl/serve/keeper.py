"""The keeper: a process that looks after a robot on a bus when the one that serves it has gone.

Most servos hold their last goal for ever, also when their computer's program was killed or hangs. The keeper
waits on a pipe for the ticks of the server. When the pipe closes, or no tick comes for a second, it ends what
is left of the server, opens the port, and lets the robot sit down softly, or hold, as the robot file says.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import IO

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import HexctlError
from hexctl.robot.loader import load_robot_file
from hexctl.types import JointTargets

#: A server that is silent for this long hangs.
SILENT_S = 1.0

#: Byte of a tick, and the one with which the server ends the keeper.
TICK, GOODBYE = b".", b"q"

#: How often it is tried to open the port, and for how long: its lock goes with the server's process.
TRY_S, TRIES_S = 0.1, 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class KeeperSpec:
    """What a keeper looks after.

    Attributes:
        backend: name of the backend on the bus.
        robot: name or path of the robot file.
        connect: port of the bus, or None for that of the robot file.
        sits: whether the robot is let down; else it holds.
    """

    backend: str
    robot: str
    connect: str | None
    sits: bool

    def servos(self) -> LegServos:
        """The servos, not connected."""
        file = load_robot_file(self.robot)
        options = BackendOptions(robot=file.robot, robot_file=file, connect=self.connect)
        return make_servos(self.backend, options)


class Keeper:
    """The server's end: a keeper that runs until `dismiss`, or until the server has gone.

    Args:
        spec: what it looks after.
    """

    def __init__(self, spec: KeeperSpec) -> None:
        words = {"backend": spec.backend, "robot": spec.robot, "connect": spec.connect, "sits": spec.sits}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hexctl.serve.keeper", json.dumps(words)],
            stdin=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in the terminal is for the server
        )
        assert self._process.stdin is not None  # noqa: S101  for the type
        self._pipe: IO[bytes] = self._process.stdin
        os.set_blocking(self._pipe.fileno(), False)

    def tick(self) -> None:
        """Say that the server lives; never waits."""
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), TICK)

    def dismiss(self) -> None:
        """End the keeper: the server ends as it should."""
        os.set_blocking(self._pipe.fileno(), True)
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), GOODBYE)
            self._pipe.close()
        self._process.wait()


def wait_for_the_end(pipe: int, silent_s: float = SILENT_S) -> str | None:
    """Wait until a server has gone: `gone` where its pipe closed, `hangs`, or None where it said goodbye.

    Silence counts from the first tick on.
    """
    timeout_s: float | None = None
    while True:
        if not select.select([pipe], [], [], timeout_s)[0]:
            return "hangs"
        data = os.read(pipe, 4096)
        if GOODBYE in data:
            return None
        if not data:
            return "gone" if timeout_s is not None else None
        timeout_s = silent_s


def take_over(spec: KeeperSpec) -> str:
    """Let the robot down, or hold; what was done, in few words.

    Raises RobotFaultError when the bus cannot be reached.
    """
    servos = _connected(spec)
    with Guard(servos, expiry_s=MAX_EXPIRY_S) as guard:
        if isinstance(servos, BusServos) and not servos.holds:
            return "had no torque"
        state = guard.read()
        here = state.joint_positions_rad.copy()
        end = sitting_angles_rad(guard.robot) if spec.sits else here
        begin_s = guard.clock.tick().time_s
        share = 0.0
        while share < 1.0:
            share = min(1.0, (guard.clock.now_s - begin_s) / SITTING_S)
            guard.write(JointTargets((1 - share) * here + share * end, guard.clock.now_s))
            guard.clock.tick()
            guard.read()
        if spec.sits:
            guard.disable_torque()
            time.sleep(TRY_S)
    return "sat down, and its torque is off" if spec.sits else "holds"


def _connected(spec: KeeperSpec) -> LegServos:
    """Servos on the bus, once its port is free."""
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
    """Run a keeper until its server ends; the exit code."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    server = os.getppid()
    spec = KeeperSpec(**json.loads(words))
    spec.servos()  # imports what it will need, while there is time
    how = wait_for_the_end(pipe)
    if how is None:
        return 0
    if how == "hangs" and os.getppid() == server:
        os.kill(server, signal.SIGKILL)
    try:
        done = take_over(spec)
    except HexctlError as error:
        print(f"hexctl: serve {how}, and the keeper failed: {error}", file=sys.stderr)  # noqa: T201
        return 3
    print(f"hexctl: serve {how}: the robot {done}", file=sys.stderr)  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
