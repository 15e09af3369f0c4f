"""The keeper: a process that looks after a robot on a bus when the one that serves it has gone.

Most servos hold their last goal until told otherwise, also when their computer's program was killed or
hangs. The keeper waits on a pipe for the ticks of the server. When the pipe closes, or no tick comes for a
second, it ends what is left of the server, opens the port, and lets the robot sit down softly, or hold, as
the robot file says.
"""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import IO

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.pwm.pca9685 import Pca9685Servos
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import MAX_EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, HexctlError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.drivers import BUS_DRIVERS
from hexctl.signals import ending_signals
from hexctl.types import JOINT_NAMES, FloatArray, JointTargets, RobotState

#: Backends that it can reach after the server: they tell whether their servos hold.
KEPT_BACKENDS = (*BUS_DRIVERS, "pca9685")

#: A server that is silent for this long hangs.
SILENT_S = 1.0

#: Byte of a tick, and the one with which the server ends the keeper.
TICK, GOODBYE = b".", b"q"

#: How long joints are given to settle, and how near their goals they are then.
SETTLES_S, ARRIVED_RAD = 0.4, 0.35

#: With more joints that do not follow, those of two legs, it is not known that the robot has sat down.
MOST_LEFT = 6

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
        return make_servos(self.backend, _options(self))


@lru_cache(maxsize=1)
def _options(spec: KeeperSpec) -> BackendOptions:
    """Options of the backend; the robot file is read once, for it may be half edited when it is needed."""
    file = load_robot_file(spec.robot)
    return BackendOptions(robot=file.robot, robot_file=file, connect=spec.connect)


class Keeper:
    """The server's end: a keeper that runs until `dismiss`, or until the server has gone.

    Args:
        spec: what it looks after.

    Attributes:
        lost: whether it has ended although the server lives, as seen at the last tick.
    """

    def __init__(self, spec: KeeperSpec) -> None:
        words = {**asdict(spec), "server": os.getpid()}
        self._process = subprocess.Popen(
            # -P: a file in the working folder stands for no module.
            [sys.executable, "-P", "-m", "hexctl.server.keeper", json.dumps(words)],
            stdin=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in the terminal is for the server
        )
        assert self._process.stdin is not None  # noqa: S101  for the type
        self._pipe: IO[bytes] = self._process.stdin
        os.set_blocking(self._pipe.fileno(), False)
        self.lost = False

    def tick(self) -> None:
        """Say that the server lives; never waits."""
        try:
            os.write(self._pipe.fileno(), TICK)
        except BlockingIOError:
            return
        except OSError:
            self.lost = True

    def goodbye(self) -> None:
        """Say that the server begins to end as it should."""
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), GOODBYE)

    def dismiss(self) -> None:
        """End the keeper: the server has ended as it should."""
        self.goodbye()
        self._close()
        self._process.wait()

    def abandon(self) -> None:
        """Leave the robot to the keeper: the server ends by an error."""
        self._close()

    def _close(self) -> None:
        with contextlib.suppress(OSError):
            self._pipe.close()


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
        if isinstance(servos, BusServos | Pca9685Servos) and not servos.holds:
            return "had no torque"
        if isinstance(servos, Pca9685Servos) and not servos.powered.all():
            return _without_some_pulses(guard, sits=spec.sits)
        if not spec.sits:
            return "holds"  # its servos hold their last goals: those of where they are would let it sag
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
    """Leave a robot some of whose hobby servos have no pulses as it is, or let go of the others too.

    It stands on less than six legs, and limp servos would turn to any pose at full speed.
    """
    if not sits:
        return "holds, where its servos still have pulses"
    guard.disable_torque()
    time.sleep(TRY_S)
    return "had lost the pulses of some servos, and its torque is off"


def _move(guard: Guard, here: FloatArray, end: FloatArray) -> RobotState:
    """Move softly from where the joints are, (18,), and stay for a moment; the last state.

    Nothing stops it that stops a walk, but a bus that fails: a robot must not stand on hot servos.
    """
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
    for number in ending_signals():  # they are for the server
        signal.signal(number, signal.SIG_IGN)
    given = json.loads(words)
    server = given.pop("server")
    spec = KeeperSpec(**given)
    spec.servos()  # imports and reads what it will need, while there is time
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
