"""How a port is written: `udpin:HOST:PORT`, `udpout:HOST:PORT`, `/dev/ttyACM0`, `/dev/ttyACM0:115200`."""

import ipaddress
import re
from dataclasses import dataclass
from typing import Literal

from hexctl.errors import InputError

#: Where a board on this computer listens unless told otherwise.
DEFAULT_BOARD_PORT = "udpin:127.0.0.1:14550"

#: Where the other end looks for it.
DEFAULT_PORT = "udpout:127.0.0.1:14550"

DEFAULT_BAUD = 115_200
MAX_BAUD = 4_000_000

ALLOWED = "udpin:HOST:PORT, udpout:HOST:PORT, or a serial device such as /dev/ttyACM0 or /dev/ttyACM0:115200"


@dataclass(frozen=True, slots=True)
class PortAddress:
    """A port as values.

    Attributes:
        kind: `udpin` waits to be spoken to, `udpout` speaks first, `serial` is a device.
        place: host name or address, or path of the device.
        number: UDP port, or baud rate.
    """

    kind: Literal["udpin", "udpout", "serial"]
    place: str
    number: int

    @property
    def local(self) -> bool:
        """Return whether nobody beyond this computer and its cables can speak there."""
        if self.kind == "serial" or self.place == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.place).is_loopback
        except ValueError:
            return False


def parse_port(text: str) -> PortAddress:
    """Return what a port's text says.

    Raises InputError for anything else.
    """
    udp = re.fullmatch(r"(udpin|udpout):(\[[0-9a-fA-F:]+\]|[^:\s]+):([0-9]{1,5})", text)
    if udp and 0 < int(udp[3]) < 65536:
        kind: Literal["udpin", "udpout"] = "udpin" if udp[1] == "udpin" else "udpout"
        return PortAddress(kind, udp[2].strip("[]"), int(udp[3]))
    serial = re.fullmatch(r"(?:serial:)?(/[^:\0\n]+)(?::([0-9]{1,7}))?", text)
    if serial:
        baud = int(serial[2] or DEFAULT_BAUD)
        if not 1200 <= baud <= MAX_BAUD:
            raise InputError(f"port: got {baud} baud in {text!r}; allowed: 1200 to {MAX_BAUD}")
        return PortAddress("serial", serial[1], baud)
    raise InputError(f"port: got {text!r}; allowed: {ALLOWED}")


def check_guarded(address: PortAddress, *, option: str, text: str, signed: bool, insecure: bool) -> None:
    """Raise InputError for a port that others on the network reach, without a signature, unless told to."""
    if not (address.local or signed or insecure):
        raise InputError(
            f"{option}: got {text}, where anybody on the network could move the servos; "
            "allowed: this computer, a folder with a mavlink.key (hexctl keys mavlink), or --insecure"
        )
