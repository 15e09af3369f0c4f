"""An I2C bus over a Unix socket, on which simulated boards answer.

A transaction is one byte, the count of its messages, then of each message its address, flags and length,
two bytes each with the low one first, and the bytes of messages that write. The answer is one byte, 0 or the
error number, and the bytes of messages that read.
"""

import contextlib
import os
import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: Flag of a message that reads, as of Linux.
READS = 0x0001

HEAD = struct.Struct("<HHH")

#: How long an answer may take, in s: simulated boards answer between two control periods.
TIMEOUT_S = 1.0


@dataclass(frozen=True, slots=True)
class I2cMessage:
    """One message of a transaction; `reads` is the number of bytes to read, 0 for a write."""

    address: int
    reads: int = 0
    data: bytes = b""


def encode_transaction(messages: Sequence[I2cMessage]) -> bytes:
    """Bytes of a transaction."""
    parts = [bytes([len(messages)])]
    for message in messages:
        flags, length = (READS, message.reads) if message.reads else (0, len(message.data))
        parts += [HEAD.pack(message.address, flags, length), message.data]
    return b"".join(parts)


def take_transaction(data: bytes) -> tuple[list[I2cMessage] | None, int]:
    """First transaction, None if incomplete, and the bytes that it takes."""
    if not data:
        return None, 0
    messages, at = [], 1
    for _ in range(data[0]):
        if len(data) < at + HEAD.size:
            return None, 0
        address, flags, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        reads = bool(flags & READS)
        written = b"" if reads else data[at : at + length]
        if not reads and len(written) < length:
            return None, 0
        at += len(written)
        messages.append(I2cMessage(address, length if reads else 0, written))
    return messages, at


class I2cSocket:
    """The controller's end, with the used methods of `smbus2.SMBus`; OSError if nothing listens there."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(TIMEOUT_S)
        try:
            self._socket.connect(path)
        except BaseException:
            self._socket.close()
            raise

    def write_byte_data(self, i2c_addr: int, register: int, value: int, /) -> None:
        """Write one byte to a register."""
        self._transfer([I2cMessage(i2c_addr, data=bytes([register, value]))])

    def read_byte_data(self, i2c_addr: int, register: int, /) -> int:
        """Byte of a register."""
        return self._transfer([I2cMessage(i2c_addr, data=bytes([register])), I2cMessage(i2c_addr, 1)])[0]

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Transfer messages of `smbus2.i2c_msg` in one transaction; those that read are filled."""
        messages = [
            I2cMessage(message.addr, message.len)
            if message.flags & READS
            else I2cMessage(message.addr, data=bytes(message))
            for message in i2c_msgs
        ]
        answer = self._transfer(messages)
        for message in i2c_msgs:
            if message.flags & READS:
                for place in range(message.len):
                    message.buf[place] = answer[place : place + 1]
                answer = answer[message.len :]

    def close(self) -> None:
        """Close the socket."""
        with contextlib.suppress(OSError):
            self._socket.close()

    def _transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        try:
            self._socket.sendall(encode_transaction(messages))
            code = self._receive(1)[0]
            answer = b"" if code else self._receive(sum(message.reads for message in messages))
        except OSError:
            self.close()  # an answer that comes late would be taken for the next one
            raise
        if code:
            raise OSError(code, os.strerror(code))
        return answer

    def _receive(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self._socket.recv(count - len(data))
            if not more:
                raise ConnectionResetError("the simulated boards are disconnected")
            data += more
        return data
