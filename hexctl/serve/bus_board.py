"""A bus of servos on a pseudo-terminal, with a simulated robot behind them: byte by byte, in real time."""

import os
import random
import select
import termios
import time
import tty
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.control.guard import StepLimits
from hexctl.errors import RobotFaultError
from hexctl.robot.bus_map import BusMap
from hexctl.serve.bus_faults import FACTORY_ID, BusFault, BusFaults
from hexctl.serve.bus_servos import BusBoardCounters, RegisterServos, SimulatedServos
from hexctl.serve.lx16a_servos import Lx16aServos
from hexctl.types import N_JOINTS, BoolArray, FloatArray, JointTargets, RobotState

#: How long a servo hesitates before it answers, with its return delay at 0.
HESITATES_S = 0.00005

#: Time that is kept free before a tick.
SPARE_S = 0.0003


#: Bauds by the constants of a terminal.
_BAUDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdecimal()
}

#: Servos of each driver.
FAMILIES: dict[str, type[SimulatedServos]] = {
    "dynamixel": RegisterServos,
    "feetech": RegisterServos,
    "lx16a": Lx16aServos,
}


class BusBoard:
    """Eighteen servos on a pseudo-terminal that move simulated joints.

    Args:
        servos: of the simulated robot, in real time, not connected.
        bus_map: ids and models.
        baud: bits per second: answers come no sooner than their bytes fit on the line.
        faults: what goes wrong, and when.
        seed: of garbled bytes.

    Attributes:
        path: the device to open.
    """

    def __init__(
        self,
        servos: LegServos,
        bus_map: BusMap,
        *,
        baud: int = 1_000_000,
        faults: tuple[BusFault, ...] = (),
        seed: int = 0,
    ) -> None:
        self._robot, self._map, self._baud = servos, bus_map, baud
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        stance = bus_map.raw(servos.robot.stance_angles_rad)
        self._limits = StepLimits.of(servos.robot, servos.clock.period_s)
        self._faults = BusFaults(faults, bus_map)
        self._random = random.Random(seed)  # noqa: S311  garbled bytes are no secret
        self._counters = BusBoardCounters()
        self._family = FAMILIES[bus_map.driver](bus_map, stance, self._faults, self._counters)
        self._servos = self._family.servos
        self._free_s = 0.0  # when the line has carried what came so far
        self._data = b""
        self._limp = True
        self._sent_rad: FloatArray | None = None

    def run(self, until: Callable[[], bool], *, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until `until` returns True; `ready` is called once controllers may open `path`.

        Raises RobotFaultError when the simulated robot fails.
        """
        try:
            with self._robot:
                self._robot.clock.tick()
                self._suffer()
                self._show(self._robot.read())
                ready()
                while not until():
                    self._listen()
                    self._tick()
        except OSError as error:
            raise RobotFaultError(f"the bus has gone: {error.strerror or error}") from error
        finally:
            os.close(self._master)
            os.close(self._slave)

    def report(self) -> dict[str, Any]:
        """Counts so far, as JSON values."""
        return asdict(self._counters)

    def _listen(self) -> None:
        """Answer what comes until the next tick is due."""
        while (timeout_s := self._robot.clock.due_in_s - SPARE_S) > 0:
            self._serve(timeout_s)
        self._serve(0.0)

    def _serve(self, timeout_s: float) -> None:
        if not select.select([self._master], [], [], timeout_s)[0]:
            return
        data = os.read(self._master, 4096)
        self._occupy(len(data))
        if self._faults.unplugged or not self._understands():
            return
        if self._faults.echoes:
            self._send(data)
        self._data += data
        while True:
            packet, done = self._family.packets.take(self._data)
            self._data = self._data[done:]
            if packet is None:
                return
            self._answer(self._family.obey(*packet, self._robot.clock.now_s))

    def _understands(self) -> bool:
        """Whether the controller has opened the line at the servos' baud, where that can be told."""
        opened = termios.tcgetattr(self._slave)[5]
        return _BAUDS.get(opened) in (None, self._baud)

    def _answer(self, answers: list[bytes]) -> None:
        """Send answers no sooner than the line could carry them, garbled as the faults say."""
        if not answers:
            return
        self._counters.answers += len(answers)
        packets, rng = self._family.packets, self._random
        data = b"".join(self._faults.damaged(each, packets, rng, self._sender(each)) for each in answers)
        self._occupy(len(data))
        time.sleep(max(0.0, self._free_s - time.monotonic()) + HESITATES_S * len(answers))
        self._send(data)

    def _sender(self, answer: bytes) -> int | None:
        """Joint whose servo gives an answer, where that matters."""
        packet = self._family.packets.take(answer)[0] if self._faults.cables else None
        joints = [] if packet is None else self._family.named([packet[0]])
        return joints[0] if joints else None

    def _occupy(self, count: int) -> None:
        """Let bytes, of ten bits each, pass on the line behind those before them."""
        self._free_s = max(self._free_s, time.monotonic()) + 10.0 * count / self._baud

    def _send(self, data: bytes) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:  # nobody reads: as on a line that is not listened to
            return

    def _tick(self) -> None:
        """One control period: move the joints, and show in the memories where they are."""
        self._robot.clock.tick()
        self._counters.ticks += 1
        self._faults.advance(self._robot.clock.now_s)
        self._suffer()
        state = self._robot.read()
        self._move(state)
        self._show(state)

    def _suffer(self) -> None:
        """Let what has just begun happen to the servos."""
        while self._faults.sudden:
            fault = self._faults.sudden.pop(0)
            if fault.joint is None:
                self._family.restart()
            elif fault.kind == "overload":
                self._family.trip(fault.joint)
            else:
                self._family.lose_id(fault.joint, FACTORY_ID)

    def _move(self, state: RobotState) -> None:
        holds: BoolArray = self._family.holds() & ~self._faults.dead
        if not holds.any():
            if not self._limp:
                self._robot.disable_torque()
            self._limp, self._sent_rad = True, None
            return
        goals = self._family.goals(self._robot.clock.now_s)
        wanted = np.where(holds, self._map.angles_rad(goals), state.joint_positions_rad)
        before = state.joint_positions_rad if self._sent_rad is None else self._sent_rad
        self._sent_rad = self._limits.apply(wanted, before)
        self._robot.write(JointTargets(self._sent_rad, self._robot.clock.now_s))
        self._limp = False

    def _show(self, state: RobotState) -> None:
        """Let the servos know where their joints are, and their loads."""
        counts = self._map.raw(state.joint_positions_rad)
        limits = self._robot.robot.joint_max_torque_nm
        torques = np.zeros(N_JOINTS) if state.joint_torques_nm is None else state.joint_torques_nm
        self._family.show(counts, self._map.signs * np.clip(torques / limits, -1, 1))
