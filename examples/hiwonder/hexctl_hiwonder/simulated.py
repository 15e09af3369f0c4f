"""A simulated board with LX servos, written from the board's firmware and protocol document, not the driver.

It works through one packet after the other, as the task of its firmware does. Its IMU has the offset that was
measured on a SpiderPi, and the noise in the data sheet of an MPU-6050.
"""

import struct
from collections.abc import Sequence

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.packets import Packet, PacketFormat, StatusPacket
from hexctl.backends.bus.servo_type import ServoType
from hexctl.backends.clock import PERIOD_S
from hexctl.robot.rotations import inverse, turned
from hexctl.simulators.board_faults import BusFaults
from hexctl.simulators.bus_servos import SimulatedServos
from hexctl.simulators.lx16a_servos import SimulatedLx16aServo
from hexctl.types import FloatArray, RobotState

#: Questions: command that the board sends to the servo, and bytes of the value.
READS = {
    0x05: (28, 2),
    0x07: (27, 2),
    0x09: (26, 1),
    0x0D: (32, 1),
    0x12: (14, 1),
    0x22: (19, 1),
    0x32: (21, 4),
    0x36: (23, 4),
    0x3A: (25, 1),
}

#: Orders: command that the board sends to the servo, and its parameters, None for those of the packet.
ORDERS: dict[int, tuple[int, bytes | None]] = {
    0x0B: (31, b"\0"),
    0x0C: (31, b"\1"),
    0x10: (13, None),
    0x30: (20, None),
}

#: Time that the firmware waits for a servo, and seconds for a byte to it.
SILENT_S, BYTE_S = 0.005, 10 / 115_200

EVERYONE = 0xFE

#: Reports of the IMU in a control period, and period of those of the battery.
IMU_REPORTS, BATTERY_S = 2, 1.0

#: Offset and noise of the IMU: rates in degrees per second, accelerations in g.
OFFSET_DEG_S, NOISE_DEG_S, NOISE_G = np.array([0.4, -0.7, -1.9]), 0.05, 0.004

G_M_S2 = 9.80665


