"""How ports are written."""

import pytest

from hexctl.backends.mavlink.address import PortAddress, parse_port
from hexctl.errors import InputError


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
    with pytest.raises(InputError, match=r"port: got .*; allowed: ") as refused:
        parse_port(text)
    assert "\n" not in str(refused.value)
