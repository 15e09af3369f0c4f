"""Packets and registers against the vendors' documents and SDKs, and against garbage and late answers."""

import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.bus.families import lx16a as lx
from hexctl.backends.bus.families.dynamixel import AX, XL330, X
from hexctl.backends.bus.families.feetech import STS
from hexctl.backends.bus.families.register_bus import RegisterBus
from hexctl.backends.bus.families.registers import Register, Sign
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import (
    PROTOCOLS,
    READ,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    PacketStream,
    StatusPacket,
)
from hexctl.backends.bus.servo_bus import BusCounters
from tests.backends.bus.boards import MODELS_BY_NAME, AnsweringLine, LateServoLine

FORMATS = {"1": PROTOCOLS[1], "2": PROTOCOLS[2], "lx16a": lx.PACKETS}
every_format = pytest.mark.parametrize("kind", FORMATS)

#: Packets as the ROBOTIS e-Manual, the vendors' SDKs and LewanSoul's document print them.
DUMPS = [
    ("1", 0x01, 0x01, "", "FF FF 01 02 01 FB"),
    ("1", 0x01, 0x02, "2B 01", "FF FF 01 04 02 2B 01 CC"),
    ("1", 0xFE, 0x03, "03 01", "FF FF FE 04 03 03 01 F6"),
    ("1", 0x00, 0x06, "", "FF FF 00 02 06 F7"),
    ("1", 0xFE, 0x83, "1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03",
     "FF FF FE 18 83 1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03 12"),
    ("2", 0x01, 0x01, "", "FF FF FD 00 01 03 00 01 19 4E"),
    ("2", 0x01, 0x02, "84 00 04 00", "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    ("2", 0x01, 0x03, "74 00 00 02 00 00", "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    ("2", 0x01, 0x08, "", "FF FF FD 00 01 03 00 08 2F 4E"),
    ("2", 0xFE, 0x82, "84 00 04 00 01 02", "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
    ("2", 0xFE, 0x83, "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
     "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"),
    ("lx16a", 1, 1, "F4 01 E8 03", "55 55 01 07 01 F4 01 E8 03 16"),
    ("lx16a", 1, 1, "00 00 E8 03", "55 55 01 07 01 00 00 E8 03 0B"),
    ("lx16a", 254, 14, "", "55 55 FE 03 0E F0"),
    ("lx16a", 1, 28, "", "55 55 01 03 1C DF"),
    ("lx16a", 1, 31, "01", "55 55 01 04 1F 01 DA"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "servo_id", "instruction", "parameters", "dump"), DUMPS)
def test_packets_are_those_of_the_documents(
    kind: str, servo_id: int, instruction: int, parameters: str, dump: str
) -> None:
    packets, data = FORMATS[kind], bytes.fromhex(parameters)
    assert packets.instruction(servo_id, instruction, data) == bytes.fromhex(dump)
    assert packets.take(bytes.fromhex(dump)) == ((servo_id, instruction, data), len(bytes.fromhex(dump)))


class FakePort:
    """A port of a vendor's SDK that keeps what is written."""

    is_using = False

    def __init__(self) -> None:
        self.sent = b""

    def clearPort(self) -> None:  # noqa: N802  as the SDKs call it
        """Nothing has come."""

    def setPacketTimeout(self, size: int) -> None:  # noqa: N802
        """Nothing is waited for."""

    def writePort(self, packet: Any) -> int:  # noqa: N802
        self.sent = bytes(packet)
        return len(packet)


@pytest.mark.parametrize("protocol", [1, 2])
def test_the_dynamixel_sdk_writes_the_same_packets(protocol: int) -> None:
    import dynamixel_sdk

    sdk, port, rng = dynamixel_sdk.PacketHandler(float(protocol)), FakePort(), random.Random(0)
    for _ in range(300):
        servo_id, address, size = rng.randrange(253), rng.randrange(200), rng.choice((1, 2, 4))
        # Not FF FF FD, in which the SDK for Python forgets to stuff a byte.
        data = rng.choice((rng.randbytes(size), b"\xfe\xff\xfd\x00"[:size], b"\xff" * size))
        sdk.writeTxOnly(port, servo_id, address, size, list(data))
        place = address.to_bytes(protocol, "little")
        assert port.sent == PROTOCOLS[protocol].instruction(servo_id, WRITE, place + data)
        port.is_using = False
        sdk.readTx(port, servo_id, address, size)
        asked = place + size.to_bytes(protocol, "little")
        assert port.sent == PROTOCOLS[protocol].instruction(servo_id, READ, asked)
        port.is_using = False
    rows = bytes([1, 0xFF, 0xFF, 2, 0xFD, 0x00])
    sdk.syncWriteTxOnly(port, 30, 2, list(rows), len(rows))
    head = (30).to_bytes(protocol, "little") + (2).to_bytes(protocol, "little")
    assert port.sent == PROTOCOLS[protocol].instruction(0xFE, SYNC_WRITE, head + rows)


def test_the_feetech_sdk_writes_the_same_packets() -> None:
    import scservo_sdk

    port = FakePort()
    sdk = scservo_sdk.sms_sts(port)
    sdk.syncReadTx(56, 15, [1, 2, 18], 3)
    assert port.sent == PROTOCOLS[1].instruction(0xFE, SYNC_READ, bytes([56, 15, 1, 2, 18]))
    port.is_using = False
    sdk.writeTxOnly(5, 42, 2, [0x00, 0x08])
    assert port.sent == PROTOCOLS[1].instruction(5, WRITE, bytes([42, 0, 8]))


def test_a_byte_is_stuffed_behind_what_looks_like_a_header() -> None:
    sent = PROTOCOLS[2].instruction(1, WRITE, b"\x74\x00\xff\xff\xfd\x00")
    assert sent[5:-2] == b"\x0a\x00\x03\x74\x00\xff\xff\xfd\xfd\x00"
    assert PROTOCOLS[2].take(sent)[0] == (1, WRITE, b"\x74\x00\xff\xff\xfd\x00")


def test_moves_and_numbers_of_lx16a() -> None:
    assert lx.move_packet(lx.PACKETS, 1, 0, 40_000) == lx.move_packet(lx.PACKETS, 1, 0, 30_000)
    assert [lx.signed_number(data) for data in (b"\xf4\x01", b"\xfb\xff", b"\x80")] == [500, -5, 128]


def answers_of(kind: str) -> st.SearchStrategy[tuple[int, int, bytes]]:
    """Id, error or command, and parameters of an answer."""
    if kind == "lx16a":
        return st.tuples(st.integers(0, 253), st.integers(1, 36), st.binary(max_size=4))
    return st.tuples(st.integers(0, 252), st.integers(0, 127), st.binary(max_size=24))


@every_format
@given(data=st.data(), cuts=st.lists(st.integers(1, 9), min_size=1, max_size=40))
def test_answers_are_found_however_they_are_cut(kind: str, data: st.DataObject, cuts: list[int]) -> None:
    answers = data.draw(st.lists(answers_of(kind), min_size=1, max_size=6))
    sent = b"".join(FORMATS[kind].status(*each) for each in answers)
    stream, place = PacketStream(FORMATS[kind]), 0
    found: list[StatusPacket] = []
    for step in (cuts * len(sent))[: len(sent)]:
        found += stream.feed(sent[place : place + step])
        place += step
    assert [(each.servo_id, each.error, each.parameters) for each in found] == answers
    assert stream.garbled == 0


@pytest.mark.parametrize("protocol", [1, 2])
def test_damaged_answers_are_no_answers(protocol: int) -> None:
    """A byte that is wrong is noticed, but for one in 256 sums of protocol 1.0 that fits by chance."""
    rng, wrong = random.Random(2), 0
    for _ in range(10_000):
        good = PROTOCOLS[protocol].status(rng.randrange(253), 0, rng.randbytes(rng.randrange(16)))
        place, byte = rng.randrange(len(good)), rng.randrange(1, 256)
        bad = good[:place] + bytes([good[place] ^ byte]) + good[place + 1 :]
        stream = PacketStream(PROTOCOLS[protocol])
        wrong += bool(stream.feed(bad) + stream.finish())
    assert wrong < 10


def test_hostile_bytes_of_lx16a_are_dropped_and_counted() -> None:
    """Headers with any length behind them, and noise: nothing is kept, and few sums fit by chance."""
    rng, found, sent = random.Random(3), 0, 0
    stream = PacketStream(lx.PACKETS)
    for _ in range(10_000):
        data = rng.choice((b"\x55", b"\x55\x55", b"\x55\x55\x01", b"")) + rng.randbytes(rng.randrange(12))
        found += len(stream.feed(data))
        sent += len(data)
        if rng.random() < 0.1:
            found += len(stream.finish())
    assert found < 100
    assert sent - 10 * found <= stream.garbled <= sent


def test_an_echo_of_an_instruction_is_no_answer_of_protocol_2() -> None:
    stream = PacketStream(PROTOCOLS[2])
    asked = PROTOCOLS[2].instruction(3, READ, bytes([132, 0, 4, 0]))
    answer = PROTOCOLS[2].instruction(3, STATUS, b"\x00\x01\x02\x03\x04")
    assert stream.feed(asked + answer) == [StatusPacket(3, 0, b"\x01\x02\x03\x04")]


# Registers.


@pytest.mark.parametrize(
    ("register", "raw", "value"),
    [
        (Register(36, 2), 1023, 1023),
        (AX.effort, 1024 + 512, -512 / 1023),
        (STS.position, 0x8000 | 5, -5),
        (STS.position, 4095, 4095),
        (STS.current, 100, 0.65),
        (STS.voltage, 121, 12.1),
        (X.position, 0xFFFFFFFF, -1),
        (XL330.current, 0x10000 - 250, -0.25),
    ],
)
def test_raw_numbers_are_read_as_the_tables_say(register: Register, raw: int, value: float) -> None:
    assert register.value(raw) == pytest.approx(value)
    assert register.raw(value) == raw


@given(
    sign=st.sampled_from(["none", "twos", "bit10", "bit15"]),
    size=st.sampled_from([2, 4]),
    value=st.integers(-1000, 1000),
)
def test_numbers_come_back(sign: Sign, size: int, value: int) -> None:
    register = Register(0, size, sign)
    value = abs(value) if sign == "none" else value
    assert register.value(register.raw(value)) == value


# Questions and answers on a line whose answers come late.

#: How long the line waits, and answers that come later than that, and not much.
TIMEOUT_S, LATE_S = 0.15, 0.22

#: What registers hold: 3 is an operating mode, at 11.
MEMORY = {10: 0, 11: 3, 12: 9, 30: 100, 31: 2}


def _answer(instruction: int, parameters: bytes) -> tuple[int, bytes]:
    first, count = (parameters[0], parameters[1]) if instruction == READ else (0, 0)
    return 0, bytes(MEMORY[address] for address in range(first, first + count))


@pytest.fixture
def servo() -> LateServoLine:
    return LateServoLine(PROTOCOLS[1], _answer)


def _line(servo: LateServoLine) -> PacketLine:
    return PacketLine(servo, PROTOCOLS[1], timeout_s=TIMEOUT_S, adapts=False)


def _read(line: PacketLine, address: int, size: int = 1, *, tries: int = 2) -> bytes | None:
    answer = line.ask(7, READ, bytes([address, size]), tries=tries)
    return None if answer is None else answer.parameters


def test_a_late_answer_is_not_taken_for_the_one_to_another_question(servo: LateServoLine) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S, LATE_S]
    assert _read(line, 11) == b"\x03", "the answer to the first try, after the second"
    assert _read(line, 10) == b"\x00"
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 12) == b"\x09"
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    assert _read(line, 11) == b"\x03", "the same question takes the answer that comes first"


