"""Simulated LX-16A servos on a bus."""

from collections.abc import Sequence

import numpy as np

from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.packets import BROADCAST
from hexctl.backends.bus.servo_type import ServoType
from hexctl.simulators.bus_servos import USUAL_C, SimulatedServo, SimulatedServos

#: Supplies in V: of two cells, and of three for models that need 9 V.
TWO_CELLS_V, THREE_CELLS_V = 7.4, 11.1


class SimulatedLx16aServo(SimulatedServo):
    """One servo that unloads beyond `limits` in counts or `most_c`, and complains outside `voltages_mv`."""

    def __init__(self, servo_id: int, model: ServoType, count: float) -> None:
        self.usual_v = TWO_CELLS_V if model.least_v < TWO_CELLS_V else THREE_CELLS_V
        self.servo_id, self.loaded, self.limits = servo_id, False, (0, 1000)
        self.voltages_mv, self.most_c, self.motor, self.offset = (4500, 12000), 85, False, 0
        self.position = self._goal = self._from = count
        self._began_s, self._time_s = 0.0, 0.0
        self._voltage_v, self._temperature_c = self.usual_v, USUAL_C

    @property
    def holds(self) -> bool:
        """Whether it holds its goal: loaded, in position mode."""
        return self.loaded and not self.motor

    def goal(self, now_s: float) -> float:
        """Target count at a time."""
        done = 1.0 if self._time_s <= 0 else min(1.0, (now_s - self._began_s) / self._time_s)
        return self._from + done * (self._goal - self._from)

    def show(self, count: float, effort: float, voltage_v: float, temperature_c: float) -> None:
        """Set a count, a supply and a temperature."""
        self.position, self._voltage_v, self._temperature_c = float(count), voltage_v, temperature_c
        self.loaded = self.loaded and self.limits[0] <= round(count) <= self.limits[1]

    def trip(self, *, hot: bool = False) -> None:
        """Unload because of an overload; heat is only reported."""
        self.loaded = self.loaded and hot

    def restart(self) -> None:
        """Restart after a loss of power."""
        self.loaded = False

    def write(self, command: int, parameters: bytes, now_s: float) -> None:
        """Execute a writing command of the right length."""
        if len(parameters) != lx.WRITE_BYTES.get(command):
            return
        if command == lx.MOVE:  # from where the move before has come to
            self._from = self.goal(now_s) if self.loaded else self.position
            count, time_ms = (int.from_bytes(each, "little") for each in (parameters[:2], parameters[2:]))
            self._goal = float(np.clip(count, *self.limits))
            self._began_s, self._time_s = now_s, min(time_ms, lx.MOST_MOVE_MS) / 1000
        elif command == lx.WRITE_LOAD:
            self.loaded = bool(parameters[0])
        elif command == lx.WRITE_MODE:
            self.motor = parameters[0] == 1
        elif command == lx.WRITE_LIMITS:
            self.limits = lx.signed_number(parameters[:2]), lx.signed_number(parameters[2:])
        else:
            self.servo_id = parameters[0]

    def answer(self, command: int) -> bytes:
        """Parameters of the answer to a reading command."""
        values: dict[int, tuple[int, ...]] = {
            lx.READ_ID: (self.servo_id,),
            lx.READ_OFFSET: (self.offset,),
            lx.READ_LIMITS: self.limits,
            lx.READ_VOLTAGE_LIMITS: self.voltages_mv,
            lx.READ_MOST_TEMPERATURE: (self.most_c,),
            lx.READ_TEMPERATURE: (round(self._temperature_c),),
            lx.READ_VOLTAGE: (round(1000 * self._voltage_v),),
            lx.READ_MODE: (int(self.motor), 0, 0, 0),
            lx.READ_POSITION: (round(self.position),),
            lx.READ_LOAD: (int(self.loaded),),
        }
        size = lx.ANSWER_BYTES[command] // len(values[command])
        return b"".join(value.to_bytes(size, "little", signed=value < 0) for value in values[command])


class Lx16aServos(SimulatedServos):
    """LX-16A servos."""

    servos: Sequence[SimulatedLx16aServo]

    def _new_servo(self, servo_id: int, model: ServoType, count: float) -> SimulatedLx16aServo:
        return SimulatedLx16aServo(servo_id, model, count)

    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Execute a command; its answers."""
        self._counts["packets"] += 1
        self._counts["goals"] += instruction == lx.MOVE
        everyone, asks = servo_id == BROADCAST, instruction in lx.ANSWER_BYTES
        # The id is all that a broadcast may ask for.
        if asks and (parameters or (everyone and instruction != lx.READ_ID)):
            return []
        ids = list(dict.fromkeys(servo.servo_id for servo in self.servos)) if everyone else [servo_id]
        called = [self.servos[joint] for joint in self.named(ids)]
        if asks:
            return [self.packets.status(one.servo_id, instruction, one.answer(instruction)) for one in called]
        for servo in called:
            servo.write(instruction, parameters, now_s)
        return []
