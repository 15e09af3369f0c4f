"""Zenoh endpoints: where a robot listens, where a client connects."""

import ipaddress
import re
from dataclasses import dataclass

from hexctl.errors import InputError

#: Links that hexctl uses; the latter two encrypt.
PROTOCOLS = ("tcp", "tls", "quic")
ENCRYPTED = ("tls", "quic")

# Nothing behind the port: Zenoh would take settings there that undo certificates.
_FORM = re.compile(r"(?P<protocol>[a-z]+)/(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})")
_LIKE_AN_ADDRESS = re.compile(r"[0-9.]+")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An address on the network.

    Attributes:
        protocol: one of `PROTOCOLS`.
        host: name or address, IPv6 without brackets.
        port: 1 to 65535.
    """

    protocol: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "Endpoint":
        """Return the endpoint that a text such as `tcp/127.0.0.1:7447` names.

        Raises InputError for anything else.
        """
        match = _FORM.fullmatch(text)
        if (
            match is None
            or match["protocol"] not in PROTOCOLS
            or not 0 < int(match["port"]) < 65_536
            or not _is_host(match["host"])
        ):
            raise InputError(
                f"endpoint: got {text!r}; allowed: PROTOCOL/HOST:PORT with tcp, tls or quic, "
                "such as tcp/127.0.0.1:7447 or tls/robot.local:7447"
            )
        return cls(match["protocol"], match["host"].strip("[]"), int(match["port"]))

    def __str__(self) -> str:
        """Return the text that Zenoh understands."""
        return f"{self.protocol}/{self.place}"

    @property
    def place(self) -> str:
        """Return host and port as text."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def encrypted(self) -> bool:
        """Return whether the link is encrypted and both ends show certificates."""
        return self.protocol in ENCRYPTED

    @property
    def is_loopback(self) -> bool:
        """Return whether nobody beyond this computer can be at the other end."""
        address = _address(self.host)
        return self.host == "localhost" if address is None else address.is_loopback

    @property
    def is_everywhere(self) -> bool:
        """Return whether it stands for all addresses of this computer: good for listening only."""
        address = _address(self.host)
        return address is not None and address.is_unspecified


def _is_host(text: str) -> bool:
    """Return whether a host is a name, or an address that one computer can have."""
    address = _address(text.strip("[]"))
    if address is not None:
        return not address.is_multicast and (address.version == 6) == text.startswith("[")
    return not text.startswith("[") and _LIKE_AN_ADDRESS.fullmatch(text) is None


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None