def test_answers_of_other_sizes_are_not_waited_for_and_not_taken(servo: LateServoLine) -> None:
    line = _line(servo)
    servo.delays_s = [LATE_S]
    assert _read(line, 11, tries=1) is None
    servo.pass_time(LATE_S - TIMEOUT_S)
    assert _read(line, 30, size=2, tries=1) in (b"\x64\x02", None), "never the one byte"
    assert _read(line, 30, size=2) == b"\x64\x02"


def test_the_answer_of_a_servo_that_was_not_asked_is_not_taken() -> None:
    packets = PROTOCOLS[1]
    came = [(0.0, packets.status(8, 0, b"\x09")), (LATE_S / 2, packets.status(7, 0, b"\x03"))]
    line = PacketLine(AnsweringLine(lambda _request: came), packets, timeout_s=LATE_S, adapts=False)
    answers = line.transact(packets.instruction(7, READ, bytes([11, 1])), (7,), 0.001)
    assert [(answer.servo_id, answer.parameters) for answer in answers] == [(7, b"\x03")]
    assert line.late == 1


@pytest.mark.parametrize("baud", [9_600, 57_600, 1_000_000])
def test_one_packet_reads_all_servos_however_slow_the_line(baud: int) -> None:
    """Their answers come one after the other, as fast as the line carries them."""
    ids, table = range(1, 19), MODELS_BY_NAME["sts3215"].table

    def answers(_request: bytes) -> list[tuple[float, bytes]]:
        packets = [PROTOCOLS[1].status(servo_id, 0, bytes(table.block[1])) for servo_id in ids]
        sizes = np.cumsum([len(_request), *map(len, packets)])[1:]
        return [(10 * size / baud, packet) for size, packet in zip(sizes.tolist(), packets, strict=True)]

    line = PacketLine(AnsweringLine(answers, baud), PROTOCOLS[1], timeout_s=0.004, adapts=False)
    bus = RegisterBus(line, dict.fromkeys(ids, MODELS_BY_NAME["sts3215"]), BusCounters())
    assert [report.index for report in bus.poll()] == list(range(18))


def test_missing_servos_are_not_waited_for_much_longer_than_the_others_take(servo: LateServoLine) -> None:
    line = PacketLine(servo, PROTOCOLS[1], timeout_s=TIMEOUT_S)
    request = PROTOCOLS[1].instruction(7, READ, bytes([11, 1]))
    for _ in range(60):
        assert len(line.transact(request, (7, 8), 0.001)) == 1
    assert line.timeout_s < TIMEOUT_S / 5
