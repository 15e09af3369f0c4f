"""Simulated Dynamixel and Feetech servos on a bus, which have registers."""

import math
from collections.abc import Sequence

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.families.registers import Register, RegisterTable
from hexctl.backends.bus.packets import (
    BROADCAST,
    MOST_PARAMETERS,
    PING,
    READ,
    REBOOT,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
)
from hexctl.backends.bus.servo_type import ServoType
from hexctl.simulators.board_faults import BusFaults
from hexctl.simulators.bus_servos import USUAL_C, USUAL_V, SimulatedServo, SimulatedServos
from hexctl.types import FloatArray

#: Bytes of a servo's memory.
MEMORY = 256

#: Maximum time of a watchdog in units of 20 ms, and its value after expiry (-1).
MOST_WATCHDOG, EXPIRED = 127, 255

#: Codes of protocol 2 with which a write is refused, highest id, and operating modes of X servos and XL-320.
RANGE, LIMIT, ACCESS = 4, 6, 7
MOST_ID, _MODES = 252, (0, 1, 2, 3, 4, 5, 16)

#: Marks a silently dropped write.
_SILENTLY = 1 << 8

#: Firmware, by the number of its registers, and limits of the supply in V, of servos without a fault.
FIRMWARES, VOLTAGES_V = {0: (), 1: (45,), 2: (3, 10)}, (4.0, 14.0)

#: Lowest voltage of servos that do not complain of it, as a share of the usual one.
LOW_SHARE = 0.7


