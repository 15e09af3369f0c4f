"""Ports for MAVLink frames: UDP, serial, pseudo-terminal; sequence numbers and link counters."""

import ipaddress
import os
import re
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from hexctl.backends.board_lock import BoardLock
from hexctl.backends.bus.serial_line import open_device
from hexctl.backends.mavlink.codec import Codec, Frame
from hexctl.backends.serial_ports import SerialAddress
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.servos.drivers import BAUD
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.waiting import wait_ready

#: Default port of a board.
DEFAULT_BOARD_PORT = "udpin:127.0.0.1:14550"

#: Default port of a client.
DEFAULT_PORT = "udpout:127.0.0.1:14550"

DEFAULT_BAUD = 115_200

ALLOWED = (
    "udpin:HOST:PORT, udpout:HOST:PORT, or a serial device such as /dev/ttyACM0 or /dev/ttyACM0:115200, at "
    f"{BAUD.low:.0f} to {BAUD.high:.0f} baud"
)

#: Address of a sender; None on a stream, which has one other end.
Address = Any

#: Bytes per read: more than any MAVLink datagram, and than a stream holds between two reads.
CHUNK = 65_536

#: Datagrams per call, so that a flood cannot keep a reader from its other work.
MAX_DATAGRAMS = 64

#: Sequence numbers count modulo this.
MODULUS = 256

#: A sender may have restarted after this silence: its next number is not compared.
FORGET_AFTER_S = 0.5

#: Maximum addresses with separate sequence numbers; more only occur in a flood.
MOST_ADDRESSES = 64


@dataclass(frozen=True, slots=True)
class PortAddress:
    """Address of a port: host and UDP port, or device and baud rate.

    `kind` is `udpin`, which waits for peers, `udpout`, which sends first, or `serial`.
    """

    kind: Literal["udpin", "udpout", "serial"]
    place: str
    number: int

    @property
    def local(self) -> bool:
        """Whether only this computer and its cables reach the port."""
        if self.kind == "serial" or self.place == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.place).is_loopback
        except ValueError:
            return False


def parse_port(text: str) -> PortAddress:
    """Address of `udpout:HOST:PORT`, `/dev/ttyACM0:115200` ...; raises InputError for anything else."""
    udp = re.fullmatch(r"(udpin|udpout):(\[[0-9a-fA-F:]+\]|[^:\s]+):([0-9]{1,5})", text)
    if udp and 0 < int(udp[3]) < 65536:
        kind: Literal["udpin", "udpout"] = "udpin" if udp[1] == "udpin" else "udpout"
        return PortAddress(kind, udp[2].strip("[]"), int(udp[3]))
    if not re.match(r"(serial:)?/", text):
        raise InputError(f"{argument('port')}: got {text!r}; allowed: {ALLOWED}")
    serial = SerialAddress.parse(text.removeprefix("serial:"), DEFAULT_BAUD, allowed=ALLOWED)
    return PortAddress("serial", serial.path, serial.baud)


def check_guarded(address: PortAddress, *, option: str, text: str, signed: bool, insecure: bool) -> None:
    """Raise InputError for an unsigned port that the network reaches, unless `insecure`."""
    if not (address.local or signed or insecure):
        raise InputError(
            f"{option}: got {text}, where anybody on the network could move the servos; "
            "allowed: this computer, a folder with a mavlink.key (hexctl keys mavlink), or "
            f"{argument('insecure')}"
        )


class Port(ABC):
    """An opened port; with `datagrams` it receives complete frames and their senders.

    `dropped` are frames that could not be sent: the port was full, or without a peer.
    """

    datagrams = False

    def __init__(self) -> None:
        self.dropped = 0

    @abstractmethod
    def receive(self, timeout_s: float) -> list[tuple[bytes, Address]]:
        """Received bytes with their senders, within `timeout_s`; raises OSError when the port is lost."""

    @abstractmethod
    def send(self, frame: bytes, to: Address) -> None:
        """Send a frame, or drop and count it; raises OSError when the port is lost."""

    @abstractmethod
    def close(self) -> None:
        """Close the port."""


class UdpPort(Port):
    """A UDP socket: bound to an address that peers send to, or connected to one peer."""

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
                # The kernel then delivers only what this peer sends.
                self._socket.connect(where)
        except BaseException:
            self._socket.close()
            raise
        self._speaks_first = address.kind == "udpout"

    def receive(self, timeout_s: float) -> list[tuple[bytes, Address]]:
        """Datagrams received."""
        came: list[tuple[bytes, Address]] = []
        if not wait_ready(self._socket.fileno(), max(0.0, timeout_s)):
            return came
        while len(came) < MAX_DATAGRAMS:
            try:
                data, sender = self._socket.recvfrom(CHUNK)
            except BlockingIOError:
                break
            except ConnectionError:
                # The peer did not listen when something was sent to it: not an error.
                continue
            came.append((data, None if self._speaks_first else sender))
        return came

    def send(self, frame: bytes, to: Address) -> None:
        """Send a datagram; it is dropped if it cannot be delivered."""
        try:
            if self._speaks_first:
                self._socket.send(frame)
            elif to is not None:
                self._socket.sendto(frame, to)
        except OSError:
            # No peer, no route for the moment, buffer full: like a lost datagram.
            self.dropped += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StreamPort(Port):
    """A file descriptor to read from and write to: a serial device or a pseudo-terminal."""

    def __init__(self, descriptor: int, close: Callable[[], None]) -> None:
        super().__init__()
        self._descriptor, self._close = descriptor, close
        self._unsent = b""
        os.set_blocking(descriptor, False)

    def receive(self, timeout_s: float) -> list[tuple[bytes, Address]]:
        """Bytes received."""
        if not wait_ready(self._descriptor, max(0.0, timeout_s)):
            return []
        try:
            data = os.read(self._descriptor, CHUNK)
        except BlockingIOError:
            return []
        if not data:
            raise OSError("the other end of the port is closed")
        return [(data, None)]

    def send(self, frame: bytes, to: Address) -> None:
        """Send a complete frame, or drop it."""
        self._unsent = self._written(self._unsent)
        if self._unsent:
            self.dropped += 1
            return
        unsent = self._written(frame)
        if len(unsent) == len(frame):
            self.dropped += 1
        else:
            self._unsent = unsent

    def close(self) -> None:
        """Close the descriptor."""
        self._close()

    def _written(self, data: bytes) -> bytes:
        if not data:
            return data
        try:
            return data[os.write(self._descriptor, data) :]
        except BlockingIOError:
            return data


