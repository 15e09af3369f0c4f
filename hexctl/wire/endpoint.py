"""Zenoh endpoints: where a robot listens, where a client connects."""

import ipaddress
import re
from dataclasses import dataclass

from hexctl.errors import InputError

#: Links that hexctl uses; the latter two encrypt.
PROTOCOLS = ("tcp", "tls", "quic")
ENCRYPTED = ("tls", "quic")

_FORM = re.compile(r"(?P<protocol>[a-z]+)/(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})")


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
        if match is None or match["protocol"] not in PROTOCOLS or not 0 < int(match["port"]) < 65_536:
            raise InputError(
                f"endpoint: got {text!r}; allowed: PROTOCOL/HOST:PORT with tcp, tls or quic, "
                "such as tcp/127.0.0.1:7447 or tls/robot.local:7447"
            )
        return cls(match["protocol"], match["host"].strip("[]"), int(match["port"]))

    @property
    def encrypted(self) -> bool:
        """Return whether the link is encrypted and both ends show certificates."""
        return self.protocol in ENCRYPTED

    @property
    def is_loopback(self) -> bool:
        """Return whether nobody beyond this computer can be at the other end."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False
