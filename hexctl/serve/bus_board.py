"""A bus of servos on a pseudo-terminal, with a simulated robot behind them: byte by byte, in real time."""

import os
import random
import select
import time
import tty
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
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
)
from hexctl.backends.bus.registers import RegisterTable, table_of
from hexctl.control.guard import StepLimits
from hexctl.errors import RobotFaultError
from hexctl.robot.bus_map import BusMap
from hexctl.serve.bus_faults import BusFault, BusFaults
from hexctl.types import N_JOINTS, BoolArray, FloatArray, JointTargets, RobotState

#: Bytes of a servo's memory.
MEMORY = 256

#: Voltage and temperature of servos that nothing is wrong with, in V and degrees Celsius.
USUAL_V, USUAL_C = 12.0, 35.0

#: How long a servo hesitates before it answers, with its return delay at 0.
HESITATES_S = 0.00005

#: Time that is kept free before a tick.
SPARE_S = 0.0003


class BusServo:
    """One servo: its memory.

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

    def write(self, address: int, data: bytes) -> None:
        """Write bytes, as a controller does."""
        held = self.holds
        self.memory[address : address + len(data)] = data[: MEMORY - address]
        if self.memory[self._table.torque.address] and not held and not _covers(self._table, address, data):
            self.set(self._table.goal, self.number(self._table.position))  # it holds where it is


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
        self._table = table_of(bus_map.models[0].name)
        self._packets = PROTOCOLS[self._table.protocol]
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        stance = bus_map.counts(servos.robot.stance_angles_rad)
        self._servos = [
            BusServo(int(servo_id), self._table, model.number, count)
            for servo_id, model, count in zip(bus_map.ids, bus_map.models, stance, strict=True)
        ]
        self._limits = StepLimits.of(servos.robot, servos.clock.period_s)
        self._faults = BusFaults(faults, bus_map)
        self._random = random.Random(seed)  # noqa: S311  garbled bytes are no secret
        self._counters = BusBoardCounters()
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
        if self._faults.unplugged:
            return
        if self._faults.echoes:
            self._send(data)
        self._data += data
        while True:
            packet, done = self._packets.take(self._data)
            self._data = self._data[done:]
            if packet is None:
                return
            self._obey(*packet)

    def _obey(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        """Do what an instruction says, and answer."""
        if self._table.protocol == 2 and instruction == STATUS:
            return
        self._counters.packets += 1
        if instruction == SYNC_WRITE:
            self._sync_write(parameters)
            return
        if instruction == SYNC_READ and not self._table.sync_read:
            return
        if instruction == SYNC_READ:
            address, size, ids = self._place(parameters)
            answers = [self._status(one, self._read(one, address, size)) for one in self._of(list(ids))]
        else:
            broadcast = servo_id == BROADCAST
            chosen = self._servos if broadcast else self._of([servo_id])
            answers = [self._single(one, instruction, parameters) for one in chosen]
            if broadcast and instruction != PING:
                return
        self._answer(answers, len(parameters) + 8)

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
        """Servos that answer to some ids, in their order, but for those that are mute."""
        return [
            servo
            for servo_id in ids
            for joint, servo in enumerate(self._servos)
            if servo.servo_id == servo_id and not self._faults.mute[joint]
        ]

    def _read(self, servo: BusServo, address: int, size: int) -> bytes:
        return bytes(servo.memory[address : address + size]).ljust(size, b"\0")

    def _status(self, servo: BusServo, data: bytes) -> bytes:
        error = 0
        if servo.number(self._table.temperature) > self._faults.HOT_C:
            error = 1 << (2 if self._table.protocol == 1 else 7)
        return self._packets.status(servo.servo_id, error, data)

    def _answer(self, answers: list[bytes], asked: int) -> None:
        """Send answers no sooner than the line could carry them, garbled as the faults say."""
        if not answers:
            return
        self._counters.answers += len(answers)
        data = b"".join(self._faults.garbled(answer, self._random) for answer in answers)
        time.sleep(10.0 * (len(data) + asked) / self._baud + HESITATES_S * len(answers))
        self._send(data)

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
        for joint, new_id in self._faults.lost_ids.items():
            self._servos[joint].servo_id = new_id
        state = self._robot.read()
        self._move(state)
        self._show(state)

    def _move(self, state: RobotState) -> None:
        holds: BoolArray = np.array([servo.holds for servo in self._servos]) & ~self._faults.dead
        if not holds.any():
            if not self._limp:
                self._robot.disable_torque()
            self._limp, self._sent_rad = True, None
            return
        goals = np.array([servo.number(self._table.goal) for servo in self._servos])
        wanted = np.where(holds, self._map.angles_rad(goals), state.joint_positions_rad)
        before = state.joint_positions_rad if self._sent_rad is None else self._sent_rad
        self._sent_rad = self._limits.apply(wanted, before)
        self._robot.write(JointTargets(self._sent_rad, self._robot.clock.now_s))
        self._limp = False

    def _show(self, state: RobotState) -> None:
        """Put positions, loads, voltages and temperatures into the memories."""
        table = self._table
        counts = np.rint(self._map.counts(state.joint_positions_rad))
        limits = self._robot.robot.joint_max_torque_nm
        torques = np.zeros(N_JOINTS) if state.joint_torques_nm is None else state.joint_torques_nm
        efforts = self._map.signs * np.clip(torques / limits, -1, 1)
        for joint, servo in enumerate(self._servos):
            model = self._map.models[joint]
            servo.set(table.position, float(np.clip(counts[joint], model.least, model.most)))
            if table.effort is not None:
                servo.set(table.effort, efforts[joint])
            if table.current is not None:
                servo.set(table.current, efforts[joint])
            servo.set(table.voltage, self._faults.voltage(USUAL_V))
            servo.set(table.temperature, self._faults.temperatures.get(joint, USUAL_C))


def _covers(table: RegisterTable, address: int, data: bytes) -> bool:
    """Whether bytes written at an address set the goal as well."""
    return address <= table.goal.address < address + len(data)
