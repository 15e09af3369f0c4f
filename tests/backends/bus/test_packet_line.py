"""Questions and answers on a line whose answers come late."""

import os
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import suppress

import pytest

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PING, PROTOCOLS, READ, WRITE
from hexctl.backends.bus.serial_line import SerialLine

PACKETS = PROTOCOLS[1]

#: How long the line waits, and answers that come later than that, and not much.
PATIENCE_S, LATE_S = 0.15, 0.22

#: What registers hold: 3 is an operating mode, at 11.
MEMORY = {10: 0, 11: 3, 12: 9, 30: 100, 31: 2}


class LateServo:
    """A servo that answers to single questions after a delay that a test sets."""

    def __init__(self) -> None:
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
                packet, done = PACKETS.take(data)
                data = data[done:]
                if packet is None:
                    break
                delay_s = self.delays_s.pop(0) if self.delays_s else 0.0
                threading.Timer(delay_s, self._answer, packet).start()

    def _answer(self, servo_id: int, instruction: int, parameters: bytes) -> None:
        first, count = (parameters[0], parameters[1]) if instruction == READ else (0, 0)
        data = bytes(MEMORY[address] for address in range(first, first + count))
        with suppress(OSError):
            os.write(self._master, PACKETS.status(servo_id, 0, data))

    def close(self) -> None:
        os.close(self._master)


@pytest.fixture
def servo() -> Iterator[LateServo]:
    servo = LateServo()
    yield servo
    servo.close()


def _line(servo: LateServo) -> PacketLine:
    return PacketLine(SerialLine(servo.path, 1_000_000), PACKETS, patience_s=PATIENCE_S, adapts=False)


def _read(line: PacketLine, address: int, size: int = 1, *, tries: int = 2) -> bytes | None:
    answer = line.ask(7, READ, bytes([address, size]), tries=tries)
    return None if answer is None else answer.parameters


def test_a_late_answer_is_not_taken_for_the_one_to_another_question(servo: LateServo) -> None:
    """An operating mode of 3 that came late was read as the drive mode, and the robot was refused."""
    line = _line(servo)
    servo.delays_s = [LATE_S, LATE_S]
    assert _read(line, 11) == b"\x03", "the answer to the first try, after the second"
    assert _read(line, 10) == b"\x00"
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 12) == b"\x09"


def test_answers_of_other_sizes_are_not_waited_for_and_not_taken(servo: LateServo) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    time.sleep(LATE_S - PATIENCE_S)
    assert _read(line, 30, size=2, tries=1) in (b"\x64\x02", None), "never the one byte"
    assert _read(line, 30, size=2) == b"\x64\x02"


def test_the_same_question_takes_the_answer_that_comes_first(servo: LateServo) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 11) == b"\x03"


def test_servos_that_begin_to_answer_late_are_heard_again(servo: LateServo) -> None:
    """The line had learned to wait for a few ms only, and dropped what came later for good."""
    line = PacketLine(SerialLine(servo.path, 1_000_000), PACKETS, patience_s=PATIENCE_S)
    for _ in range(80):
        assert _read(line, 11) == b"\x03"
    servo.delays_s = [0.04] * 12
    heard = []
    for _ in range(12):
        heard.append(_read(line, 11, tries=1))
        time.sleep(0.08)  # what comes late comes between two questions
    assert b"\x03" in heard[:8]


@pytest.mark.parametrize(
    ("protocol", "instruction", "parameters", "size"),
    [
        (1, PING, b"", 0),
        (2, PING, b"", 3),
        (1, READ, b"\x24\x08", 8),
        (2, READ, b"\x84\x00\x04\x01", 260),
        (1, WRITE, b"\x1e\x00\x02", 0),
        (2, 0x92, b"", None),
    ],
)
def test_the_size_of_an_answer(protocol: int, instruction: int, parameters: bytes, size: int | None) -> None:
    assert PROTOCOLS[protocol].answer_size(instruction, parameters) == size
