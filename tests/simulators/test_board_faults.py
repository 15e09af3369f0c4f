"""Faults of simulated boards and buses by their words, and boards as library calls."""

import random
from typing import Any

import pytest

from hexctl.backends.bus.families.lx16a import PACKETS
from hexctl.backends.bus.packets import PROTOCOLS, PacketFormat, PacketStream
from hexctl.errors import InputError
from hexctl.robot.servos.drivers import BOARDS, FAMILIES
from hexctl.server.service import ServiceStarted
from hexctl.simulators.board_faults import BUS_FAULTS, BoardFault, BusFaults, parse_fault
from hexctl.simulators.board_service import BoardService
from hexctl.simulators.servo2040_board import SERVO2040_FAULTS

KINDS = {"mute": "", "trip": "AMPERES", "garble": "SHARE", "nack": "[:SHARE]"}


@pytest.mark.parametrize(
    ("text", "kinds", "fault"),
    [
        ("mute", KINDS, BoardFault(kind="mute")),
        ("mute@1.5", KINDS, BoardFault(kind="mute", at_s=1.5)),
        ("trip:12@3", KINDS, BoardFault(kind="trip", at_s=3, value=12)),
        ("nack", KINDS, BoardFault(kind="nack")),
        ("nack:0.5", KINDS, BoardFault(kind="nack", value=0.5)),
        ("mute:5:coxa@10", BUS_FAULTS, BoardFault(kind="mute", at_s=10, joint=12)),
        ("hot:2:femur:72.5", BUS_FAULTS, BoardFault(kind="hot", joint=4, value=72.5)),
        ("brown-out@12", BUS_FAULTS, BoardFault(kind="brown-out", at_s=12)),
        ("wild:0.02@3", BUS_FAULTS, BoardFault(kind="wild", at_s=3, value=0.02)),
    ],
)
def test_a_fault_has_a_word_a_joint_a_number_and_a_time(
    text: str, kinds: dict[str, str], fault: BoardFault
) -> None:
    assert parse_fault(text, kinds) == fault


WRONG = {
    "board": (KINDS, "| echo | mute:3 | trip | trip:x | garble | garble:1.1 | nack:2 | mute@x | mute@-1"),
    "bus": (
        BUS_FAULTS,
        "| mute | mute:7:coxa | mute:1:knee | hot:1:coxa | hot:1:coxa:warm | hot:1:coxa:1000 | echo:1 | "
        "garble:2 | wild:1.5 | echo@x",
    ),
    "servo2040": (SERVO2040_FAULTS, "echo | mute:3 | garble | garble:2 | trip"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_fault_that_is_none_is_refused(name: str) -> None:
    kinds, texts = WRONG[name]
    for text in texts.split("|"):
        with pytest.raises(InputError, match=f"fault: got .*{next(iter(kinds))}"):
            parse_fault(text.strip(), kinds)


def _begun(*texts: str) -> BusFaults:
    faults = BusFaults()
    for text in texts:
        faults.begin(parse_fault(text, BUS_FAULTS))
    return faults


@pytest.mark.parametrize("packets", [PROTOCOLS[1], PROTOCOLS[2], PACKETS], ids=["1.0", "2.0", "lx16a"])
def test_as_many_answers_are_garbled_or_wild_as_was_asked_for(packets: PacketFormat) -> None:
    answer = packets.status(7, 28, bytes(2))
    for fault in ("garble:0.25", "wild:0.25"):
        faults, rng = _begun(fault), random.Random(0)
        spoiled = [each for _ in range(2000) if (each := faults.damaged(answer, packets, rng)) != answer]
        assert 0.22 < len(spoiled) / 2000 < 0.28
    for each in spoiled:  # wild: whole packets with other numbers
        (packet,) = PacketStream(packets).feed(each)
        assert (packet.servo_id, packet.error, len(packet.parameters)) == (7, 28, 2)


@pytest.mark.parametrize("driver", [None, *FAMILIES, *BOARDS])
def test_every_driver_has_a_simulated_bus_or_board_that_reports_its_counts(driver: Any) -> None:
    started: list[ServiceStarted] = []
    options: dict[str, Any] = {"pty": True} if driver is None else {"bus": driver}
    robot = "phantomx" if driver in FAMILIES else "ant"
    report = BoardService(backend="mock", robot=robot, **options).run(
        lambda: bool(started), on_started=started.append
    )
    assert "/" in started[0].place
    assert report["overrides" if driver is None else "goals"] == 0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"backend": "mavlink"}, "backend"),
        ({"expiry_s": 2.0}, "got 2; allowed: 0.05 to 1 s"),
        ({"port": "udpin:127.0.0.1:1", "pty": True}, "pty"),
        ({"bus": "feetech", "backend": "zenoh"}, "backend"),
        ({"bus": "pca9685", "backend": "mock", "model": "sts3215"}, "model: got sts3215"),
        ({"bus": "servo2040", "backend": "mock", "model": "chica"}, "model: got chica"),
        ({"bus": "servo2040", "baud": 9600}, "baud: got 9600 with servo2040"),
        ({"bus": "feetech", "robot": "phantomx", "backend": "mock", "fault": ("nack",)}, "fault: got 'nack'"),
    ],
)
def test_a_board_that_cannot_be_is_refused(options: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        BoardService(**options).run(lambda: True)
