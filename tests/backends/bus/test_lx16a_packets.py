"""Packets of LX-16A servos against LewanSoul's document, and against garbage."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.bus import lx16a_packets as lx
from hexctl.backends.bus.packets import PacketStream, StatusPacket

#: The first packet is LewanSoul's own example, the others were made by its rules: id, command, parameters.
DUMPS = [
    (1, 1, "F4 01 E8 03", "55 55 01 07 01 F4 01 E8 03 16"),
    (1, 1, "00 00 E8 03", "55 55 01 07 01 00 00 E8 03 0B"),
    (254, 14, "", "55 55 FE 03 0E F0"),
    (1, 28, "", "55 55 01 03 1C DF"),
    (1, 31, "01", "55 55 01 04 1F 01 DA"),
]


@pytest.mark.parametrize(("servo_id", "command", "parameters", "dump"), DUMPS)
def test_packets_are_as_the_document_says(servo_id: int, command: int, parameters: str, dump: str) -> None:
    data = bytes.fromhex(parameters)
    assert lx.LX16A.instruction(servo_id, command, data) == bytes.fromhex(dump)
    assert lx.LX16A.take(bytes.fromhex(dump)) == ((servo_id, command, data), len(bytes.fromhex(dump)))


def test_moves_loads_and_numbers() -> None:
    assert lx.move(1, 500, 1000) == bytes.fromhex("55 55 01 07 01 F4 01 E8 03 16")
    assert lx.move(1, 0, 40_000) == lx.move(1, 0, 30_000)
    assert lx.load(1, on=True) == bytes.fromhex("55 55 01 04 1F 01 DA")
    assert lx.number(b"\xf4\x01") == 500
    assert lx.number(b"\xfb\xff") == -5
    assert lx.number(b"\x80") == 128  # degrees Celsius have no sign


answers = st.tuples(st.integers(0, 253), st.integers(1, 36), st.binary(max_size=4))


@given(
    sent=st.lists(answers, min_size=1, max_size=8),
    cuts=st.lists(st.integers(1, 9), min_size=1, max_size=40),
)
def test_answers_are_found_however_they_are_cut(sent: list[tuple[int, int, bytes]], cuts: list[int]) -> None:
    data, stream = b"".join(lx.LX16A.status(*each) for each in sent), PacketStream(lx.LX16A)
    found: list[StatusPacket] = []
    place = 0
    for step in (cuts * len(data))[: len(data)]:
        found += stream.feed(data[place : place + step])
        place += step
    assert [(each.servo_id, each.error, each.parameters) for each in found] == sent
    assert stream.garbled == 0


@given(garbage=st.binary(max_size=60), answer=answers)
def test_an_answer_behind_garbage_is_found(garbage: bytes, answer: tuple[int, int, bytes]) -> None:
    stream = PacketStream(lx.LX16A)
    found = stream.feed(garbage + lx.LX16A.status(*answer)) + stream.finish()
    assert StatusPacket(*answer) in found or len(found) > 0


def test_hostile_bytes_are_dropped_and_counted() -> None:
    """Headers with any length behind them, and noise: nothing is kept, and few sums fit by chance."""
    rng, found, sent = random.Random(3), 0, 0
    stream = PacketStream(lx.LX16A)
    for _ in range(20_000):
        data = rng.choice((b"\x55", b"\x55\x55", b"\x55\x55\x01", b"")) + rng.randbytes(rng.randrange(12))
        found += len(stream.feed(data))
        sent += len(data)
        if rng.random() < 0.1:
            found += len(stream.finish())
    assert found < 200
    assert sent - 10 * found <= stream.garbled <= sent
