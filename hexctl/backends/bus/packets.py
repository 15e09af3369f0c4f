"""Packets of Dynamixel protocols 1.0 and 2.0; Feetech servos speak the first one.

1.0: FF FF id length instruction parameters sum; length = parameters + 2, sum = ~(all after the header) & FF.
2.0: FF FF FD 00 id length(2) instruction parameters crc(2); length = parameters + 3, FD stuffed after each
FF FF FD in the parameters. A status packet has the error in front of its parameters (ROBOTIS e-Manual).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import fastcrc

#: Id that all servos obey and none answers.
BROADCAST = 0xFE

PING, READ, WRITE, REBOOT, SYNC_READ, SYNC_WRITE, STATUS = 0x01, 0x02, 0x03, 0x08, 0x82, 0x83, 0x55

#: Longest parameters that a packet may have; a longer length is garbage.
MOST_PARAMETERS = 250


@dataclass(frozen=True, slots=True)
class StatusPacket:
    """What a servo answers.

    Attributes:
        servo_id: of the servo.
        error: its error byte.
        parameters: what was asked for.
    """

    servo_id: int
    error: int
    parameters: bytes


class PacketFormat(ABC):
    """How packets of a protocol are written and found again in a stream of bytes."""

    @abstractmethod
    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""

    @abstractmethod
    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet with which a servo answers."""

    @abstractmethod
    def status_size(self, parameters: int) -> int:
        """Bytes of an answer with a number of parameters, without stuffing."""

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None where it is not known."""
        return None

    @abstractmethod
    def take(self, data: bytes) -> tuple[tuple[int, int, bytes] | None, int]:
        """First packet in bytes: id, instruction or error, parameters; and how many bytes are done with.

        Without a whole packet it is None, with the bytes in front of anything that may become one. Garbage is
        skipped a byte at a time, so that a packet behind it is found.
        """


class Protocol1(PacketFormat):
    """Packets of protocol 1.0."""

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""
        body = bytes([servo_id, len(parameters) + 2, instruction]) + parameters
        return b"\xff\xff" + body + bytes([_sum(body)])

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet with which a servo answers: an instruction packet with the error for its instruction."""
        return self.instruction(servo_id, error, parameters)

    def status_size(self, parameters: int) -> int:
        """Bytes of an answer."""
        return 6 + parameters

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None where it is not known."""
        return _answer_size(instruction, parameters, width=1, ping=0)

    def take(self, data: bytes) -> tuple[tuple[int, int, bytes] | None, int]:
        """First packet in bytes."""
        start = data.find(b"\xff\xff")
        while start >= 0:
            head = data[start : start + 4]
            if len(head) < 4:
                return None, start
            servo_id, length = head[2], head[3]
            if servo_id != 0xFF and 2 <= length <= MOST_PARAMETERS + 2:
                end = start + 4 + length
                if len(data) < end:
                    return None, start
                body = data[start + 2 : end - 1]
                if _sum(body) == data[end - 1]:
                    return (servo_id, body[2], body[3:]), end
            start = data.find(b"\xff\xff", start + 1)
        return None, len(data) - data.endswith(b"\xff")


class Protocol2(PacketFormat):
    """Packets of protocol 2.0."""

    _HEADER = b"\xff\xff\xfd\x00"

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""
        inside = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = self._HEADER + bytes([servo_id]) + (len(inside) + 2).to_bytes(2, "little") + inside
        return packet + crc16(packet).to_bytes(2, "little")

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet with which a servo answers."""
        return self.instruction(servo_id, STATUS, bytes([error]) + parameters)

    def status_size(self, parameters: int) -> int:
        """Bytes of an answer, without stuffing."""
        return 11 + parameters

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None where it is not known."""
        return _answer_size(instruction, parameters, width=2, ping=3)

    def take(self, data: bytes) -> tuple[tuple[int, int, bytes] | None, int]:
        """First packet in bytes; of an answer the error comes first of its parameters."""
        start = data.find(self._HEADER)
        while start >= 0:
            if len(data) < start + 7:
                return None, start
            servo_id, length = data[start + 4], int.from_bytes(data[start + 5 : start + 7], "little")
            if servo_id <= BROADCAST and 3 <= length <= 2 * MOST_PARAMETERS:
                end = start + 7 + length
                if len(data) < end:
                    return None, start
                if crc16(data[start : end - 2]) == int.from_bytes(data[end - 2 : end], "little"):
                    inside = data[start + 7 : end - 2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                    return (servo_id, inside[0], inside[1:]), end
            start = data.find(self._HEADER, start + 1)
        return None, len(data) - _begun(data, self._HEADER)


#: Packet formats by version of the protocol.
PROTOCOLS: dict[int, PacketFormat] = {1: Protocol1(), 2: Protocol2()}


class PacketStream:
    """Finds the answers of servos in what comes on a line.

    Args:
        packets: of the protocol.

    Attributes:
        garbled: bytes so far that belonged to no packet.
    """

    def __init__(self, packets: PacketFormat) -> None:
        self._packets, self._two = packets, isinstance(packets, Protocol2)
        self._data = b""
        self.garbled = 0

    def feed(self, data: bytes) -> list[StatusPacket]:
        """Answers that are whole with some more bytes."""
        self._data += data
        found: list[StatusPacket] = []
        while True:
            packet, done = self._packets.take(self._data)
            before, self._data = self._data[:done], self._data[done:]
            if packet is None:
                self.garbled += len(before)
                return found
            servo_id, code, parameters = packet
            self.garbled += len(before) - self._size(before, packet)
            if not self._two:
                found.append(StatusPacket(servo_id, code, parameters))
            elif code == STATUS and parameters:
                found.append(StatusPacket(servo_id, parameters[0], parameters[1:]))

    def finish(self) -> list[StatusPacket]:
        """Answers behind the beginning of a packet whose end does not come; nothing is left then."""
        found: list[StatusPacket] = []
        while self._data:
            self._data, self.garbled = self._data[1:], self.garbled + 1
            found += self.feed(b"")
        return found

    def _size(self, before: bytes, packet: tuple[int, int, bytes]) -> int:
        return min(len(before), len(self._packets.instruction(*packet)))


def _answer_size(instruction: int, parameters: bytes, *, width: int, ping: int) -> int | None:
    """Parameters of an answer, where numbers such as an address have a width in bytes."""
    if instruction == READ and len(parameters) == 2 * width:
        return int.from_bytes(parameters[width:], "little")
    return {PING: ping, WRITE: 0, REBOOT: 0}.get(instruction)


def _sum(body: bytes) -> int:
    return ~sum(body) & 0xFF


def _begun(data: bytes, header: bytes) -> int:
    """How many bytes at the end may begin a header."""
    return next((n for n in range(len(header) - 1, 0, -1) if data.endswith(header[:n])), 0)


def crc16(data: bytes) -> int:
    """CRC-16 of protocol 2.0: polynomial 8005, initial value 0, not reflected."""
    crc: int = fastcrc.crc16.umts(data)
    return crc
