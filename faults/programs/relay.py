"""A relay that loses, delays or holds what passes: `python -m faults.programs.relay KIND PORT SEED [AT]`.

KIND is `tcp`, for a link over Zenoh, or `udp`, for MAVLink; PORT is where it passes on to, on loopback;
AT is the port where it listens, by default a free one.
Prints the port where it listens, and takes lines on stdin: `loss 0.1`, `reorder 0.1`, `delay 0.05`,
`garble 0.05`, `cut`, `clear`. Losses are drawn from the seed.

Zenoh's frames on a TCP stream begin with their length in two bytes, so that whole frames can be lost; what
TCP itself would send again is lost for good, as over UDP or a radio.
"""

import heapq
import os
import random
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

#: How far behind it a frame is held that is overtaken by the next ones.
OVERTAKEN_S = 0.03

CHUNK = 65_536


@dataclass
class Condition:
    """What the relay does to frames now.

    Attributes:
        loss: share that is lost.
        reorder: share that is overtaken.
        delay_s: of every frame.
        garble: share of which a byte is changed.
        cut: whether nothing passes.
    """

    loss: float = 0.0
    reorder: float = 0.0
    delay_s: float = 0.0
    garble: float = 0.0
    cut: bool = False

    def change(self, line: str) -> None:
        """Obey a line."""
        word, _, number = line.partition(" ")
        if word == "cut":
            self.cut = True
        elif word == "clear":
            self.loss = self.reorder = self.delay_s = self.garble = 0.0
            self.cut = False
        else:
            setattr(self, {"delay": "delay_s"}.get(word, word), float(number))


@dataclass
class Frames:
    """Whole frames of one direction of a TCP stream."""

    waiting: bytes = b""

    def take(self, data: bytes) -> Iterator[bytes]:
        """Frames that are complete with more bytes."""
        self.waiting += data
        while len(self.waiting) >= 2:
            size = 2 + int.from_bytes(self.waiting[:2], "little")
            if len(self.waiting) < size:
                return
            frame, self.waiting = self.waiting[:size], self.waiting[size:]
            yield frame


@dataclass
class Queue:
    """Frames on their way, the next one to arrive first.

    Attributes:
        condition: what is done to them.
        chance: of it.
    """

    condition: Condition
    chance: random.Random
    _due: list[tuple[float, int, bytes, Callable[[bytes], None]]] = field(default_factory=list)
    _count: int = 0

    def put(self, frame: bytes, send: Callable[[bytes], None]) -> None:
        """Take a frame, or lose it."""
        now = self.condition
        if now.cut or self.chance.random() < now.loss:
            return
        if self.chance.random() < now.garble:
            place = self.chance.randrange(len(frame))
            frame = frame[:place] + bytes([self.chance.randrange(256)]) + frame[place + 1 :]
        late_s = now.delay_s + (OVERTAKEN_S if self.chance.random() < now.reorder else 0.0)
        if late_s == 0.0 and not self._due:
            send(frame)
            return
        self._count += 1
        heapq.heappush(self._due, (time.monotonic() + late_s, self._count, frame, send))

    def pass_on(self) -> float | None:
        """Send what is due; how long until the next frame is, None without one."""
        while self._due and self._due[0][0] <= time.monotonic():
            _, _, frame, send = heapq.heappop(self._due)
            send(frame)
        return max(0.0, self._due[0][0] - time.monotonic()) if self._due else None


class TcpRelay:
    """Connections to a port, frame by frame."""

    def __init__(self, port: int, queue: Queue, at: int = 0) -> None:
        self._port, self._queue = port, queue
        self._listener = socket.create_server(("127.0.0.1", at))
        self.number = self._listener.getsockname()[1]
        self._other: dict[socket.socket, socket.socket] = {}
        self._frames: dict[socket.socket, Frames] = {}

    def sockets(self) -> list[socket.socket]:
        """What it listens to."""
        return [self._listener, *self._other]

    def come(self, ready: socket.socket) -> None:
        """Take what has come."""
        if ready is self._listener:
            near, _ = self._listener.accept()
            far = socket.create_connection(("127.0.0.1", self._port))
            for end, other in ((near, far), (far, near)):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._other[end], self._frames[end] = other, Frames()
            return
        if ready not in self._other:
            return
        try:
            data = ready.recv(CHUNK)
        except OSError:
            data = b""
        if not data:
            self._close(ready)
            return
        send = _sender(self._other[ready])
        for frame in self._frames[ready].take(data):
            self._queue.put(frame, send)

    def _close(self, end: socket.socket) -> None:
        for each in (end, self._other[end]):
            self._other.pop(each, None)
            self._frames.pop(each, None)
            each.close()


class UdpRelay:
    """Datagrams to a port, and back to who sent last."""

    def __init__(self, port: int, queue: Queue, at: int = 0) -> None:
        self._queue = queue
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", at))
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.connect(("127.0.0.1", port))
        self.number = self._near.getsockname()[1]
        self._peer: tuple[str, int] | None = None

    def sockets(self) -> list[socket.socket]:
        """What it listens to."""
        return [self._near, self._far]

    def come(self, ready: socket.socket) -> None:
        """Take what has come."""
        with suppress(ConnectionError):
            if ready is self._near:
                data, self._peer = self._near.recvfrom(CHUNK)
                self._queue.put(data, _sender(self._far))
            elif self._peer is not None:
                self._queue.put(self._far.recv(CHUNK), self._back)

    def _back(self, data: bytes) -> None:
        if self._peer is not None:
            self._near.sendto(data, self._peer)


def _sender(end: socket.socket) -> Callable[[bytes], None]:
    def send(data: bytes) -> None:
        with suppress(OSError):  # that end has closed
            end.sendall(data)

    return send


def main(kind: str, port: str, seed: str, at: str = "0") -> None:
    """Pass on until the input ends."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    condition = Condition()
    queue = Queue(condition, random.Random(int(seed)))
    relay = (TcpRelay if kind == "tcp" else UdpRelay)(int(port), queue, int(at))
    print(f"relay at {relay.number}", flush=True)
    while True:
        ready = select.select([sys.stdin, *relay.sockets()], [], [], queue.pass_on())[0]
        for each in ready:
            if isinstance(each, socket.socket):
                relay.come(each)
                continue
            line = os.read(0, 4096).decode()
            if not line:
                return
            for word in line.splitlines():
                condition.change(word)


if __name__ == "__main__":
    main(*sys.argv[1:])
