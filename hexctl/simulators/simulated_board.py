"""A simulated robot behind a board or a bus."""

import contextlib
import os
import random
import select
import socket
import termios
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any, ClassVar

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.clock import SPARE_S
from hexctl.backends.port_thread import OnPort
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.control.guard import StepLimits
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.scratch import scratch_folder
from hexctl.simulators.board_faults import BoardFault
from hexctl.types import BoolArray, FloatArray, JointTargets, RobotState

#: Bytes of a read: more than a controller sends between two of them.
CHUNK = 4096


#: Bauds by the constants of a terminal.
_BAUDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdecimal()
}


class PseudoTerminal:
    """A serial device without a wire."""

    def __init__(self) -> None:
        self.descriptor, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.descriptor, False)
        self.path = os.ttyname(self._slave)

    def receive(self, timeout_s: float) -> bytes:
        """Bytes received within a time."""
        if not select.select([self.descriptor], [], [], timeout_s)[0]:
            return b""
        return os.read(self.descriptor, CHUNK)

    def send(self, data: bytes) -> None:
        """Send bytes; a reader that does not read misses them."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.descriptor, data)

    @property
    def speed(self) -> int:
        """Speed at which the controller has opened it, in termios units."""
        speed: int = termios.tcgetattr(self._slave)[5]
        return speed

    def close(self) -> None:
        """End the device."""
        os.close(self.descriptor)
        os.close(self._slave)


def baud_of(line: PseudoTerminal) -> int | None:
    """Bits per second at which the controller has opened a line; None if no terminal has a name for them."""
    return _BAUDS.get(line.speed)


class SocketLine:
    """A Unix socket of packets in a temporary folder."""

    def __init__(self, name: str) -> None:
        self._scratch = ExitStack()
        self.path = str(self._scratch.enter_context(scratch_folder()) / name)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(self.path)
        self._listener.listen()
        self._clients: list[socket.socket] = []

    def receive(self, timeout_s: float) -> list[tuple[socket.socket, bytes]]:
        """Packets received within a time, by client."""
        ready = select.select([self._listener, *self._clients], [], [], timeout_s)[0]
        came = []
        for each in ready:
            if each is self._listener:
                self._clients.append(self._listener.accept()[0])
                continue
            try:
                data = each.recv(CHUNK)
            except OSError:
                data = b""
            if data:
                came.append((each, data))
            else:
                self._clients.remove(each)
                each.close()
        return came

    def close(self) -> None:
        """Close the socket and remove its folder."""
        for each in (self._listener, *self._clients):
            each.close()
        self._scratch.close()


class RunningBoard(ABC):
    """Runs unconnected servos in real time, and serves an open line, which it closes, between their ticks."""

    #: Name in messages.
    what = "board"

    #: Names of the counts besides `ticks`, the control periods.
    counted: ClassVar[tuple[str, ...]]

    def __init__(self, servos: LegServos, line: OnPort) -> None:
        self._robot, self._closed_at_end, self._time = servos, line, servos.clock.time
        self.counts = dict.fromkeys((*self.counted, "ticks"), 0)

    def run(self, until: Callable[[], bool], *, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until `until` returns True; `ready` is called once controllers may open the line.

        Raises RobotFaultError when the servos or the line fail.
        """
        try:
            with self._robot:
                self._robot.clock.tick()
                self._start()
                ready()
                while not until():
                    while (timeout_s := self._robot.clock.due_in_s - SPARE_S) > 0:
                        self._serve(timeout_s)
                    self._serve(0.0)  # even when a tick took all its time
                    self._robot.clock.tick()
                    self._tick()
                    self.counts["ticks"] += 1
        except OSError as error:
            raise RobotFaultError(f"the {self.what} is closed: {error.strerror or error}") from error
        finally:
            self._closed_at_end.close()

    def report(self) -> dict[str, Any]:
        """Counts so far, as JSON values."""
        return dict(self.counts)

    def _start(self) -> None:  # noqa: B027  most have nothing to prepare
        """Prepare for commands, once the servos are connected."""

    @abstractmethod
    def _serve(self, timeout_s: float) -> None:
        """Execute commands received within a time."""

    @abstractmethod
    def _tick(self) -> None:
        """Work of each control period, after the tick of the clock."""


