"""Simulated servos on a bus: what those of every family can be asked and told."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.packets import PacketFormat
from hexctl.robot.servos.bus_map import BusMap
from hexctl.serve.boards.bus_faults import BusFaults
from hexctl.types import BoolArray, FloatArray

#: Voltage and temperature of servos that nothing is wrong with, in V and degrees Celsius.
USUAL_V, USUAL_C = 12.0, 35.0


@dataclass(slots=True)
class BusBoardCounters:
    """Counts of a bus since it began.

    Attributes:
        packets: instructions that were understood.
        answers: of servos.
        goals: packets with goals.
        garbage: bytes that belonged to no instruction.
        ticks: control periods.
    """

    packets: int = 0
    answers: int = 0
    goals: int = 0
    garbage: int = 0
    ticks: int = 0


class SimulatedServo(ABC):
    """One servo on a simulated bus.

    Attributes:
        servo_id: that it answers to.
    """

    servo_id: int

    @property
    @abstractmethod
    def holds(self) -> bool:
        """Whether it holds its goal."""


class SimulatedServos(ABC):
    """Eighteen servos of one family on a simulated bus.

    Args:
        bus_map: ids and models.
        stance: counts at first, (18,).
        faults: that have begun.
        counters: of the bus.

    Attributes:
        packets: how instructions and answers are written.
        servos: by joint.
    """

    packets: PacketFormat
    servos: Sequence[SimulatedServo]

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counters: BusBoardCounters
    ) -> None:
        self._map, self._faults, self._counters = bus_map, faults, counters

    @abstractmethod
    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Do what an instruction says at a time on time.monotonic; the answers to it."""

    @abstractmethod
    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), that the servos steer for at a time on time.monotonic."""

    @abstractmethod
    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Take over where the joints are, in counts, and shares of their greatest torques, (18,)."""

    @abstractmethod
    def trip(self, joint: int) -> None:
        """Let the servo of a joint be overloaded."""

    @abstractmethod
    def restart(self) -> None:
        """Let all servos begin as after a loss of power, without torque."""

    @abstractmethod
    def lose_id(self, joint: int, servo_id: int) -> None:
        """Let the servo of a joint answer to another id."""

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
