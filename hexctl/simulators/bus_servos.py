"""Simulated servos on a bus: what those of every family can be asked and told."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from hexctl.backends.bus.packets import PacketFormat
from hexctl.backends.bus.tools import packets_of
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.servo_models import ServoType
from hexctl.simulators.bus_faults import BusFaults
from hexctl.types import BoolArray, FloatArray

#: Voltage and temperature of servos that nothing is wrong with, in V and degrees Celsius.
USUAL_V, USUAL_C = 12.0, 35.0


#: Counts of a bus: instructions that were understood, answers, packets with goals and garbage.
BUS_COUNTS = ("packets", "answers", "goals", "garbage")


class SimulatedServo(ABC):
    """One servo on a simulated bus."""

    usual_v = USUAL_V
    servo_id: int

    @property
    @abstractmethod
    def holds(self) -> bool:
        """Whether it holds its goal."""

    @abstractmethod
    def goal(self, now_s: float) -> float:
        """Count that it steers for at a time."""

    @abstractmethod
    def show(self, count: float, effort: float, voltage_v: float, temperature_c: float) -> None:
        """Be at a count, with a share of its greatest torque, a supply and a temperature."""

    @abstractmethod
    def trip(self, *, hot: bool = False) -> None:
        """Let go because of an overload or heat, as its family does."""

    @abstractmethod
    def restart(self) -> None:
        """Begin as after a loss of power, without torque."""

    def lose_id(self, servo_id: int) -> None:
        """Answer to another id, also after a restart."""
        self.servo_id = servo_id


class SimulatedServos(ABC):
    """Eighteen servos of one family on a simulated bus.

    Args:
        stance: counts at first, (18,).
        counts: of the bus, as `BUS_COUNTS` has their names.
    """

    packets: PacketFormat
    servos: Sequence[SimulatedServo]

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counts: dict[str, int]
    ) -> None:
        self._faults, self._counts = faults, counts
        self.packets = packets_of(bus_map.driver, bus_map.protocol)
        parts = zip(bus_map.ids.tolist(), bus_map.models, stance.tolist(), strict=True)
        self.servos = [self._made(*each) for each in parts]

    @abstractmethod
    def _made(self, servo_id: int, model: ServoType, count: float) -> SimulatedServo:
        """A servo of the family that stands at a count."""

    @abstractmethod
    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Do what an instruction says at a time; the answers to it."""

    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Take over where the joints are, in counts, and shares of their greatest torques, (18,)."""
        for joint, servo in enumerate(self.servos):
            temperature_c = self._faults.temperatures.get(joint, USUAL_C)
            servo.show(counts[joint], efforts[joint], self._faults.voltage(servo.usual_v), temperature_c)
            if temperature_c > self._faults.HOT_C:
                servo.trip(hot=True)

    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), that the servos steer for at a time."""
        return np.array([servo.goal(now_s) for servo in self.servos])

    def holds(self) -> BoolArray:
        """Which servos hold their goals, (18,)."""
        return np.array([servo.holds for servo in self.servos])

    def named(self, ids: Sequence[int]) -> list[int]:
        """Joints whose servos answer to some ids, in their order, but for those that are mute."""
        return [
            joint
            for servo_id in ids
            for joint, servo in enumerate(self.servos)
            if servo.servo_id == servo_id and not self._faults.mute[joint]
        ]