def open_port(address: PortAddress, *, text: str) -> Port:
    """Open a port; `text` is the user's. Raises RobotFaultError with advice."""
    if address.kind == "serial":
        return _open_serial(address)
    try:
        return UdpPort(address)
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RobotFaultError(
            f"the port {text} cannot be opened ({reason}); is the address right, and is no "
            "other program using it?"
        ) from error


def lock_port(address: PortAddress, *, text: str) -> BoardLock:
    """Right of a controller to command the board at a UDP port, by any name of its host.

    Serial devices have their own lock. Raises RobotFaultError if another program commands it.
    """
    if address.kind == "serial":
        return BoardLock(text, ())
    try:
        hosts = [found[4][0] for found in socket.getaddrinfo(address.place, None, type=socket.SOCK_DGRAM)]
    except OSError:
        hosts = [address.place]  # opening it says why
    return BoardLock(f"the port {text}", [f"{address.kind} {hosts[0]} {address.number}"])


def _open_serial(address: PortAddress) -> StreamPort:
    device = open_device(address.place, address.number)
    try:
        device.reset_input_buffer()
        port = StreamPort(device.fileno(), device.close)
        # What waited in the buffers of the system is older than its arrival suggests.
        while port.receive(0.0):
            pass
    except BaseException:
        device.close()
        raise
    return port


@dataclass(slots=True)
class SequenceCount:
    """Counts lost, and late or repeated (`out_of_order`) frames of one sender by their sequence numbers."""

    lost: int = 0
    out_of_order: int = 0
    _newest: int | None = None
    _at_s: float = 0.0

    def in_order(self, number: int, at_s: float) -> bool:
        """Whether a frame is newer than all before it; counts frames missing in between.

        Numbers count modulo 256: up to 127 ahead is later, everything else is earlier. Longer gaps look
        shorter.
        """
        newest, silent_s = self._newest, at_s - self._at_s
        ahead = 1 if newest is None or silent_s > FORGET_AFTER_S else (number - newest) % MODULUS
        if not 1 <= ahead < MODULUS // 2:
            self.out_of_order += 1
            # A late frame was counted as lost when its successor arrived; a repeated one was not.
            self.lost -= 1 if ahead and self.lost else 0
            return False
        self.lost += ahead - 1
        self._newest, self._at_s = number, at_s
        return True


@dataclass(slots=True)
class LinkCounters:
    """Counters of a link.

    Attributes:
        lost: messages of the board that never arrived, by their sequence numbers.
        out_of_order: late or repeated messages; they are not used.
        late: messages of the board with an old stamp; they are not used.
        refused: messages with impossible values.
        foreign: messages of other systems.
        malformed: runs of undecodable bytes: noise, MAVLink 1, unsigned frames, another dialect.
        dropped: outgoing messages that the port could not take.
        clipped: commands that a pulse limit changed.
    """

    received: int = 0
    lost: int = 0
    out_of_order: int = 0
    late: int = 0
    refused: int = 0
    foreign: int = 0
    malformed: int = 0
    dropped: int = 0
    clipped: int = 0


class MavlinkLink:
    """A port with a codec; sends from any thread, receives on one."""

    def __init__(self, port: Port, codec: Codec, *, time: TimeSource = WALL_TIME) -> None:
        self.port, self.codec, self.time = port, codec, time
        self._sending = threading.Lock()
        self._sequences: dict[Address, int] = {}
        self.received_bytes = 0

    def send(self, message: Any, to: Address = None) -> None:
        """Send a message, or drop it if the port is full; raises OSError when the port is lost."""
        with self._sending:
            # Each receiver counts lost frames by these numbers, so each address has its own.
            sequence = self._sequences.pop(to, -1) + 1
            if len(self._sequences) >= MOST_ADDRESSES:
                # The least recently used one: to begin again would make a receiver drop frames as late.
                del self._sequences[next(iter(self._sequences))]
            self._sequences[to] = sequence
            self.port.send(self.codec.encode(message, sequence), to)

    def receive(self, timeout_s: float) -> list[tuple[Frame, Address, float]]:
        """Frames received within `timeout_s`, the address of each sender, and when each arrived.

        Raises OSError when the port is lost.
        """
        arrivals: list[tuple[Frame, Address, float]] = []
        for data, sender in self.port.receive(timeout_s):
            at_s = self.time.now()
            self.received_bytes += len(data)
            frames = self.codec.decode(data, whole=self.port.datagrams)
            arrivals += [(frame, sender, at_s) for frame in frames]
        return arrivals

    def close(self) -> None:
        """Close the port."""
        self.port.close()
