"""Packets of LewanSoul's (Hiwonder's) bus servos: LX-16A, LX-224, HTS-35H.

55 55 id length command parameters sum; length = parameters + 3, sum = ~(all after the header) & FF; numbers
are little-endian. What writes is not answered; an answer repeats the command that asked, which has no
parameters (LewanSoul Bus Servo Communication Protocol).
"""

from hexctl.backends.bus.packets import PacketFormat, StatusPacket

#: Commands that write.
MOVE, WRITE_ID, WRITE_LIMITS, WRITE_LOAD = 1, 13, 20, 31

#: Commands that ask.
READ_ID, READ_LIMITS, READ_VOLTAGE_LIMITS, READ_MOST_TEMPERATURE = 14, 21, 23, 25
READ_TEMPERATURE, READ_VOLTAGE, READ_POSITION, READ_LOAD = 26, 27, 28, 32

#: Parameters in the answer to each command that asks.
ANSWER_BYTES = {
    READ_ID: 1,
    READ_LIMITS: 4,
    READ_VOLTAGE_LIMITS: 4,
    READ_MOST_TEMPERATURE: 1,
    READ_TEMPERATURE: 1,
    READ_VOLTAGE: 2,
    READ_POSITION: 2,
    READ_LOAD: 1,
}

#: Longest parameters of any command.
MOST_PARAMETERS = 4

#: Longest time of a move, in ms.
MOST_MOVE_MS = 30_000

_HEADER = b"\x55\x55"


class Lx16aPackets(PacketFormat):
    """Packets of LewanSoul's protocol: an answer has the command that it answers in place of an error."""

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that commands a servo."""
        body = bytes([servo_id, len(parameters) + 3, instruction]) + parameters
        return _HEADER + body + bytes([_sum(body)])

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet with which a servo answers the command in `error`."""
        return self.instruction(servo_id, error, parameters)

    def status_size(self, parameters: int) -> int:
        """Bytes of a packet."""
        return 6 + parameters

    def take(self, data: bytes) -> tuple[tuple[int, int, bytes] | None, int]:
        """First packet in bytes: id, command, parameters; and how many bytes are done with."""
        start = data.find(_HEADER)
        while start >= 0:
            if len(data) < start + 4:
                return None, start
            length = data[start + 3]
            if 3 <= length <= MOST_PARAMETERS + 3:
                end = start + 3 + length
                if len(data) < end:
                    return None, start
                body = data[start + 2 : end - 1]
                if _sum(body) == data[end - 1]:
                    return (body[0], body[2], body[3:]), end
            start = data.find(_HEADER, start + 1)
        return None, len(data) - data.endswith(b"\x55")


#: The one format of the family.
LX16A = Lx16aPackets()


def move(servo_id: int, count: int, time_ms: int) -> bytes:
    """Packet that moves a servo to a count, 0 to 1000, in a time in ms."""
    time_ms = min(max(time_ms, 0), MOST_MOVE_MS)
    return LX16A.instruction(servo_id, MOVE, count.to_bytes(2, "little") + time_ms.to_bytes(2, "little"))


def load(servo_id: int, *, on: bool) -> bytes:
    """Packet that switches the torque of a servo."""
    return LX16A.instruction(servo_id, WRITE_LOAD, bytes([on]))


def answers(answer: StatusPacket, command: int) -> bool:
    """Whether a packet answers a command, and not one before it."""
    return answer.error == command and len(answer.parameters) == ANSWER_BYTES[command]


def number(parameters: bytes) -> int:
    """Number in the parameters of an answer; two bytes are signed, as positions are."""
    return int.from_bytes(parameters, "little", signed=len(parameters) == 2)


def _sum(body: bytes) -> int:
    return ~sum(body) & 0xFF
