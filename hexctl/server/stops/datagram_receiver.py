"""Receives all waiting datagrams of a UDP socket with one system call, `recvmmsg` of Linux.

Python's `recvfrom` releases the interpreter for each datagram, and may wait 5 ms to get it back.
"""

import ctypes
import select
import socket
import struct
from contextlib import suppress

from hexctl.wire.links import Endpoint

#: Datagrams per system call (UIO_MAXIOV of Linux), and calls in a row.
MOST_PER_CALL, MOST_CALLS = 1024, 4

#: Receive buffer in bytes, about 800 per datagram; without root limited by net.core.rmem_max.
BUFFER_BYTES = 8 << 20

#: Linux (asm-generic/socket.h): a buffer of any size.
SO_RCVBUFFORCE = 33

#: Longest address of a sender: a sockaddr_in6.
ADDRESS_BYTES = 28


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _Header(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_size", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_size", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    _fields_ = (("header", _Header), ("size", ctypes.c_uint))


class DatagramReceiver:
    """Receives the datagrams of a bound UDP socket; ones above `most_bytes` are cut to one byte more."""

    def __init__(self, bound: socket.socket, most_bytes: int) -> None:
        self._socket, self._step = bound, most_bytes + 1
        bound.setblocking(False)
        self._poll = select.poll()
        self._poll.register(bound, select.POLLIN)
        self._receive = ctypes.CDLL(None).recvmmsg
        self._data = ctypes.create_string_buffer(MOST_PER_CALL * self._step)
        self._senders = ctypes.create_string_buffer(MOST_PER_CALL * ADDRESS_BYTES)
        self._vectors = (_Vector * MOST_PER_CALL)()
        self._messages = (_Message * MOST_PER_CALL)()
        for number, (vector, message) in enumerate(zip(self._vectors, self._messages, strict=True)):
            vector.base = ctypes.addressof(self._data) + number * self._step
            vector.size = self._step
            message.header.name = ctypes.addressof(self._senders) + number * ADDRESS_BYTES
            message.header.name_size = ADDRESS_BYTES
            message.header.vectors = ctypes.addressof(vector)
            message.header.vector_count = 1

    def wait(self, timeout_s: float) -> bool:
        """Wait for a datagram or an error; return whether there is one."""
        return bool(self._poll.poll(1000 * timeout_s))

    def take(self) -> list[tuple[bytes, bytes]]:
        """Return the waiting datagrams, oldest first, with their senders as the kernel stores them."""
        taken: list[tuple[bytes, bytes]] = []
        for _ in range(MOST_CALLS):
            part = self._take()
            taken += part
            if len(part) < MOST_PER_CALL:
                break
        return taken

    def _take(self) -> list[tuple[bytes, bytes]]:
        number = self._socket.fileno()
        count = self._receive(number, self._messages, MOST_PER_CALL, socket.MSG_DONTWAIT, None)
        step, size = self._step, ADDRESS_BYTES
        data = ctypes.string_at(self._data, max(0, count) * step)
        senders = ctypes.string_at(self._senders, max(0, count) * size)
        return [
            (data[i * step : i * step + self._messages[i].size], senders[i * size : (i + 1) * size])
            for i in range(count)  # -1 for an error: nothing came, or an earlier answer did not arrive
        ]


def address_of(sender: bytes) -> tuple[object, ...]:
    """Return the address of a sender in the form of `socket`."""
    (family,) = struct.unpack_from("=H", sender)
    (port,) = struct.unpack_from("!H", sender, 2)
    if family == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, sender[4:8]), port
    (flow,) = struct.unpack_from("!I", sender, 4)
    (scope,) = struct.unpack_from("=I", sender, 24)
    return socket.inet_ntop(socket.AF_INET6, sender[8:24]), port, flow, scope


def bound_socket(endpoint: Endpoint) -> socket.socket:
    """Return a UDP socket at an endpoint with a large receive buffer; raises OSError."""
    kind = socket.SOCK_DGRAM
    family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    bound = socket.socket(family, kind)
    try:
        if family == socket.AF_INET6 and endpoint.is_everywhere:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):
            with suppress(OSError):  # only root may force it
                bound.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
        bound.bind(address)
    except OSError:
        bound.close()
        raise
    return bound
