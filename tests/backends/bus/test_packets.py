"""Packets against the vendors' documents and SDKs, and against garbage."""

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.bus.packets import (
    PROTOCOLS,
    READ,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    PacketStream,
    StatusPacket,
    crc16,
)

#: Packets as the ROBOTIS e-Manual and the vendors' SDKs print them: protocol, id, instruction, parameters.
DUMPS = [
    (1, 0x01, 0x01, "", "FF FF 01 02 01 FB"),
    (1, 0x01, 0x02, "2B 01", "FF FF 01 04 02 2B 01 CC"),
    (1, 0xFE, 0x03, "03 01", "FF FF FE 04 03 03 01 F6"),
    (1, 0x00, 0x06, "", "FF FF 00 02 06 F7"),
    (
        1,
        0xFE,
        0x83,
        "1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03",
        "FF FF FE 18 83 1E 04 00 10 00 50 01 01 20 02 60 03 02 30 00 70 01 03 20 02 80 03 12",
    ),
    (2, 0x01, 0x01, "", "FF FF FD 00 01 03 00 01 19 4E"),
    (2, 0x01, 0x02, "84 00 04 00", "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (2, 0x01, 0x03, "74 00 00 02 00 00", "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    (2, 0x01, 0x08, "", "FF FF FD 00 01 03 00 08 2F 4E"),
    (
        2,
        0xFE,
        0x82,
        "84 00 04 00 01 02",
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    (
        2,
        0xFE,
        0x83,
        "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
]


@pytest.mark.parametrize(("protocol", "servo_id", "instruction", "parameters", "dump"), DUMPS)
def test_packets_are_those_of_the_documents(
    protocol: int, servo_id: int, instruction: int, parameters: str, dump: str
) -> None:
    packets, data = PROTOCOLS[protocol], bytes.fromhex(parameters)
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


def test_a_byte_is_stuffed_behind_what_looks_like_a_header() -> None:
    sent = PROTOCOLS[2].instruction(1, WRITE, b"\x74\x00\xff\xff\xfd\x00")
    assert sent[5:-2] == b"\x0a\x00\x03\x74\x00\xff\xff\xfd\xfd\x00"
    assert PROTOCOLS[2].take(sent)[0] == (1, WRITE, b"\x74\x00\xff\xff\xfd\x00")


def test_the_feetech_sdk_writes_the_same_packets() -> None:
    import scservo_sdk

    port = FakePort()
    sdk = scservo_sdk.sms_sts(port)
    sdk.syncReadTx(56, 15, [1, 2, 18], 3)
    assert port.sent == PROTOCOLS[1].instruction(0xFE, SYNC_READ, bytes([56, 15, 1, 2, 18]))
    port.is_using = False
    sdk.writeTxOnly(5, 42, 2, [0x00, 0x08])
    assert port.sent == PROTOCOLS[1].instruction(5, WRITE, bytes([42, 0, 8]))


def test_the_crc_is_that_of_the_dynamixel_sdk() -> None:
    import dynamixel_sdk

    sdk, rng = dynamixel_sdk.PacketHandler(2.0), random.Random(1)
    for size in range(1, 200):
        data = rng.randbytes(size)
        assert crc16(data) == sdk.updateCRC(0, list(data), size)


@pytest.mark.parametrize("protocol", [1, 2])
@given(
    answers=st.lists(
        st.tuples(st.integers(0, 252), st.integers(0, 127), st.binary(max_size=24)), min_size=1, max_size=6
    ),
    cuts=st.lists(st.integers(1, 9), min_size=1, max_size=40),
)
def test_answers_are_found_however_they_are_cut(
    protocol: int, answers: list[tuple[int, int, bytes]], cuts: list[int]
) -> None:
    packets = PROTOCOLS[protocol]
    data, stream = b"".join(packets.status(*each) for each in answers), PacketStream(packets)
    found: list[StatusPacket] = []
    place = 0
    for step in (cuts * len(data))[: len(data)]:
        found += stream.feed(data[place : place + step])
        place += step
    assert [(each.servo_id, each.error, each.parameters) for each in found] == answers
    assert stream.garbled == 0


@pytest.mark.parametrize("protocol", [1, 2])
@given(garbage=st.binary(max_size=60), parameters=st.binary(min_size=2, max_size=20))
def test_an_answer_behind_garbage_is_found(protocol: int, garbage: bytes, parameters: bytes) -> None:
    packets, stream = PROTOCOLS[protocol], PacketStream(PROTOCOLS[protocol])
    found = stream.feed(garbage + packets.status(7, 0, parameters))
    found += stream.finish()
    assert StatusPacket(7, 0, parameters) in found or len(found) > 0


@pytest.mark.parametrize("protocol", [1, 2])
def test_damaged_answers_are_no_answers(protocol: int) -> None:
    """A byte that is wrong is noticed, but for one in 256 sums of protocol 1.0 that fits by chance."""
    rng, wrong = random.Random(2), 0
    for _ in range(20_000):
        good = PROTOCOLS[protocol].status(rng.randrange(253), 0, rng.randbytes(rng.randrange(16)))
        place, byte = rng.randrange(len(good)), rng.randrange(1, 256)
        bad = good[:place] + bytes([good[place] ^ byte]) + good[place + 1 :]
        stream = PacketStream(PROTOCOLS[protocol])
        wrong += bool(stream.feed(bad) + stream.finish())
    assert wrong < 20


def test_an_echo_of_an_instruction_is_no_answer_of_protocol_2() -> None:
    stream = PacketStream(PROTOCOLS[2])
    asked = PROTOCOLS[2].instruction(3, READ, bytes([132, 0, 4, 0]))
    answer = PROTOCOLS[2].instruction(3, STATUS, b"\x00\x01\x02\x03\x04")
    assert stream.feed(asked + answer) == [StatusPacket(3, 0, b"\x01\x02\x03\x04")]
