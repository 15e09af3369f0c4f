"""Event files of the kernel, `/dev/input/event*`, whose devices may be plugged in and out."""

import os
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

EVENT = struct.Struct("llHHi")

#: Type, code and value.
Event = tuple[int, int, int]

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3

#: Interval of the search for devices.
LOOK_S = 1.0

#: Bytes per read, and reads at a time.
MOST_BYTES, MOST_READS = 64 * EVENT.size, 64


class EventFile:
    """An open event file; raises OSError if it cannot be opened."""

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self._rest = b""

    def events(self) -> Iterator[Event]:
        """Complete events since the last call; never waits. Raises OSError for a lost device."""
        for _ in range(MOST_READS):
            try:
                data = os.read(self.descriptor, MOST_BYTES)
            except BlockingIOError:
                return
            if not data:
                raise OSError("the device is gone")
            yield from self._events(self._rest + data)
            if len(data) < MOST_BYTES:
                return

    def close(self) -> None:
        """Close the file."""
        os.close(self.descriptor)

    def _events(self, data: bytes) -> Iterator[Event]:
        end = len(data) - len(data) % EVENT.size
        self._rest = data[end:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:end]):
            yield kind, code, value


class EventFiles:
    """Event files, searched once a second and closed when their devices are unplugged."""

    def __init__(
        self,
        find: Callable[[], list[Path]],
        *,
        most: int | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find, self._most = find, most
        self._now_s, self._look_at_s = now_s, -LOOK_S
        self.opened: dict[Path, EventFile] = {}

    def look(self) -> None:
        """Open new devices."""
        now_s = self._now_s()
        if now_s - self._look_at_s < LOOK_S or self._full:
            return
        self._look_at_s = now_s
        for path in self._find():
            if path in self.opened or self._full:
                continue
            try:
                self.opened[path] = EventFile(path)
            except OSError:
                continue

    def events(self) -> Iterator[Event]:
        """Events of all files since the last call; never waits."""
        for path, file in list(self.opened.items()):
            try:
                yield from file.events()
            except OSError:
                self.opened.pop(path).close()

    def close(self) -> None:
        """Close all files."""
        while self.opened:
            self.opened.popitem()[1].close()

    @property
    def _full(self) -> bool:
        return self._most is not None and len(self.opened) >= self._most