def crc8(data: bytes) -> int:
    """CRC-8/MAXIM: polynomial 31, reflected, from 0."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8C if crc & 1 else 0)
    return crc


def frame(function: int, data: bytes) -> bytes:
    """Frame of the board."""
    body = bytes([function, len(data), *data])
    return bytes([0xAA, 0x55, *body, crc8(body)])


class Frames(PacketFormat):
    """Frames as the state machine of the firmware reads them."""

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Answer about a servo: to a subcommand, with its status and its value."""
        return frame(5, bytes([servo_id, instruction]) + parameters)

    def size(self, packet: Packet) -> int:
        """Bytes of a frame, as `take` finds it."""
        return (7 if packet[0] < 0x100 else 5) + len(packet[2])

    def take(self, data: bytes) -> tuple[Packet | None, int]:
        """First frame in bytes; a servo's has its first two bytes apart, any other begins with 100 hex."""
        for start in range(len(data)):
            if data[start : start + 2] != b"\xaa\x55"[: len(data) - start]:
                continue
            if len(data) < start + 4 or len(data) < (end := start + 5 + data[start + 3]):
                return None, start
            if crc8(data[start + 2 : end - 1]) == data[end - 1]:
                function, inside = data[start + 2], data[start + 4 : end - 1]
                if function != 5 or len(inside) < 2:
                    return (0x100 + function, 0, inside), end
                return (inside[0], inside[1], inside[2:]), end
        return None, len(data)

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Answer of a servo that is not silent."""
        return self.instruction(servo_id, error, b"\0" + parameters)

    def as_status(self, packet: Packet) -> StatusPacket | None:
        """Answer of a servo that is not silent, so that faults can change its value."""
        servo_id, subcommand, rest = packet
        return StatusPacket(servo_id, subcommand, rest[1:]) if rest[:1] == b"\0" and servo_id < 256 else None


class HiwonderBoard(SimulatedServos):
    """The board, and its servos on a line of their own."""

    servos: Sequence[SimulatedLx16aServo]

    def __init__(
        self, bus_map: BusMap, stance: FloatArray, faults: BusFaults, counts: dict[str, int]
    ) -> None:
        super().__init__(bus_map, stance, faults, counts)
        self.packets = Frames()
        self._noise = np.random.default_rng(1)
        self._periods = 0
        self._positions: list[FloatArray] = []

    def _new_servo(self, servo_id: int, model: ServoType, count: float) -> SimulatedLx16aServo:
        return SimulatedLx16aServo(servo_id, model, count)

    def obey(self, servo_id: int, instruction: int, parameters: bytes, now_s: float) -> list[bytes]:
        """Work through a frame: its subcommand is first, then mostly an id."""
        subcommand, of = servo_id, instruction
        self._counts["packets"] += 1
        if subcommand == 1:
            self._move(bytes([of]) + parameters, now_s)
        elif subcommand in ORDERS:
            command, fixed = ORDERS[subcommand]
            for servo in self._called(of):
                servo.write(command, parameters if fixed is None else fixed, now_s)
        elif subcommand in READS:
            return [self._read(subcommand, of)]
        return []

    def busy_s(self, servo_id: int, instruction: int, parameters: bytes) -> float:
        """Time that a frame takes on the servos' line."""
        if servo_id in READS:
            silent = self._value(servo_id, instruction) is None
            return SILENT_S if silent else (6 + 6 + READS[servo_id][1]) * BYTE_S
        if servo_id == 1:
            return (parameters[1] if len(parameters) > 1 else 0) * 10 * BYTE_S
        return 7 * BYTE_S

    def reports(self, state: RobotState) -> list[bytes]:
        """Frames of the IMU, and once a second of the battery."""
        acceleration, rate_deg_s = self._felt(state)
        sent = []
        for _ in range(IMU_REPORTS):
            noisy = [
                *(acceleration + self._noise.normal(0, NOISE_G, 3)),
                *(rate_deg_s + OFFSET_DEG_S + self._noise.normal(0, NOISE_DEG_S, 3)),
            ]
            sent.append(frame(7, struct.pack("<6f", *noisy)))
        if self._periods % round(BATTERY_S / PERIOD_S) == 0:
            voltage_v = self._faults.voltage(max(servo.usual_v for servo in self.servos))
            sent.append(frame(0, struct.pack("<BH", 4, round(1000 * voltage_v))))
        self._periods += 1
        return sent

    def _felt(self, state: RobotState) -> tuple[FloatArray, FloatArray]:
        """Acceleration in g and rate in degrees per second, by the body's axes; at rest if unknown."""
        rate, quaternion = state.angular_velocity_body_rad_s, state.base_quaternion_world
        force = np.array([0.0, 0.0, 1.0])
        if state.base_position_world is not None:
            self._positions = [*self._positions[-2:], state.base_position_world]
            if len(self._positions) == 3:
                first, middle, last = self._positions
                force = force + (last - 2 * middle + first) / PERIOD_S**2 / G_M_S2
        felt = force if quaternion is None else turned(inverse(quaternion), force)
        return felt, np.zeros(3) if rate is None else np.degrees(rate)

    def _move(self, data: bytes, now_s: float) -> None:
        self._counts["goals"] += 1
        time, elements = data[:2], data[3:]
        for place in range(min(data[2] if len(data) > 2 else 0, len(elements) // 3)):
            servo_id, low, high = elements[3 * place : 3 * place + 3]
            count = min(low + 256 * high, 1000)
            for servo in self._called(servo_id):
                servo.write(1, count.to_bytes(2, "little") + time, now_s)

    def _read(self, subcommand: int, servo_id: int) -> bytes:
        value = self._value(subcommand, servo_id)
        head = bytes([servo_id, subcommand])
        if value is None:
            return frame(5, head + b"\xff" + bytes(READS[subcommand][1]))
        return frame(5, head + b"\0" + value)

    def _value(self, subcommand: int, servo_id: int) -> bytes | None:
        """Value of the servo; None if it is silent, or if several answer and disturb each other."""
        values = {servo.answer(READS[subcommand][0]) for servo in self._called(servo_id)}
        return next(iter(values)) if len(values) == 1 else None

    def _called(self, servo_id: int) -> list[SimulatedLx16aServo]:
        ids = {servo.servo_id for servo in self.servos} if servo_id == EVERYONE else {servo_id}
        return [self.servos[joint] for joint in self.named(sorted(ids))]
