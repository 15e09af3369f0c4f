"""A bus of servos on a pseudo-terminal, with a simulated robot, in real time."""

from functools import reduce
from operator import and_

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.tools import FACTORY_ID
from hexctl.simulators.board_faults import BUS_FAULTS, BoardFault, BusFaults
from hexctl.simulators.bus_servos import BUS_COUNTS, simulated_servos
from hexctl.simulators.simulated_board import PseudoTerminal, SimulatedBoard, baud_of
from hexctl.types import N_JOINTS, BoolArray, FloatArray, RobotState

#: How long a servo hesitates before it answers, with its return delay at 0.
HESITATES_S = 0.00005


class BusBoard(SimulatedBoard):
    """Eighteen servos on a pseudo-terminal that move simulated joints.

    `servos` are unconnected, in real time; answers take their time at the `baud` rate; `seed` draws garbled
    bytes.
    """

    what, kinds, counted = "bus", BUS_FAULTS, BUS_COUNTS

    def __init__(
        self,
        servos: LegServos,
        bus_map: BusMap,
        *,
        baud: int = 1_000_000,
        faults: tuple[BoardFault, ...] = (),
        seed: int = 0,
    ) -> None:
        self._line = PseudoTerminal()
        super().__init__(servos, self._line, faults, seed)
        self._map, self._baud = bus_map, baud
        stance = bus_map.raw(servos.robot.stance_angles_rad)
        self._faults = BusFaults()
        self._family = simulated_servos(bus_map)(bus_map, stance, self._faults, self.counts)
        self._servos = self._family.servos
        self._free_s = 0.0  # when the line has carried what came so far
        self._data = b""

    def _serve(self, timeout_s: float) -> None:
        if not (data := self._line.receive(timeout_s)):
            return
        self._occupy(len(data))
        if self._unplugged or not self._understands():
            return
        if self._faults.echoes:
            self._line.send(data)
        self._data += data
        while True:
            packet, done = self._family.packets.take(self._data)
            self._data = self._data[done:]
            if packet is None:
                return
            # Servos move on between two control periods of the simulation, whose clock stands meanwhile.
            answers = self._family.obey(*packet, self._time.now())
            self._free_s = max(self._free_s, self._time.now()) + self._family.busy_s(*packet)
            together = len(answers) > 1 and self._family.answer_together(*packet[:2])
            self._answer([overlapping(answers)] if together else answers)

    def _understands(self) -> bool:
        """Whether the controller has opened the line at the servos' baud, if known."""
        return baud_of(self._line) in (None, self._baud)

    def _answer(self, answers: list[bytes]) -> None:
        """Send answers at the speed of the line, garbled by the faults."""
        if not answers:
            return
        self.counts["answers"] += len(answers)
        packets, rng = self._family.packets, self._random
        data = b"".join(self._faults.damaged(each, packets, rng, self._sender(each)) for each in answers)
        self._occupy(len(data))
        self._time.sleep(max(0.0, self._free_s - self._time.now()) + HESITATES_S * len(answers))
        self._line.send(data)

    def _sender(self, answer: bytes) -> int | None:
        packet = self._family.packets.take(answer)[0] if self._faults.cables else None
        joints = [] if packet is None else self._family.named([packet[0]])
        return joints[0] if joints else None

    def _occupy(self, count: int) -> None:
        self._free_s = max(self._free_s, self._time.now()) + 10.0 * count / self._baud

    def _begin(self, fault: BoardFault) -> None:
        self._faults.begin(fault)
        if fault.kind == "brown-out":
            for servo in self._servos:
                servo.restart()
        elif fault.joint is not None and fault.kind == "overload":
            self._servos[fault.joint].trip()
        elif fault.joint is not None and fault.kind == "lost-id":
            self._servos[fault.joint].lose_id(FACTORY_ID)
        elif fault.joint is not None and fault.kind == "same-id":
            self._servos[fault.joint].lose_id(self._servos[fault.joint - 1 if fault.joint else 1].servo_id)

    def _tick(self) -> None:
        super()._tick()
        if self._random.random() < self._faults.noise:
            self._line.send(self._random.randbytes(self._random.randrange(1, 8)))

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        holds: BoolArray = self._family.holds() & ~self._faults.dead
        goals = self._family.goals(self._time.now()) if holds.any() else self._map.centre
        return holds, self._map.angles_rad(goals)

    def _measure(self, state: RobotState) -> None:
        counts = self._map.raw(state.joint_positions_rad)
        limits = self._robot.robot.joint_max_torque_nm
        torques = np.zeros(N_JOINTS) if state.joint_torques_nm is None else state.joint_torques_nm
        self._family.show(counts, self._map.signs * np.clip(torques / limits, -1, 1))
        self._send_reports(state)

    def _send_reports(self, state: RobotState) -> None:
        reports = self._family.reports(state)
        if self._unplugged or not reports:
            return
        garbled = not self._understands()
        for report in reports:
            sent = self._random.randbytes(len(report)) if garbled else report
            self._line.send(self._faults.damaged(sent, self._family.packets, self._random))


def overlapping(answers: list[bytes]) -> bytes:
    """What servos that answer at once put on the line: each begins a bit later, and a 0 wins over a 1."""
    size = max(map(len, answers)) + len(answers) - 1
    padded = [(b"\xff" * delay + answer).ljust(size, b"\xff") for delay, answer in enumerate(answers)]
    return bytes(reduce(and_, column) for column in zip(*padded, strict=True))[1:]
