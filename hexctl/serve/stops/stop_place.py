"""Where a robot is served, as the file of its stop has it: names of ports change, adapters stay."""

import os
import re
from dataclasses import dataclass

from hexctl.backends.serial_ports import listed_ports

#: Serial numbers with fewer different characters are those of a maker who gives all adapters the same one,
#: such as `0001`.
LEAST_CHARACTERS = 4

#: What may stand around the path of a serial device: what says that it is one, and its baud.
_BEFORE, _BAUD = re.compile(r"^serial:"), re.compile(r":[0-9]+$")


@dataclass(frozen=True, slots=True, kw_only=True)
class StopPlace:
    """Where a robot is served.

    Attributes:
        backend: name of its backend.
        where: port of its servos, or endpoint of the server where they have none.
        serial_number: USB vendor, product and serial number of its adapter, or None where it has none, or
            one that other adapters have too.
        location: USB vendor and product of its adapter, and the socket that it is plugged into, or None.
    """

    backend: str
    where: str
    serial_number: str | None = None
    location: str | None = None

    @classmethod
    def of(cls, backend: str, port: str | None, endpoint: str) -> "StopPlace":
        """Place of a robot whose servos are at a port, as it is typed, or that has none."""
        if port is None:
            return cls(backend=backend, where=endpoint)
        path = _BAUD.sub("", _BEFORE.sub("", port))
        if not path.startswith("/"):
            return cls(backend=backend, where=port)
        serial_number, location = _adapter_at(path)
        return cls(backend=backend, where=path, serial_number=serial_number, location=location)

    @property
    def key(self) -> str:
        """What stays of it after a restart, as far as that is known."""
        return f"{self.backend} {self.serial_number or self.location or self.where}"

    @property
    def at_device(self) -> bool:
        """Whether it is the path of a device, which may have another name after a restart."""
        return self.where.startswith("/")

    def may_be(self, other: "StopPlace") -> bool:
        """Whether a robot at another place may be the one here, under another name of its port."""
        if self.backend != other.backend or not (self.at_device and other.at_device):
            return False
        return None in (self.serial_number, other.serial_number) or self.serial_number == other.serial_number

    def __str__(self) -> str:
        """In words, for an operator."""
        adapter = self.serial_number or self.location
        return f"{self.backend} at {self.where}{f' ({adapter})' if adapter else ''}"


def _adapter_at(path: str) -> tuple[str | None, str | None]:
    """Serial number and location of the adapter at a port; None where they are not known."""
    adapters = {os.path.realpath(each.device): each for each in listed_ports() if each.vid is not None}
    mine = adapters.get(os.path.realpath(path))
    if mine is None:
        return None, None

    def number(each: object) -> tuple[object, ...]:
        """Adapters with more than one port have one number for all, and their interfaces tell them apart."""
        interface = str(getattr(each, "location", None) or "").partition(":")[2]
        return (*(getattr(each, name) for name in ("vid", "pid", "serial_number")), interface)

    unique = [number(each) for each in adapters.values()].count(number(mine)) == 1
    own = unique and len(set(mine.serial_number or "")) >= LEAST_CHARACTERS
    model, interface = f"{mine.vid:04x}:{mine.pid:04x}", number(mine)[-1]
    serial_number = f"{model} serial {mine.serial_number}{f':{interface}' if interface else ''}"
    return (
        serial_number if own else None,
        f"{model} at {mine.location}" if mine.location else None,
    )
