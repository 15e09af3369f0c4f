"""Packets of servo buses: Dynamixel protocols 1.0 and 2.0, and LewanSoul's; Feetech servos speak 1.0.

1.0: FF FF id length instruction parameters sum; length = parameters + 2, sum = ~(all after the header) & FF.
LewanSoul: 55 55 id length command parameters sum; length = parameters + 3, the same sum.
2.0: FF FF FD 00 id length(2) instruction parameters crc(2); length = parameters + 3, FD stuffed after each
FF FF FD in the parameters. A status packet has the error before its parameters (ROBOTIS e-Manual).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import fastcrc

#: Id that all servos obey and none answers.
BROADCAST = 0xFE

PING, READ, WRITE, REBOOT, SYNC_READ, SYNC_WRITE, STATUS = 0x01, 0x02, 0x03, 0x08, 0x82, 0x83, 0x55

#: Longest parameters that a packet may have; a longer length is garbage.
MOST_PARAMETERS = 250

#: What `PacketFormat.take` finds: id, instruction or error, parameters.
Packet = tuple[int, int, bytes]


@dataclass(frozen=True, slots=True)
class StatusPacket:
    """Answer of a servo, with its error byte."""

    servo_id: int
    error: int
    parameters: bytes


def inverted_sum(body: bytes) -> int:
    """Checksum of protocol 1.0."""
    return ~sum(body) & 0xFF


class PacketFormat(ABC):
    """Encoder and decoder of a protocol's packets.

    Attributes:
        width: bytes of an address or a size in parameters.
        probe: instruction that every servo answers without any change.
        checksum: of the bytes between the header and the checksum, 0 to 255.
        names_question: whether an answer names its instruction.
        reports: whether a board with sensors sends packets by itself.
    """

    width = 1
    probe = PING
    names_question = False
    reports = False

    @abstractmethod
    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet of a servo's answer."""
        return self.instruction(servo_id, error, parameters)

    def status_size(self, parameters: int) -> int:
        """Bytes of an answer with this number of parameters, without stuffing."""
        return len(self.status(0, 0, bytes(parameters)))

    def size(self, packet: Packet) -> int:
        """Bytes of an encoded packet."""
        return len(self.instruction(*packet))

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None if unknown."""
        if instruction == READ and len(parameters) == 2 * self.width:
            return int.from_bytes(parameters[self.width :], "little")
        return {PING: 0, WRITE: 0, REBOOT: 0}.get(instruction)

    def answers(self, request: bytes, answer: StatusPacket) -> bool:
        """Whether an answer may be one to the request."""
        return True

    def absent(self, answer: StatusPacket) -> bool:
        """Whether a board answers in place of a servo that does not."""
        return False

    def is_report(self, packet: StatusPacket) -> bool:
        """Whether a board sends a packet by itself."""
        return False

    def address_bytes(self, address: int, size: int) -> bytes:
        """Parameters that address some bytes of a servo's memory."""
        return address.to_bytes(self.width, "little") + size.to_bytes(self.width, "little")

    def split_address(self, parameters: bytes) -> tuple[int, int, bytes]:
        """Address, size and the rest of parameters that begin as `address_bytes` writes them."""
        rest = 2 * self.width
        address, size = parameters[: self.width], parameters[self.width : rest]
        return int.from_bytes(address, "little"), int.from_bytes(size, "little"), parameters[rest:]

    @abstractmethod
    def take(self, data: bytes) -> tuple[Packet | None, int]:
        """First packet, and the number of bytes to discard.

        Without a complete packet it is None. Garbage is skipped a byte at a time to find a packet behind it.
        """

    def as_status(self, packet: Packet) -> StatusPacket | None:
        """The packet as an answer; None for an instruction."""
        return StatusPacket(*packet)


