"""Port addresses, sequence numbers, and frames of reference as a pilot would check their signs."""

import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.mavlink_messages import (
    euler_of_quaternion,
    flipped_quaternion,
)
from hexctl.backends.mavlink.mavlink_transport import (
    FORGET_AFTER_S,
    MOST_ADDRESSES,
    MavlinkLink,
    Port,
    PortAddress,
    SequenceCount,
    open_port,
    parse_port,
)
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.rotations import quaternion_of_euler


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
        ("/dev/by-path/pci-0:2:1.0-port0", "serial", "/dev/by-path/pci-0:2:1.0-port0", 115200, True),
        ("/dev/serial/by-path/pci-0:2:1.0:9600", "serial", "/dev/serial/by-path/pci-0:2:1.0", 9600, True),
    ],
)
def test_ports(text: str, kind: str, place: str, number: int, local: bool) -> None:
    address = parse_port(text)
    assert (address.kind, address.place, address.number, address.local) == (kind, place, number, local)
    assert isinstance(address, PortAddress)


@pytest.mark.parametrize(
    "text",
    [
        *("", "udp", "udpin:14550", "udpin:host:0", "udpin:host:65536", "tcp:1.2.3.4:5", "ttyACM0", "COM3"),
        *("/dev/ttyACM0:fast", "/dev/ttyACM0:1199", "/dev/tty\nX", "udpout:a b:1", "udpout:127.0.0.1:14550x"),
    ],
)
def test_a_text_that_is_no_port_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="connect: "):
        parse_port(text)


def follow(numbers: list[int], count: SequenceCount | None = None) -> tuple[SequenceCount, list[bool]]:
    count = count or SequenceCount()
    return count, [count.in_order(number % 256, 0.001 * index) for index, number in enumerate(numbers)]


@pytest.mark.parametrize(
    ("numbers", "lost", "out_of_order", "dropped"),
    [
        ([3, 4, 8, 9], 3, 0, []),
        ([1, 2, 4, 3, 5], 0, 1, [3]),  # late: not used, and not lost
        ([1, 2, 2, 3], 0, 1, [2]),  # twice: used once
    ],
)
def test_frames_that_are_lost_late_or_repeated_are_counted(
    numbers: list[int], lost: int, out_of_order: int, dropped: list[int]
) -> None:
    count, accepted = follow(numbers)
    assert (count.lost, count.out_of_order) == (lost, out_of_order)
    assert [place for place, taken in enumerate(accepted) if not taken] == dropped


def test_a_sender_that_restarts_after_a_silence_is_received_immediately() -> None:
    count, _ = follow([200, 201])
    assert count.in_order(0, 1 + FORGET_AFTER_S)
    assert count.lost == 0


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


def test_ports_that_cannot_be_opened_are_faults() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as used:
        used.bind(("127.0.0.1", 0))
        for text in (f"udpin:127.0.0.1:{used.getsockname()[1]}", "/dev/no-such-port"):
            with pytest.raises(RobotFaultError, match=text):
                open_port(parse_port(text), text=text)


#: Axes of NED or FRD written in ours: x stays, y and z turn over.
AXES = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)


@given(roll=angles, pitch=pitches, yaw=angles)
def test_an_orientation_is_the_same_rotation_in_other_axes(roll: float, pitch: float, yaw: float) -> None:
    from scipy.spatial.transform import Rotation

    ned = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    quaternion = flipped_quaternion(quaternion_of_euler(roll, pitch, yaw))
    ours = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    np.testing.assert_allclose(ours, AXES @ ned @ AXES.T, atol=1e-9)
    back = euler_of_quaternion(quaternion_of_euler(roll, pitch, yaw))
    np.testing.assert_allclose(back, (roll, pitch, yaw), atol=1e-6)
