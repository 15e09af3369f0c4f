"""Questions and answers on a line whose answers come late."""

import pytest

from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import PING, PROTOCOLS, READ, WRITE
from tests.backends.bus.memory_line import LateServoLine

PACKETS = PROTOCOLS[1]

#: How long the line waits, and answers that come later than that, and not much.
TIMEOUT_S, LATE_S = 0.15, 0.22

#: What registers hold: 3 is an operating mode, at 11.
MEMORY = {10: 0, 11: 3, 12: 9, 30: 100, 31: 2}


def _answer(instruction: int, parameters: bytes) -> tuple[int, bytes]:
    first, count = (parameters[0], parameters[1]) if instruction == READ else (0, 0)
    return 0, bytes(MEMORY[address] for address in range(first, first + count))


@pytest.fixture
def servo() -> LateServoLine:
    return LateServoLine(PACKETS, _answer)


def _line(servo: LateServoLine) -> PacketLine:
    return PacketLine(servo, PACKETS, timeout_s=TIMEOUT_S, adapts=False)


def _read(line: PacketLine, address: int, size: int = 1, *, tries: int = 2) -> bytes | None:
    answer = line.ask(7, READ, bytes([address, size]), tries=tries)
    return None if answer is None else answer.parameters


def test_a_late_answer_is_not_taken_for_the_one_to_another_question(servo: LateServoLine) -> None:
    """An operating mode of 3 that came late was read as the drive mode, and the robot was refused."""
    line = _line(servo)
    servo.delays_s = [LATE_S, LATE_S]
    assert _read(line, 11) == b"\x03", "the answer to the first try, after the second"
    assert _read(line, 10) == b"\x00"
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 12) == b"\x09"


def test_answers_of_other_sizes_are_not_waited_for_and_not_taken(servo: LateServoLine) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    servo.pass_time(LATE_S - TIMEOUT_S)
    assert _read(line, 30, size=2, tries=1) in (b"\x64\x02", None), "never the one byte"
    assert _read(line, 30, size=2) == b"\x64\x02"


def test_the_same_question_takes_the_answer_that_comes_first(servo: LateServoLine) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 11) == b"\x03"


def test_servos_that_begin_to_answer_late_are_heard_again(servo: LateServoLine) -> None:
    """The line had learned to wait for a few ms only, and dropped what came later for good."""
    line = PacketLine(servo, PACKETS, timeout_s=TIMEOUT_S)
    for _ in range(80):
        assert _read(line, 11) == b"\x03"
    servo.delays_s = [0.04] * 12
    heard = []
    for _ in range(12):
        heard.append(_read(line, 11, tries=1))
        servo.pass_time(0.08)  # what comes late comes between two questions
    assert b"\x03" in heard[:8]


def test_servos_that_are_missing_are_not_waited_for_much_longer_than_the_others_take(
    servo: LateServoLine,
) -> None:
    """Where any was missing the line waited for 34 ms in each round, for good."""
    line = PacketLine(servo, PACKETS, timeout_s=TIMEOUT_S)
    request = PACKETS.instruction(7, READ, bytes([11, 1]))
    for _ in range(60):
        assert len(line.transact(request, (7, 8), 0.001)) == 1
    assert line.timeout_s < TIMEOUT_S / 5


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
