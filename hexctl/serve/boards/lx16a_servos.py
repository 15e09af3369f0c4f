"""Simulated LX-16A servos on a bus: their commands, their moves with a time, and their stored limits."""

import numpy as np

from hexctl.backends.bus import lx16a_packets as lx
from hexctl.backends.bus.packets import BROADCAST
from hexctl.robot.servos.bus_map import BusMap
from hexctl.serve.boards.bus_faults import BusFaults
from hexctl.serve.boards.bus_servos import USUAL_C, BusBoardCounters, SimulatedServo, SimulatedServos
from hexctl.types import FloatArray

#: Voltage of servos that nothing is wrong with, in V.
USUAL_V = 7.4


class Lx16aServo(SimulatedServo):
    """One servo.

    Attributes:
        servo_id: that it answers to.
        loaded: whether it holds its goal.
        limits: lowest and highest count, beyond which it unloads.
        voltages_mv: lowest and highest supply with which it does not complain.
        most_c: temperature at which it unloads, in degrees Celsius.
        position: count.
    """

    def __init__(self, servo_id: int, count: float) -> None:
        self.servo_id, self.loaded, self.limits = servo_id, False, (0, 1000)
        self.voltages_mv, self.most_c = (4500, 12000), 85
        self.position = self._goal = self._from = count
        self._began_s, self._time_s = 0.0, 0.0

    @property
    def holds(self) -> bool:
        """Whether it holds its goal."""
        return self.loaded

    def move(self, count: int, time_ms: int, now_s: float) -> None:
        """Begin a move, from where the one before has come to."""
        self._from = self.goal(now_s) if self.loaded else self.position
        self._goal = float(np.clip(count, *self.limits))
        self._began_s, self._time_s = now_s, time_ms / 1000

    def goal(self, now_s: float) -> float:
        """Count that it steers for at a time."""
        done = 1.0 if self._time_s <= 0 else min(1.0, (now_s - self._began_s) / self._time_s)
        return self._from + done * (self._goal - self._from)

    def stand(self, count: float) -> None:
        """Be at a count."""
        self.position = count
        self.loaded = self.loaded and self.limits[0] <= round(count) <= self.limits[1]


class Lx16aServos(SimulatedServos):
    """LX-16A servos."""

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counters: BusBoardCounters
    ) -> None:
        super().__init__(bus_map, stance, faults, counters)
        self.packets = lx.LX16A
        self.servos: list[Lx16aServo] = [
            Lx16aServo(int(servo_id), count) for servo_id, count in zip(bus_map.ids, stance, strict=True)
        ]

    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Do what a command says; the answers to it."""
        self._counters.packets += 1
        self._counters.goals += instruction == lx.MOVE
        everyone = servo_id == BROADCAST
        ids = [servo.servo_id for servo in self.servos] if everyone else [servo_id]
        if instruction in lx.ANSWER_BYTES:
            # The id is all that a broadcast may ask for.
            if parameters or (everyone and instruction != lx.READ_ID):
                return []
            joints = self.named(list(dict.fromkeys(ids)))
            return [self._answer(joint, instruction) for joint in joints]
        for joint in self.named(list(dict.fromkeys(ids))):
            self._write(self.servos[joint], instruction, parameters, now_s)
        return []

    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), that the servos steer for at a time."""
        return np.array([servo.goal(now_s) for servo in self.servos])

    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Take over where the joints are."""
        for servo, count in zip(self.servos, counts, strict=True):
            servo.stand(float(count))

    def trip(self, joint: int) -> None:
        """Let the servo of a joint be overloaded: it unloads."""
        self.servos[joint].loaded = False

    def restart(self) -> None:
        """Let all servos begin as after a loss of power."""
        for servo in self.servos:
            servo.loaded = False

    def lose_id(self, joint: int, servo_id: int) -> None:
        """Let the servo of a joint answer to another id."""
        self.servos[joint].servo_id = servo_id

    def _write(self, servo: Lx16aServo, command: int, parameters: bytes, now_s: float) -> None:
        """Do what a command of the right length writes; there are no answers."""
        if command == lx.MOVE and len(parameters) == 4:
            count, time_ms = (int.from_bytes(each, "little") for each in (parameters[:2], parameters[2:]))
            servo.move(count, min(time_ms, lx.MOST_MOVE_MS), now_s)
        elif command == lx.WRITE_LOAD and len(parameters) == 1:
            servo.loaded = bool(parameters[0])
        elif command == lx.WRITE_LIMITS and len(parameters) == 4:
            servo.limits = lx.number(parameters[:2]), lx.number(parameters[2:])
        elif command == lx.WRITE_ID and len(parameters) == 1:
            servo.servo_id = parameters[0]

    def _answer(self, joint: int, command: int) -> bytes:
        servo = self.servos[joint]
        values = {
            lx.READ_ID: servo.servo_id,
            lx.READ_MOST_TEMPERATURE: servo.most_c,
            lx.READ_TEMPERATURE: round(self._faults.temperatures.get(joint, USUAL_C)),
            lx.READ_VOLTAGE: round(1000 * self._faults.voltage(USUAL_V)),
            lx.READ_POSITION: round(servo.position),
            lx.READ_LOAD: int(servo.loaded),
        }
        pairs = {lx.READ_LIMITS: servo.limits, lx.READ_VOLTAGE_LIMITS: servo.voltages_mv}
        if command in pairs:
            data = b"".join(limit.to_bytes(2, "little", signed=limit < 0) for limit in pairs[command])
        else:
            data = values[command].to_bytes(lx.ANSWER_BYTES[command], "little", signed=values[command] < 0)
        return self.packets.status(servo.servo_id, command, data)
