"""Packets of the board (`ros_robot_controller`), which repeats commands on a line of LX servos.

AA 55 function length data crc, with a CRC-8/MAXIM over all but the header. A question about a servo has the
data `subcommand id`, its answer `id subcommand status values`. The status is 0, or -1 for a silent servo.
Orders get no answer.

The vendor's Python SDK has the subcommands of torque exchanged: `bus_servo_enable_torque(id, True)` sends 0B.
By the firmware and the protocol document, 0B switches the torque off. Therefore the torque is read back.
"""

from collections.abc import Sequence

import fastcrc

from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.packets import Packet, PacketFormat, StatusPacket

HEADER = b"\xaa\x55"

#: Functions: those that report unasked, and the one of bus servos.
SYSTEM, BUS_SERVO, IMU, FUNCTIONS = 0, 5, 7, 12

#: Longest data of a packet that is no garbage: a radio's has 36 bytes.
MOST_DATA = 64

#: Subcommands of orders.
MOVE, TORQUE_OFF, TORQUE_ON = 0x01, 0x0B, 0x0C

#: Subcommands by the command that the board sends to a servo.
SUBCOMMANDS = {
    lx.READ_POSITION: 0x05,
    lx.READ_VOLTAGE: 0x07,
    lx.READ_TEMPERATURE: 0x09,
    lx.READ_LOAD: 0x0D,
    lx.WRITE_ID: 0x10,
    lx.READ_ID: 0x12,
    lx.READ_OFFSET: 0x22,
    lx.WRITE_LIMITS: 0x30,
    lx.READ_LIMITS: 0x32,
    lx.READ_VOLTAGE_LIMITS: 0x36,
    lx.READ_MOST_TEMPERATURE: 0x3A,
}
COMMANDS = {subcommand: command for command, subcommand in SUBCOMMANDS.items()}

#: Added to the function of a report, in place of an id.
REPORT = 0x100


def packet(function: int, data: bytes) -> bytes:
    """Packet with a function and data."""
    body = bytes([function, len(data)]) + data
    return HEADER + body + bytes([fastcrc.crc8.maxim_dow(body)])


def moves(goals: Sequence[tuple[int, int]], time_ms: int) -> bytes:
    """Packet that moves servos, by ids and counts, in one time."""
    elements = b"".join(bytes([servo_id]) + count.to_bytes(2, "little") for servo_id, count in goals)
    return packet(BUS_SERVO, bytes([MOVE]) + time_ms.to_bytes(2, "little") + bytes([len(goals)]) + elements)


class BoardPackets(PacketFormat):
    """The commands of LX servos in packets of the board."""

    probe = lx.READ_POSITION
    names_question = reports = True

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""
        if instruction == lx.MOVE:
            count, time_ms = (int.from_bytes(each, "little") for each in (parameters[:2], parameters[2:]))
            return moves([(servo_id, count)], time_ms)
        if instruction == lx.WRITE_LOAD:
            return packet(BUS_SERVO, bytes([TORQUE_ON if any(parameters) else TORQUE_OFF, servo_id]))
        return packet(BUS_SERVO, bytes([SUBCOMMANDS[instruction], servo_id]) + parameters)

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet of an answer of a servo, to an instruction in place of an error."""
        return packet(BUS_SERVO, bytes([servo_id, SUBCOMMANDS.get(error, 0), 0]) + parameters)

    def size(self, packet: Packet) -> int:
        """Bytes of an encoded packet, as `take` finds it."""
        return 5 + len(packet[2])

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo."""
        return lx.ANSWER_BYTES.get(instruction)

    def answers(self, request: bytes, answer: StatusPacket) -> bool:
        """Whether an answer may be one to the request."""
        return SUBCOMMANDS.get(answer.error) == request[4]

    def absent(self, answer: StatusPacket) -> bool:
        """Whether the servo gave the board no answer."""
        return not answer.parameters

    def is_report(self, packet: StatusPacket) -> bool:
        """Whether the board sends a packet by itself."""
        return packet.servo_id >= REPORT

    def take(self, data: bytes) -> tuple[Packet | None, int]:
        """First packet in bytes, as function, 0 and data."""
        start = data.find(HEADER)
        while start >= 0:
            if len(data) < start + 4:
                return None, start
            function, length = data[start + 2], data[start + 3]
            if function < FUNCTIONS and length <= MOST_DATA:
                end = start + 5 + length
                if len(data) < end:
                    return None, start
                if fastcrc.crc8.maxim_dow(data[start + 2 : end - 1]) == data[end - 1]:
                    return (function, 0, data[start + 4 : end - 1]), end
            start = data.find(HEADER, start + 1)
        return None, len(data) - data.endswith(HEADER[:1])

    def as_status(self, packet: Packet) -> StatusPacket | None:
        """A report, or the answer of a servo, without parameters if it was silent; None for anything else."""
        function, _, data = packet
        if function != BUS_SERVO:
            return StatusPacket(REPORT + function, 0, data)
        command = COMMANDS.get(data[1]) if len(data) > 3 else None
        size = lx.ANSWER_BYTES.get(command or 0)
        if command is None or size is None or len(data) != 3 + size:
            return None
        return StatusPacket(data[0], command, b"" if data[2] else data[3:])
