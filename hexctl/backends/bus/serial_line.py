"""The serial line of a bus: one half-duplex adapter, used by one thread."""

import contextlib
import errno
import os
import termios
from pathlib import Path
from typing import Any

from hexctl.backends.board_lock import in_use, program_of
from hexctl.errors import RobotFaultError
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.waiting import wait_ready

#: Bytes per read: more than a bus delivers between two reads.
CHUNK = 4096

#: How long the bytes of an answer may follow its first ones.
ANSWERED_S = 0.004

#: Number of attempts to detect an echo, because one may be damaged.
ECHO_TRIES = 2

#: An id that servos cannot have, in any protocol.
UNUSED_ID = 253


class SerialLine:
    """An open serial device, without the echo of its adapter.

    Attributes:
        echoes: whether the adapter returns written bytes, as some half-duplex adapters do.
        free_s: when the wire has carried everything written.

    Raises RobotFaultError when the device cannot be opened.
    """

    def __init__(
        self, path: str, baud: int, *, modem_lines: bool = True, time: TimeSource = WALL_TIME
    ) -> None:
        self.path, self.baud, self.echoes, self.free_s = path, baud, False, 0.0
        self.time = time
        self._device = open_device(path, baud, modem_lines=modem_lines)
        # FTDI adapters wait 16 ms for more bytes; other drivers and pseudo-terminals have no such setting.
        with contextlib.suppress(ValueError, NotImplementedError, OSError):
            self._device.set_low_latency_mode(True)
        self._descriptor: int = self._device.fileno()
        self._echo = b""  # of what was sent and has not come back
        self._last = b""  # packet, by whose echo the line is found again once an echo was damaged
        self._damaged: bytes | None = None  # what has come since, or None
        self.discard()

    def write(self, packet: bytes, *, timeout_s: float = 0.02) -> None:
        """Send a complete packet; raises OSError when the device is lost or blocked."""
        if self.echoes:
            self._last = packet
            if self._damaged is None:
                self._echo += packet
            else:
                self._damaged = b""
        now_s = self.time.now()
        self.free_s = max(self.free_s, now_s) + self.wire_s(len(packet))
        self._put(packet, now_s + timeout_s)

    def _put(self, data: bytes, deadline_s: float) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                left_s = deadline_s - self.time.now()
                if left_s <= 0:
                    raise TimeoutError(f"{self.path} takes no bytes") from None
                wait_ready(self._descriptor, left_s, to_write=True)

    def read(self, deadline_s: float) -> bytes:
        """Return received bytes, or wait for the first until a time; empty if none come.

        Raises OSError when the device is lost.
        """
        return self._without_echo(self._take(max(0.0, deadline_s - self.time.now())))

    def _take(self, wait_s: float) -> bytes:
        if not wait_ready(self._descriptor, wait_s):
            return b""
        data = os.read(self._descriptor, CHUNK)
        if not data:
            raise OSError("the other end of the port is closed")
        return data

    def discard(self) -> bool:
        """Drop received bytes; whether there were any except echoes."""
        came = False
        while data := self._take(0.0):
            came = bool(self._without_echo(data)) or came
        return came

    def learn_echo(self, ping: bytes, timeout_s: float) -> None:
        """Send a packet that no servo answers, and check whether it returns.

        The answer of a servo may equal its ping, with an error in place of the instruction.
        """
        self.echoes = False
        for _ in range(ECHO_TRIES):
            self.discard()
            self.write(ping)
            deadline_s, seen = self.time.now() + self.wire_s(2 * len(ping)) + timeout_s, b""
            while self.time.now() < deadline_s and len(seen) < len(ping):
                seen += self.read(deadline_s)
            self.time.sleep(ANSWERED_S)
            self.discard()
            if seen.startswith(ping):
                self.echoes = True
                return

    def close(self) -> None:
        """Close the device."""
        self._device.close()

    def wire_s(self, count: int) -> float:
        """Time of bytes on the wire: ten bits each."""
        return 10.0 * count / self.baud

    def _without_echo(self, data: bytes) -> bytes:
        """Bytes without the echo; after a damaged echo only those behind the last packet's echo."""
        if self._damaged is not None:
            self._damaged += data
            _, found, behind = self._damaged.partition(self._last)
            self._damaged = None if found else self._damaged
            return behind
        count = 0
        while count < len(data) and count < len(self._echo) and data[count] == self._echo[count]:
            count += 1
        if count < len(data) and count < len(self._echo):
            self._echo, self._damaged = b"", b""
            return self._without_echo(data)
        self._echo = self._echo[count:]
        return data[count:]


def open_device(path: str, baud: int, *, modem_lines: bool = True) -> Any:
    """Open a serial device exclusively, as pyserial's `Serial`; raises RobotFaultError with advice.

    With `modem_lines` off, DTR and RTS stay low.
    """
    import serial

    try:
        device = serial.Serial(None, baud, timeout=0, write_timeout=0, exclusive=True)
        device.dtr = device.rts = modem_lines
        device.port = path
        device.open()
        return device
    except (OSError, ValueError, OverflowError, termios.error) as error:
        number = getattr(error, "errno", None)
        if number == errno.ENOENT:
            raise RobotFaultError(
                f"there is no port {path}; is the cable plugged in? `hexctl ports` lists the available ports"
            ) from error
        reason = os.strerror(number) if number else str(error)  # pyserial's own has the name once more
        if number == errno.EAGAIN:  # locked: another program has it exclusively
            raise in_use(f"the port {path}", program_using(path)) from error
        raise RobotFaultError(
            f"the port {path} cannot be opened ({reason}); is the cable in, the name right, and no other "
            "program using it?"
        ) from error


def program_using(path: str) -> str | None:
    """Program using a device, with its process id, if visible to this user; else None.

    A program that made a pseudo-terminal has both of its ends and does not use it.
    """
    device = os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            opened = {os.path.realpath(link) for link in (process / "fd").iterdir()}
            if device in opened and not any(name.endswith("/ptmx") for name in opened):
                return program_of(int(process.name))
    return None
