"""A servo whose answers come late, on a line without a wire."""

import os
import select
import threading
import tty
from collections.abc import Callable

from hexctl.backends.bus.packets import PacketFormat


class LateServo:
    """A servo that answers single questions, each after a delay that a test sets, in order; else at once.

    Args:
        packets: format of its packets.
        answer: error and parameters of the answer to an instruction and its parameters.

    Attributes:
        path: of the line.
        delays_s: of the next answers.
    """

    def __init__(self, packets: PacketFormat, answer: Callable[[int, bytes], tuple[int, bytes]]) -> None:
        self._packets, self._answered = packets, answer
        self._master, self._slave = os.openpty()
        self._ended, self._end = os.pipe()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self.delays_s: list[float] = []
        self._timers: list[threading.Timer] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        data = b""
        while self._ended not in select.select([self._master, self._ended], [], [])[0]:
            data += os.read(self._master, 100)
            while True:
                packet, done = self._packets.take(data)
                data = data[done:]
                if packet is None:
                    break
                delay_s = self.delays_s.pop(0) if self.delays_s else 0.0
                self._timers.append(threading.Timer(delay_s, self._answer, packet))
                self._timers[-1].start()

    def _answer(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        os.write(self._master, self._packets.status(servo_id, *self._answered(instruction, parameters)))

    def close(self) -> None:
        """End the line, once no thread uses it any more; answers that have not come never come."""
        os.close(self._end)
        self._thread.join()
        for timer in self._timers:
            timer.cancel()
            timer.join()
        for descriptor in (self._master, self._slave, self._ended):
            os.close(descriptor)