class SumPackets(PacketFormat):
    """Packets with a sum: those of protocol 1.0, and LewanSoul's.

    Args:
        counted: bytes besides the parameters that the length counts.
        most_parameters: maximum number of parameters.
        answers: parameters of the answer by instruction, if answers repeat the instruction.
        probe: instruction that every servo answers without any change.
        checksum: of the bytes between the header and the checksum, 0 to 255.
    """

    def __init__(
        self,
        header: bytes,
        *,
        counted: int,
        most_parameters: int = MOST_PARAMETERS,
        most_id: int = BROADCAST,
        answers: Mapping[int, int] | None = None,
        probe: int = PING,
        checksum: Callable[[bytes], int] = inverted_sum,
    ) -> None:
        self.probe, self._checksum = probe, checksum
        self._header, self._counted = header, counted
        self._most, self._most_id, self._sizes = most_parameters, most_id, answers
        self.names_question = answers is not None

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""
        body = bytes([servo_id, len(parameters) + self._counted, instruction]) + parameters
        return self._header + body + bytes([self._checksum(body)])

    def size(self, packet: Packet) -> int:
        """Bytes of an encoded packet, without encoding it: polls measure each answer."""
        return 6 + len(packet[2])

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None if unknown."""
        if self._sizes is None:
            return super().answer_size(instruction, parameters)
        return self._sizes.get(instruction)

    def answers(self, request: bytes, answer: StatusPacket) -> bool:
        """Whether an answer may be one to the request."""
        if self._sizes is None:
            return True
        return answer.error == request[4] and len(answer.parameters) == self._sizes.get(answer.error)

    def take(self, data: bytes) -> tuple[Packet | None, int]:
        """First packet in bytes."""
        start, counted = data.find(self._header), self._counted
        while start >= 0:
            if len(data) < start + 4:
                return None, start
            servo_id, parameters = data[start + 2], data[start + 3] - counted
            if servo_id <= self._most_id and 0 <= parameters <= self._most:
                end = start + 6 + parameters
                if len(data) < end:
                    return None, start
                body = data[start + 2 : end - 1]
                if self._checksum(body) == data[end - 1]:
                    return (servo_id, body[2], body[3:]), end
            start = data.find(self._header, start + 1)
        return None, len(data) - data.endswith(self._header[:1])


class Protocol2(PacketFormat):
    """Packets of protocol 2.0."""

    width = 2
    _HEADER = b"\xff\xff\xfd\x00"

    def instruction(self, servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
        """Packet that instructs a servo."""
        inside = (bytes([instruction]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = self._HEADER + bytes([servo_id]) + (len(inside) + 2).to_bytes(2, "little") + inside
        return packet + crc16(packet).to_bytes(2, "little")

    def status(self, servo_id: int, error: int, parameters: bytes = b"") -> bytes:
        """Packet with which a servo answers."""
        return self.instruction(servo_id, STATUS, bytes([error]) + parameters)

    def answer_size(self, instruction: int, parameters: bytes) -> int | None:
        """Parameters of the answer to an instruction for one servo; None if unknown."""
        return 3 if instruction == PING else super().answer_size(instruction, parameters)

    def take(self, data: bytes) -> tuple[Packet | None, int]:
        """First packet in bytes; the error of an answer is its first parameter."""
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

    def as_status(self, packet: Packet) -> StatusPacket | None:
        """The packet as an answer; None for an instruction."""
        servo_id, code, parameters = packet
        answers = code == STATUS and parameters
        return StatusPacket(servo_id, parameters[0], parameters[1:]) if answers else None


#: Packet formats by version of the protocol.
PROTOCOLS: dict[int, PacketFormat] = {1: SumPackets(b"\xff\xff", counted=2), 2: Protocol2()}


class PacketStream:
    """Finds the answers of servos in received bytes; `garbled` counts bytes outside packets."""

    def __init__(self, packets: PacketFormat) -> None:
        self._packets = packets
        self._data = b""
        self.garbled = 0

    def feed(self, data: bytes) -> list[StatusPacket]:
        """Answers completed by these bytes."""
        self._data += data
        found: list[StatusPacket] = []
        while True:
            packet, done = self._packets.take(self._data)
            self._data = self._data[done:]
            if packet is None:
                self.garbled += done
                return found
            self.garbled += max(0, done - self._packets.size(packet))
            if (answer := self._packets.as_status(packet)) is not None:
                found.append(answer)

    def finish(self) -> list[StatusPacket]:
        """Remaining answers, behind a packet that never ends."""
        found: list[StatusPacket] = []
        while self._data:
            self._data, self.garbled = self._data[1:], self.garbled + 1
            found += self.feed(b"")
        return found


def _begun(data: bytes, header: bytes) -> int:
    """Number of bytes at the end that may begin a header."""
    return next((n for n in range(len(header) - 1, 0, -1) if data.endswith(header[:n])), 0)


def crc16(data: bytes) -> int:
    """CRC-16 of protocol 2.0: polynomial 8005, initial value 0, not reflected."""
    crc: int = fastcrc.crc16.umts(data)
    return crc
