"""Port addresses and sequence numbers."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.mavlink_transport import (
    FORGET_AFTER_S,
    MOST_ADDRESSES,
    MavlinkLink,
    Port,
    PortAddress,
    SequenceCount,
    UdpPort,
    parse_port,
)
from hexctl.errors import InputError
from tests.many_files import many_open_files


@pytest.mark.parametrize(
    ("text", "kind", "place", "number", "local"),
    [
        ("udpout:127.0.0.1:14550", "udpout", "127.0.0.1", 14550, True),
        ("udpin:192.168.1.2:14550", "udpin", "192.168.1.2", 14550, False),
        ("udpin:localhost:1", "udpin", "localhost", 1, True),
        ("udpout:robot.local:65535", "udpout", "robot.local", 65535, False),
        ("udpout:[::1]:14550", "udpout", "::1", 14550, True),
        ("/dev/ttyACM0", "serial", "/dev/ttyACM0", 115200, True),
        ("/dev/ttyACM0:57600", "serial", "/dev/ttyACM0", 57600, True),
        ("serial:/dev/pts/3", "serial", "/dev/pts/3", 115200, True),
    ],
)
def test_ports(text: str, kind: str, place: str, number: int, local: bool) -> None:
    address = parse_port(text)
    assert (address.kind, address.place, address.number, address.local) == (kind, place, number, local)
    assert isinstance(address, PortAddress)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udp",
        "udpin:14550",
        "udpin:host:0",
        "udpin:host:70000",
        "tcp:1.2.3.4:5",
        "ttyACM0",
        "COM3",
        "/dev/ttyACM0:fast",
        "/dev/ttyACM0:1",
        "/dev/tty\nX",
        "udpout:a b:1",
        "udpout:127.0.0.1:14550x",
    ],
)
def test_what_is_no_port_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"connect: got .*; allowed: ") as refused:
        parse_port(text)
    assert "\n" not in str(refused.value)


def follow(numbers: list[int], count: SequenceCount | None = None) -> tuple[SequenceCount, list[bool]]:
    count = count or SequenceCount()
    return count, [count.in_order(number % 256, 0.001 * index) for index, number in enumerate(numbers)]


def test_a_gap_is_a_loss() -> None:
    count, accepted = follow([3, 4, 8, 9])
    assert (count.lost, count.out_of_order, accepted) == (3, 0, [True] * 4)


def test_a_frame_that_comes_late_is_not_used_and_was_not_lost() -> None:
    count, accepted = follow([1, 2, 4, 3, 5])
    assert (count.lost, count.out_of_order) == (0, 1)
    assert accepted == [True, True, True, False, True]


def test_a_frame_that_comes_twice_is_used_once() -> None:
    count, accepted = follow([1, 2, 2, 3])
    assert (count.lost, count.out_of_order, accepted) == (0, 1, [True, True, False, True])


def test_a_sender_that_restarts_after_a_silence_is_received_immediately() -> None:
    count, _ = follow([200, 201])
    assert count.in_order(0, 1 + FORGET_AFTER_S)
    assert count.lost == 0


@given(st.lists(st.booleans(), min_size=1, max_size=600))
def test_what_is_dropped_on_the_way_is_counted(arrives: list[bool]) -> None:
    """Every loss before the last arrival, as long as fewer than 127 are lost in a row."""
    kept = [index for index, there in enumerate(arrives) if there or index % 100 == 0]
    count, accepted = follow(kept)
    assert all(accepted)
    assert count.lost == kept[-1] + 1 - len(kept)


class SilentPort(Port):
    """Keeps what is sent, with the address."""

    datagrams = True

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, object]] = []

    def receive(self, timeout_s: float) -> list[tuple[bytes, object]]:
        return []

    def send(self, frame: bytes, to: object) -> None:
        self.sent.append((frame[4], to))

    def close(self) -> None:
        pass


def test_a_flood_of_addresses_does_not_renumber_an_active_peer() -> None:
    port = SilentPort()
    link = MavlinkLink(port, Codec(1, 1))
    heartbeat = mavlink_messages.controller_heartbeat()
    for flooder in range(3 * MOST_ADDRESSES):
        link.send(heartbeat, "controller")
        link.send(heartbeat, flooder)
    numbers = [number for number, to in port.sent if to == "controller"]
    assert numbers == [number % 256 for number in range(3 * MOST_ADDRESSES)]
    port.sent.clear()
    link.send(heartbeat, 0)
    assert port.sent == [(0, 0)]  # forgotten long ago


def test_a_port_in_a_program_with_many_open_files() -> None:
    with many_open_files(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        port = UdpPort(PortAddress("udpout", "127.0.0.1", peer.getsockname()[1]))
        assert port.receive(0.0) == []
        port.send(b"here", None)
        data, sender = peer.recvfrom(100)
        peer.sendto(data, sender)
        assert port.receive(10.0) == [(b"here", None)]
        port.close()
