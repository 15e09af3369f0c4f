"""Address of a web page: HOST:PORT, or a port of this computer."""

from dataclasses import dataclass

from hexctl.errors import InputError, argument
from hexctl.wire.links import is_loopback

DEFAULT_ADDRESS = "127.0.0.1:8017"


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Address of a web page; port 0 is any free one."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "PageAddress":
        """Address of a text such as `127.0.0.1:8017`, `[::1]:8017` or `8017`; raises InputError."""
        host, colon, port = text.rpartition(":")
        host = (host if colon else "127.0.0.1").removeprefix("[").removesuffix("]")
        if not host or not port.isdecimal() or len(port) > 5 or int(port) > 65535:
            raise InputError(
                f"{argument('page')}: got {text!r}; allowed: HOST:PORT such as {DEFAULT_ADDRESS}"
            )
        return cls(host, int(port))

    @property
    def loopback(self) -> bool:
        """Whether only this computer reaches it."""
        return is_loopback(self.host)

    def check(self, *, secured: bool) -> None:
        """Raise InputError for an address that other computers reach without certificates."""
        if not secured and not self.loopback:
            raise InputError(
                f"{argument('page')}: got {self.host}, which other computers reach, without certificates; "
                "allowed: 127.0.0.1, or with certificates that hexctl keys new made (--page-keys)"
            )
