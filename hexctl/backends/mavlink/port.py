"""Ports that bytes go through: UDP sockets, serial devices, pseudo-terminals. None ever waits to send."""

import os
import select
import socket
import tty
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from hexctl.backends.mavlink.address import PortAddress
from hexctl.errors import RobotFaultError

#: Who sent something; None on a stream, which has one other end.
Address = Any

#: More than any datagram of MAVLink, and than what a stream holds between two looks.
CHUNK = 65_536

#: Datagrams or chunks taken at one go, so that a flood cannot keep a reader from its other work.
MOST_AT_ONCE = 64


class Port(ABC):
    """An opened port.

    Attributes:
        datagrams: True where what is received is whole frames with a sender's address.
        dropped: frames so far that could not be sent because the port was full or nobody was there.
    """

    datagrams = False

    def __init__(self) -> None:
        self.dropped = 0

    @abstractmethod
    def receive(self, patience_s: float) -> list[tuple[bytes, Address]]:
        """Return what came, with its senders, after waiting for something for a while.

        Raises OSError when the port has gone.
        """

    @abstractmethod
    def send(self, frame: bytes, to: Address) -> None:
        """Send a frame, or drop and count it; raises OSError when the port has gone."""

    @abstractmethod
    def close(self) -> None:
        """Close the port."""


class UdpPort(Port):
    """A UDP socket: bound where others come to, or bound to the one peer it speaks to."""

    datagrams = True

    def __init__(self, address: PortAddress) -> None:
        super().__init__()
        family, kind, protocol, _, where = socket.getaddrinfo(
            address.place, address.number, type=socket.SOCK_DGRAM
        )[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        try:
            if address.kind == "udpin":
                self._socket.bind(where)
            else:
                # The kernel then passes on only what comes from there.
                self._socket.connect(where)
        except BaseException:
            self._socket.close()
            raise
        self._speaks_first = address.kind == "udpout"

    def receive(self, patience_s: float) -> list[tuple[bytes, Address]]:
        """Return the datagrams that came."""
        came: list[tuple[bytes, Address]] = []
        if not select.select([self._socket], [], [], max(0.0, patience_s))[0]:
            return came
        while len(came) < MOST_AT_ONCE:
            try:
                data, sender = self._socket.recvfrom(CHUNK)
            except BlockingIOError:
                break
            except ConnectionError:
                # The system says that nobody listened when something was sent there: no news.
                continue
            came.append((data, None if self._speaks_first else sender))
        return came

    def send(self, frame: bytes, to: Address) -> None:
        """Send a datagram; one that nobody takes is dropped."""
        try:
            if self._speaks_first:
                self._socket.send(frame)
            elif to is not None:
                self._socket.sendto(frame, to)
        except OSError:
            # Nobody there, no route for the moment, buffer full: silence tells, as with a lost datagram.
            self.dropped += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StreamPort(Port):
    """A file descriptor to read from and write to: a serial device or a pseudo-terminal."""

    def __init__(self, descriptor: int, close: Callable[[], None]) -> None:
        super().__init__()
        self._descriptor, self._close = descriptor, close
        self._rest = b""
        os.set_blocking(descriptor, False)

    def receive(self, patience_s: float) -> list[tuple[bytes, Address]]:
        """Return the bytes that came."""
        if not select.select([self._descriptor], [], [], max(0.0, patience_s))[0]:
            return []
        try:
            data = os.read(self._descriptor, CHUNK)
        except BlockingIOError:
            return []
        if not data:
            raise OSError("the other end of the port has gone")
        return [(data, None)]

    def send(self, frame: bytes, to: Address) -> None:
        """Send a frame; one that does not fit is dropped whole, never torn."""
        self._rest = self._written(self._rest)
        if self._rest:
            self.dropped += 1
            return
        rest = self._written(frame)
        if len(rest) == len(frame):
            self.dropped += 1
        else:
            self._rest = rest

    def close(self) -> None:
        """Close the descriptor."""
        self._close()

    def _written(self, data: bytes) -> bytes:
        """Write what fits and return the rest."""
        if not data:
            return data
        try:
            return data[os.write(self._descriptor, data) :]
        except BlockingIOError:
            return data


def open_port(address: PortAddress, *, text: str) -> Port:
    """Open a port; `text` is how the user wrote it.

    Raises RobotFaultError that says what to check.
    """
    try:
        return open_serial(address) if address.kind == "serial" else UdpPort(address)
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RobotFaultError(
            f"the port {text} cannot be opened ({reason}); is the cable in, the name right, "
            "and no other program using it?"
        ) from error


def open_serial(address: PortAddress) -> StreamPort:
    """Open a serial device for this program alone, and forget what came before."""
    import serial

    device = serial.Serial(address.place, address.number, timeout=0, write_timeout=0, exclusive=True)
    try:
        device.reset_input_buffer()
        port = StreamPort(device.fileno(), device.close)
        # What a long wait left in the system's buffers is older than it looks.
        while port.receive(0.0):
            pass
    except BaseException:
        device.close()
        raise
    return port


class PtyPort(StreamPort):
    """A pseudo-terminal that others open like a serial device.

    Attributes:
        path: the device to open.
    """

    def __init__(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        # The slave stays open here: without it, the master could not be read while nobody is connected.
        self._both = (master, slave)
        super().__init__(master, self._close_both)

    def _close_both(self) -> None:
        for descriptor in self._both:
            os.close(descriptor)
