"""An I2C bus over a Unix socket of packets, on which simulated boards answer.

A transaction is one packet: of each message its address, flags and length, two bytes each with the low one
first, and the bytes of messages that write. The answer is one packet: a byte, 0 or the error number, and the
bytes of messages that read.
"""

import errno
import os
import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: Flag of a message that reads, as of Linux.
READS = 0x0001

HEAD = struct.Struct("<HHH")

#: Maximum length of a message, as of Linux.
MOST_BYTES = 8192

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
    parts = []
    for message in messages:
        flags, length = (READS, message.reads) if message.reads else (0, len(message.data))
        parts += [HEAD.pack(message.address, flags, length), message.data]
    return b"".join(parts)


def decode_transaction(data: bytes) -> list[I2cMessage]:
    """Messages of a transaction; raises struct.error for an invalid one."""
    messages, at = [], 0
    while at < len(data):
        address, flags, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        reads, writes = (length, 0) if flags & READS else (0, length)
        if len(data) < at + writes or length > MOST_BYTES:
            raise struct.error("a message ends early, or is too long")
        messages.append(I2cMessage(address, reads, data[at : at + writes]))
        at += writes
    return messages


class I2cSocket:
    """The controller's end, as `smbus2.SMBus`; OSError if nothing listens there."""

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(TIMEOUT_S)
        try:
            self._socket.connect(path)
        except BaseException:
            self._socket.close()
            raise

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
        self._socket.close()

    def _transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        size = 1 + sum(message.reads for message in messages)
        try:
            self._socket.send(encode_transaction(messages))
            answer = self._socket.recv(size)
        except OSError:
            self.close()  # an answer that comes late would be taken for the next one
            raise
        if not answer:
            raise ConnectionResetError("the simulated boards are disconnected")
        if answer[0]:
            raise OSError(answer[0], os.strerror(answer[0]))
        if len(answer) < size:
            raise OSError(errno.EPROTO, f"the simulated boards sent {len(answer)} of {size} bytes")
        return answer[1:]
