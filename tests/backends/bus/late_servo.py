"""A servo whose answers come late, on a line without a wire."""

import os
import threading
import tty
from collections.abc import Callable
from contextlib import suppress

from hexctl.backends.bus.packets import PacketFormat


class LateServo:
    """A servo that answers single questions, each after a delay that a test sets, in order; else at once.

    Args:
        packets: format of its packets.
        answer: error and parameters of the answer to an instruction and its parameters.
    """

    def __init__(self, packets: PacketFormat, answer: Callable[[int, bytes], tuple[int, bytes]]) -> None:
        self._packets, self._answered = packets, answer
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        self.delays_s: list[float] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        data = b""
        while True:
            try:
                data += os.read(self._master, 100)
            except OSError:
                return
            while True:
                packet, done = self._packets.take(data)
                data = data[done:]
                if packet is None:
                    break
                delay_s = self.delays_s.pop(0) if self.delays_s else 0.0
                threading.Timer(delay_s, self._answer, packet).start()

    def _answer(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        with suppress(OSError):
            os.write(self._master, self._packets.status(servo_id, *self._answered(instruction, parameters)))

    def close(self) -> None:
        """End the line."""
        os.close(self._master)