class BusServo(SimulatedServo):
    """One servo with registers."""

    def __init__(self, servo_id: int, model: ServoType, counts: float) -> None:
        self._table, self._model = (table := model.table), model
        self.memory = bytearray(MEMORY)
        self.overloaded = False
        self.set(table.model, model.number or 0)
        for register, value in (
            (table.servo_id, servo_id),
            (table.return_delay, 250),
            (table.least, model.least),
            (table.most, model.most),
            (table.shutdown, sum(1 << bit for bit in table.protections)),
            (table.max_torque, 1.0),
            *([] if table.slow_unit is None else [(table.slow_unit[0], 1 << table.slow_unit[1])]),
            (table.shadow_id, 255),
            *([] if table.status_level is None else [table.status_level]),
            *zip(table.firmware, FIRMWARES[len(table.firmware)], strict=True),
            *([] if table.voltages is None else zip(table.voltages, VOLTAGES_V, strict=True)),
            (table.overload_torque, 0.2),
            *((each.register, each.value) for each in table.tuning),
            (table.position, counts),
            (table.voltage, USUAL_V),
            (table.temperature, USUAL_C),
        ):
            if register is not None:
                self.set(register, value)
        for required in table.required:
            self.set(required.register, required.into(round(self.number(required.register))))
        self._kept = bytes(self.memory[: table.ram])
        self.restart()

    @property
    def servo_id(self) -> int:  # type: ignore[override]
        """Id that it answers to."""
        return self.memory[self._table.servo_id.address]

    def restart(self) -> None:
        """Restart after a loss of power: without torque, with stored settings."""
        table = self._table
        self.memory[: table.ram] = self._kept
        self.overloaded = False
        for register, value in (
            (table.torque, 0),
            (table.goal, self.number(table.position)),
            (table.hardware_error, 0),
            (table.watchdog, 0),
            (table.unlock, 1),
            *((each.register, each.value) for each in table.tuning if each.register.address >= table.ram),
            (table.torque_limit, 0 if table.max_torque is None else self.number(table.max_torque)),
            (table.soft_torque, 0 if table.max_torque is None else self.number(table.max_torque)),
        ):
            if register is not None:
                self.set(register, value)

    def lose_id(self, servo_id: int) -> None:
        """Change the id, also after a restart."""
        self.set(self._table.servo_id, servo_id)
        self._keep()

    def set(self, register: Register, value: float) -> None:
        """Write a number, in its unit, into the memory."""
        data = self._table.packed(register, value)
        self.memory[register.address : register.address + register.size] = data

    def number(self, register: Register) -> float:
        """Number in the memory, in its unit."""
        data = bytes(self.memory[register.address : register.address + register.size])
        return float(register.value(int.from_bytes(data, self._table.byte_order)))

    @property
    def holds(self) -> bool:
        """Whether it holds its goal: with torque, in position mode."""
        table = self._table
        if self.memory[table.torque.address] != 1:
            return False
        if table.torque_limit is not None and self.number(table.torque_limit) == 0:
            return False
        if table.mode is not None:
            return self.memory[table.mode.register.address] == table.mode.value
        return not self.number(table.least) == self.number(table.most) == 0

    def goal(self, now_s: float) -> float:
        """Target count, clipped to its limits."""
        least, most = self.number(self._table.least), self.number(self._table.most)
        goal = self.number(self._table.goal)
        return float(np.clip(goal, least, most)) if least < most else goal

    def show(self, count: float, effort: float, voltage_v: float, temperature_c: float) -> None:
        """Put position, load, voltage and temperature into the memory."""
        table, within = self._table, np.clip(np.rint(count), self._model.least, self._model.most)
        numbers = (float(within), effort, effort, voltage_v, temperature_c)
        for register, number in zip(table.reported, numbers, strict=True):
            if register is not None:
                self.set(register, number)

    @property
    def _overloaded_share(self) -> float:
        share = self._table.overload_torque
        return 0.0 if share is None else self.number(share)

    @property
    def _expired(self) -> bool:
        watchdog = self._table.watchdog
        return watchdog is not None and self.memory[watchdog.address] == EXPIRED

    def watch(self, silent_s: float) -> None:
        """Let the watchdog expire after a silence of the line, in s, with torque on."""
        watchdog = self._table.watchdog
        if watchdog is None or not self.holds or not 0 < self.memory[watchdog.address] <= MOST_WATCHDOG:
            return
        if silent_s > 0.02 * self.memory[watchdog.address]:
            self.memory[watchdog.address] = EXPIRED

    def trip(self, *, hot: bool = False) -> None:
        """Lose the torque because of an overload or heat, by its shutdown conditions and model."""
        table, words = self._table, "heat" if hot else "overload"
        bit = next(bit for bit, each in table.protections.items() if each == words)
        self.overloaded = self.overloaded or not hot
        if table.shutdown is not None and not self.memory[table.shutdown.address] >> bit & 1:
            return
        if table.hardware_error is not None:
            name = "hot" if hot else "overload"
            error = next(bit for bit, each in table.hardware_errors.items() if each == name)
            self.memory[table.hardware_error.address] |= 1 << error
            self.memory[table.torque.address] = 0
        elif table.protocol == 1 and table.torque_limit is not None and table.unlock is None:
            self.set(table.torque_limit, 0)  # AX
        elif hot:
            self.memory[table.torque.address] = 0
        elif table.torque_limit is not None:
            self.set(table.torque_limit, self._overloaded_share)  # STS holds on with that

    def _tripped(self) -> bool:
        """Whether an alert that its shutdown conditions name is on."""
        error, shutdown = self._table.hardware_error, self._table.shutdown
        if error is None or shutdown is None:
            return False
        return bool(self.memory[error.address] & self.memory[shutdown.address])

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the memory; 0 beyond its end."""
        return bytes(self.memory[address : address + size]).ljust(size, b"\0")

    def write(self, address: int, data: bytes) -> int:
        """Write bytes, as a controller does; the result is the error byte of the answer.

        Stored settings do not change while the torque is on. Dynamixel servos refuse a goal beyond the
        limits, or after the watchdog has expired.
        """
        if said := self._refuses(address, data):
            return said & ~_SILENTLY
        table, held = self._table, self.memory[self._table.torque.address] == 1
        self.memory[address : address + len(data)] = data[: MEMORY - address]
        if self._tripped():
            self.memory[table.torque.address] = 0  # only a restart helps
        if self.memory[table.torque.address] and not held and not _covers(table, address, data):
            self.set(table.goal, self.number(table.position))  # it holds where it is
        if table.torque_limit is not None and self.number(table.torque_limit) > self._overloaded_share:
            self.overloaded = False
        if address < table.ram and (table.unlock is None or not self.memory[table.unlock.address]):
            self._keep()
        return 0

    def _keep(self) -> None:
        self._kept = bytes(self.memory[: self._table.ram])

    def _refuses(self, address: int, data: bytes) -> int:
        """Error byte of a refused write, `_SILENTLY` for a dropped one; else 0."""
        table = self._table
        two, dynamixel = table.protocol == 2, table.unlock is None
        if dynamixel and address < table.ram and self.memory[table.torque.address]:
            return ACCESS if two else _SILENTLY
        if two and address in (table.model.address, table.position.address):
            return ACCESS
        if two and address == table.servo_id.address and data[0] > MOST_ID:
            return RANGE
        if (
            two
            and table.mode is not None
            and address == table.mode.register.address
            and data[0] not in _MODES
        ):
            return RANGE
        if address == table.goal.address and len(data) >= table.goal.size:
            goal = table.goal.value(int.from_bytes(data[: table.goal.size], table.byte_order))
            least, most = self.number(table.least), self.number(table.most)
            if self._expired:
                return _SILENTLY
            if dynamixel and least < most and not least <= goal <= most:
                return LIMIT if two else 1 << 1
        return 0


class RegisterServos(SimulatedServos):
    """Servos with registers."""

    servos: Sequence[BusServo]

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counts: dict[str, int]
    ) -> None:
        super().__init__(bus_map, stance, faults, counts)
        self._table = bus_map.models[0].table
        self._heard_s = -math.inf

    def _new_servo(self, servo_id: int, model: ServoType, count: float) -> BusServo:
        return BusServo(servo_id, model, count)

    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Execute an instruction; its answers."""
        if self._table.protocol == 2 and instruction == STATUS:
            return []
        for servo in self.servos:
            servo.watch(now_s - self._heard_s)
        self._heard_s = now_s
        if not self._complete(instruction, parameters):
            self._counts["garbage"] += 1
            return []
        self._counts["packets"] += 1
        if instruction == SYNC_WRITE:
            self._sync_write(parameters)
            return []
        if instruction == SYNC_READ:
            address, size, ids = self.packets.split_address(parameters)
            called = self._called(ids) if self._table.sync_read else []
            return [self._status(servo, servo.read(address, size)) for servo in called]
        broadcast = servo_id == BROADCAST
        chosen = self.servos if broadcast else self._called([servo_id])
        answers = [self._single(servo, instruction, parameters) for servo in chosen]
        return [] if broadcast and instruction != PING else answers

    def answer_together(self, servo_id: int, instruction: int) -> bool:
        """Whether several servos that an instruction asks answer at once, not in turn."""
        in_turn = instruction == SYNC_READ or (instruction == PING and self._table.protocol == 2)
        return servo_id != BROADCAST or not in_turn

    def _single(self, servo: BusServo, instruction: int, parameters: bytes) -> bytes:
        servo_id, data, error = servo.servo_id, b"", 0
        if instruction == READ:
            data = servo.read(*self.packets.split_address(parameters)[:2])
        elif instruction == WRITE:
            width = self.packets.width
            error = servo.write(int.from_bytes(parameters[:width], "little"), parameters[width:])
        elif instruction == PING and self._table.protocol == 2:
            data = servo.read(self._table.model.address, 2) + b"\x30"
        elif instruction == REBOOT:
            servo.restart()
        return self._status(servo, data, error, servo_id=servo_id)

    def _sync_write(self, parameters: bytes) -> None:
        address, size, rows = self.packets.split_address(parameters)
        self._counts["goals"] += address == self._table.goal.address
        for start in range(0, len(rows) - size, size + 1):
            for servo in self._called([rows[start]]):
                servo.write(address, rows[start + 1 : start + 1 + size])

    def _complete(self, instruction: int, parameters: bytes) -> bool:
        width = self.packets.width
        if instruction == WRITE:
            return len(parameters) > width
        if instruction in (READ, SYNC_READ, SYNC_WRITE):
            size = self.packets.split_address(parameters)[1]
            return len(parameters) >= 2 * width and 1 <= size <= MOST_PARAMETERS
        return True

    def _called(self, ids: Sequence[int]) -> list[BusServo]:
        return [self.servos[joint] for joint in self.named(ids)]

    def _status(self, servo: BusServo, data: bytes, code: int = 0, *, servo_id: int | None = None) -> bytes:
        table, error = self._table, code
        hot = servo.number(table.temperature) > self._faults.HOT_C
        low = servo.number(table.voltage) < LOW_SHARE * USUAL_V
        if table.hardware_error is None:
            for bit, words in table.errors.items():
                says = {"hot": hot, "voltage": low, "overload": servo.overloaded}
                error |= says.get(words, False) << bit
        elif hot or low or servo.memory[table.hardware_error.address]:
            error |= 1 << 7
        return self.packets.status(servo.servo_id if servo_id is None else servo_id, error, data)


def _covers(table: RegisterTable, address: int, data: bytes) -> bool:
    return address <= table.goal.address < address + len(data)
