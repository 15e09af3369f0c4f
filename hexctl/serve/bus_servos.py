"""Simulated servos on a bus: what they understand and answer; those with registers, Dynamixel and Feetech."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.backends.bus.packets import (
    BROADCAST,
    PING,
    PROTOCOLS,
    READ,
    REBOOT,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    PacketFormat,
)
from hexctl.backends.bus.registers import RegisterTable, table_of
from hexctl.robot.bus_map import BusMap
from hexctl.serve.bus_faults import BusFaults
from hexctl.types import BoolArray, FloatArray

#: Bytes of a servo's memory.
MEMORY = 256

#: Highest time of a watchdog, in 20 ms, and what it says once it has expired (-1).
MOST_WATCHDOG, EXPIRED = 127, 255

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
        """Do what an instruction says at a time of the robot's clock; the answers to it."""

    @abstractmethod
    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), that the servos steer for at a time of the robot's clock."""

    @abstractmethod
    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Take over where the joints are, in counts, and shares of their greatest torques, (18,)."""

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


class BusServo(SimulatedServo):
    """One servo with registers: its memory.

    Attributes:
        servo_id: that it answers to.
        memory: its registers.
    """

    def __init__(self, servo_id: int, table: RegisterTable, model: int | None, counts: float) -> None:
        self.servo_id, self._table = servo_id, table
        self.memory = bytearray(MEMORY)
        self.set(table.model, model or 0)
        for register, value in (
            (table.goal, counts),
            (table.position, counts),
            (table.voltage, USUAL_V),
            (table.temperature, USUAL_C),
            (table.return_delay, 250),
        ):
            self.set(register, value)

    def set(self, register: Any, value: float) -> None:
        """Write a number, in its unit, into the memory."""
        data = self._table.packed(register, value)
        self.memory[register.address : register.address + register.size] = data

    def number(self, register: Any) -> float:
        """Number in the memory, in its unit."""
        data = bytes(self.memory[register.address : register.address + register.size])
        return float(register.value(int.from_bytes(data, self._table.byte_order)))

    @property
    def holds(self) -> bool:
        """Whether it holds its goal."""
        return self.memory[self._table.torque.address] == 1

    @property
    def _expired(self) -> bool:
        watchdog = self._table.watchdog
        return watchdog is not None and self.memory[watchdog.address] == EXPIRED

    def watch(self, silent_s: float) -> None:
        """Let the watchdog expire where the line has been silent for long, in s, and the torque is on."""
        watchdog = self._table.watchdog
        if watchdog is None or not self.holds or not 0 < self.memory[watchdog.address] <= MOST_WATCHDOG:
            return
        if silent_s > 0.02 * self.memory[watchdog.address]:
            self.memory[watchdog.address] = EXPIRED

    def write(self, address: int, data: bytes) -> None:
        """Write bytes, as a controller does; once its watchdog has expired it takes no goals."""
        if self._expired and address == self._table.goal.address:
            return
        held = self.holds
        self.memory[address : address + len(data)] = data[: MEMORY - address]
        if self.memory[self._table.torque.address] and not held and not _covers(self._table, address, data):
            self.set(self._table.goal, self.number(self._table.position))  # it holds where it is


class RegisterServos(SimulatedServos):
    """Servos with registers."""

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counters: BusBoardCounters
    ) -> None:
        super().__init__(bus_map, stance, faults, counters)
        self._table = table_of(bus_map.models[0].name)
        self.packets = PROTOCOLS[self._table.protocol]
        self._heard_s = 0.0
        self.servos: list[BusServo] = [
            BusServo(int(servo_id), self._table, model.number, count)
            for servo_id, model, count in zip(bus_map.ids, bus_map.models, stance, strict=True)
        ]

    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Do what an instruction says; the answers to it."""
        if self._table.protocol == 2 and instruction == STATUS:
            return []
        for servo in self.servos:
            servo.watch(now_s - self._heard_s)
        self._heard_s = now_s
        self._counters.packets += 1
        if instruction == SYNC_WRITE:
            self._sync_write(parameters)
            return []
        if instruction == SYNC_READ and not self._table.sync_read:
            return []
        if instruction == SYNC_READ:
            address, size, ids = self._place(parameters)
            return [self._status(one, self._read(one, address, size)) for one in self._of(list(ids))]
        broadcast = servo_id == BROADCAST
        chosen = self.servos if broadcast else self._of([servo_id])
        answers = [self._single(one, instruction, parameters) for one in chosen]
        return [] if broadcast and instruction != PING else answers

    def goals(self, now_s: float) -> FloatArray:
        """Counts, (18,), in the registers for goals."""
        return np.array([servo.number(self._table.goal) for servo in self.servos])

    def show(self, counts: FloatArray, efforts: FloatArray) -> None:
        """Put positions, loads, voltages and temperatures into the memories."""
        table = self._table
        for joint, servo in enumerate(self.servos):
            model = self._map.models[joint]
            servo.set(table.position, float(np.clip(np.rint(counts[joint]), model.least, model.most)))
            if table.effort is not None:
                servo.set(table.effort, efforts[joint])
            if table.current is not None:
                servo.set(table.current, efforts[joint])
            servo.set(table.voltage, self._faults.voltage(USUAL_V))
            servo.set(table.temperature, self._faults.temperatures.get(joint, USUAL_C))

    def _single(self, servo: BusServo, instruction: int, parameters: bytes) -> bytes:
        """Answer of one servo to an instruction for it."""
        data = b""
        if instruction == READ:
            address, size, _ = self._place(parameters)
            data = self._read(servo, address, size)
        elif instruction == WRITE:
            self._write(servo, parameters)
        elif instruction == PING and self._table.protocol == 2:
            data = self._read(servo, self._table.model.address, 2) + b"\x30"
        elif instruction == REBOOT:
            servo.memory[self._table.torque.address] = 0
        return self._status(servo, data)

    def _sync_write(self, parameters: bytes) -> None:
        address, size, rows = self._place(parameters)
        self._counters.goals += address == self._table.goal.address
        for start in range(0, len(rows) - size, size + 1):
            for servo in self._of([rows[start]]):
                servo.write(address, rows[start + 1 : start + 1 + size])

    def _write(self, servo: BusServo, parameters: bytes) -> None:
        width = 1 if self._table.protocol == 1 else 2
        address, data = int.from_bytes(parameters[:width], "little"), parameters[width:]
        if address == self._table.servo_id.address and data:
            servo.servo_id = data[0]
        servo.write(address, data)

    def _place(self, parameters: bytes) -> tuple[int, int, bytes]:
        """Address, size and the rest of parameters."""
        if self._table.protocol == 1:
            return parameters[0], parameters[1], parameters[2:]
        return (
            int.from_bytes(parameters[:2], "little"),
            int.from_bytes(parameters[2:4], "little"),
            parameters[4:],
        )

    def _of(self, ids: list[int]) -> list[BusServo]:
        return [self.servos[joint] for joint in self.named(ids)]

    def _read(self, servo: BusServo, address: int, size: int) -> bytes:
        return bytes(servo.memory[address : address + size]).ljust(size, b"\0")

    def _status(self, servo: BusServo, data: bytes) -> bytes:
        error = 0
        if servo.number(self._table.temperature) > self._faults.HOT_C:
            error = 1 << (2 if self._table.protocol == 1 else 7)
        return self.packets.status(servo.servo_id, error, data)


def _covers(table: RegisterTable, address: int, data: bytes) -> bool:
    """Whether bytes written at an address set the goal as well."""
    return address <= table.goal.address < address + len(data)