class SimulatedBoard(RunningBoard):
    """Moves a simulated robot by commands on a line, with faults.

    Args:
        servos: of the simulated robot, in real time, not connected.
        line: open; closed at the end of `run`.
        seed: of random faults.

    Attributes:
        to_come: faults that have not begun.
    """

    #: What each word of a fault takes, as `parse_fault` reads it.
    kinds: ClassVar[Mapping[str, str]]

    def __init__(
        self,
        servos: LegServos,
        line: PseudoTerminal | SocketLine,
        faults: tuple[BoardFault, ...],
        seed: int,
    ) -> None:
        super().__init__(servos, line)
        self.path, self.to_come = line.path, list(faults)
        self._limits = StepLimits.of(servos.robot, servos.clock.period_s)
        self._random = random.Random(seed)  # noqa: S311  faults are no secret
        self._sent_rad: FloatArray | None = None
        self._unplugged = False

    @abstractmethod
    def _begin(self, fault: BoardFault) -> None:
        """Begin a fault other than `unplug` and `replug`."""

    @abstractmethod
    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        """Which servos hold, (18,), and their target angles, (18,), arbitrary for others."""

    @abstractmethod
    def _measure(self, state: RobotState) -> None:
        """Take the measurements of the board from the robot's state."""

    def _begin_due_faults(self) -> None:
        now_s = self._robot.clock.now_s
        due = sorted((each for each in self.to_come if each.at_s <= now_s), key=lambda each: each.at_s)
        self.to_come = [each for each in self.to_come if each.at_s > now_s]
        for fault in due:
            if fault.kind in ("unplug", "replug"):
                self._unplugged = fault.kind == "unplug"
            else:
                self._begin(fault)

    def _start(self) -> None:
        self._begin_due_faults()
        self._measure(self._robot.read())

    def _tick(self) -> None:
        self._begin_due_faults()
        state = self._robot.read()
        self._move(state)
        self._measure(state)

    def _move(self, state: RobotState) -> None:
        holds, angles_rad = self._servo_targets()
        if not holds.any():
            if self._sent_rad is not None:
                self._robot.disable_torque()
            self._sent_rad = None
            return
        wanted = np.where(holds, angles_rad, state.joint_positions_rad)
        before = state.joint_positions_rad if self._sent_rad is None else self._sent_rad
        self._sent_rad = self._limits.apply(wanted, before)
        self._robot.write(JointTargets(self._sent_rad, self._robot.clock.now_s))


class SimulatedPulseBoard(SimulatedBoard):
    """A board of hobby servos; the class of each driver is named by its `PulseBoard`.

    Args:
        model: one of `models`, or None for the usual one.
        baud: of its line; its usual one by default.
    """

    #: Models or firmwares that it can be.
    models: ClassVar[tuple[str, ...]] = ()

    #: Usual bits per second of its line; 0 for one on USB that may have a speed, None if it never has one.
    usual_baud: ClassVar[int | None] = None

    def __init__(
        self,
        servos: LegServos,
        pwm_map: PwmMap,
        *,
        model: str | None = None,
        baud: int | None = None,
        faults: tuple[BoardFault, ...] = (),
        seed: int = 0,
    ) -> None:
        driver = pwm_map.driver
        if model is not None and model not in self.models:
            allowed = ", ".join(self.models) or "none"
            raise InputError(f"{argument('model')}: got {model}; allowed: {allowed} with {driver}")
        if baud is not None and self.usual_baud is None:
            raise InputError(
                f"{argument('baud')}: got {baud} with {driver}, a USB device; allowed: with other buses"
            )
        self._line = self._opened()
        super().__init__(servos, self._line, faults, seed)
        self._map, self._model = pwm_map, model
        self._baud = baud or self.usual_baud or 0
        self._mute, self._garbles, self._tears = False, 0.0, 0.0

    def _begin(self, fault: BoardFault) -> None:
        """Begin a fault of the line; boards add their own."""
        if fault.kind == "mute":
            self._mute = True
        elif fault.kind == "garble":
            self._garbles = fault.value or 0.0
        elif fault.kind == "torn":
            self._tears = fault.value or 0.0

    def _opened(self) -> Any:
        """The line."""
        return PseudoTerminal()
