"""Faults of a simulated bus."""

import random

import numpy as np
import pytest

from hexctl.backends.bus.lx16a_packets import LX16A
from hexctl.backends.bus.packets import PROTOCOLS, PacketFormat, PacketStream
from hexctl.errors import InputError
from hexctl.simulators.board_faults import BoardFault, DueFaults, parse_fault
from hexctl.simulators.bus_faults import BUS_FAULTS, BusFaults


def _fault(text: str) -> BoardFault:
    return parse_fault(text, BUS_FAULTS)


def _begun(*texts: str) -> BusFaults:
    faults = BusFaults()
    for text in texts:
        faults.begin(_fault(text))
    return faults


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("mute:5:coxa@10", BoardFault(kind="mute", at_s=10, joint=12)),
        ("hot:2:femur:72.5", BoardFault(kind="hot", joint=4, value=72.5)),
        ("lost-id:3:tibia@8", BoardFault(kind="lost-id", at_s=8, joint=8)),
        ("brown-out@12", BoardFault(kind="brown-out", at_s=12)),
        ("garble:0.01", BoardFault(kind="garble", value=0.01)),
        ("wild:0.02@3", BoardFault(kind="wild", at_s=3, value=0.02)),
        ("echo", BoardFault(kind="echo")),
    ],
)
def test_faults_are_read(text: str, fault: BoardFault) -> None:
    assert _fault(text) == fault


@pytest.mark.parametrize(
    "text",
    [
        "",
        "mute",
        "mute:7:coxa",
        "mute:1:knee",
        "hot:1:coxa",
        "hot:1:coxa:warm",
        "echo:1",
        "garble:2",
        "wild:1.5",
        "hot:1:coxa:1000",
        "echo@x",
    ],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"fault: got .*; allowed: mute:LEG:JOINT, "):
        _fault(text)


def test_faults_begin_when_they_are_due() -> None:
    words = ("unplug@2", "mute:1:femur@1", "replug@3", "hot:1:coxa:80@2")
    faults, due = BusFaults(), DueFaults(tuple(map(_fault, words)))

    def advance(now_s: float) -> None:
        for fault in due.begun(now_s):
            faults.begin(fault)

    advance(0.0)
    assert not faults.mute.any()
    advance(1.0)
    assert np.flatnonzero(faults.mute).tolist() == [1]
    advance(2.5)
    assert faults.unplugged
    assert faults.temperatures == {0: 80.0}
    advance(10.0)
    assert not faults.unplugged


def test_as_many_answers_are_garbled_as_was_asked_for() -> None:
    faults, rng = _begun("garble:0.25"), random.Random(0)
    packets = PROTOCOLS[1]
    answer = packets.status(7, 0, bytes(range(15)))
    garbled = sum(faults.damaged(answer, packets, rng) != answer for _ in range(4000))
    assert 0.22 < garbled / 4000 < 0.28


@pytest.mark.parametrize("packets", [PROTOCOLS[1], PROTOCOLS[2], LX16A], ids=["1.0", "2.0", "lx16a"])
def test_wild_answers_are_whole_packets_with_other_numbers(packets: PacketFormat) -> None:
    faults, rng = _begun("wild:0.25"), random.Random(0)
    answer = packets.status(7, 28, bytes(2))
    wild = [each for _ in range(400) if (each := faults.damaged(answer, packets, rng)) != answer]
    assert 70 < len(wild) < 130
    for each in wild:
        (packet,) = PacketStream(packets).feed(each)
        assert (packet.servo_id, packet.error, len(packet.parameters)) == (7, 28, 2)


def test_in_a_brown_out_nothing_holds() -> None:
    assert BusFaults().voltage(12.0) == 12.0
    faults = _begun("brown-out@1")
    assert faults.voltage(12.0) < 8
    assert faults.dead.all()
