"""Serial ports of this computer, and the search for the port of a cable."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.servos.drivers import BAUD
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.waiting import StopRequested, comes_true, never_stop

#: Folder with names of ports that stay, whichever socket an adapter is plugged into.
BY_ID = Path("/dev/serial/by-id")

#: Folder in which Linux describes terminals, by the names of their devices.
TERMINALS = Path("/sys/class/tty")

#: How often ports are listed while a cable is pulled, in s.
POLL_S = 0.2

#: How often ports are listed until it can be done, and the pause before the next time, in s.
TRIES, AGAIN_S = 5, 0.05

#: A device and perhaps its baud rate; names such as /dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0 have
#: colons.
_ADDRESS = re.compile(r"([^:\0\n]+|[^\0\n]*/by-path/[^\0\n]+?)(?::([0-9]{1,7}))?")

_ALLOWED = (
    f"a serial device such as /dev/ttyUSB0 or /dev/ttyUSB0:1000000, at {BAUD.low:.0f} to {BAUD.high:.0f} "
    "baud, here or as `port` in the section `servos` of the robot file"
)


@dataclass(frozen=True, slots=True)
class SerialAddress:
    """A serial device, and its bits per second; 0 if unknown."""

    path: str
    baud: int

    @classmethod
    def parse(cls, text: str | None, baud: float = 0, *, allowed: str = _ALLOWED) -> Self:
        """Return the address in a text such as `/dev/ttyUSB0`, at `baud`, or `/dev/ttyUSB0:1000000`.

        Raises InputError with what is `allowed` for anything else.
        """
        found = _ADDRESS.fullmatch(text or "")
        if found is None or (found[2] and int(found[2]) not in BAUD):
            got = repr(text) if text else "none"
            raise InputError(f"{argument('port')}: got {got}; allowed: {allowed}")
        return cls(found[1], int(found[2] or baud))


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialPort:
    """A serial port.

    `stays` is a name that survives replugging, `vendor` the USB vendor and product, such
    as `0403:6014`; both or None.
    """

    port: str
    stays: str | None
    adapter: str
    vendor: str | None
    serial_number: str | None


def listed_ports() -> list[Any]:
    """Ports as pyserial lists them, its `ListPortInfo`; none if they cannot be listed.

    An adapter unplugged meanwhile makes pyserial raise TypeError, and so does a name of another type.
    """
    from serial.tools.list_ports import comports

    for left in reversed(range(TRIES)):
        try:
            return list(comports())
        except (OSError, TypeError, ValueError):
            WALL_TIME.sleep(AGAIN_S if left else 0.0)
    return []


def _has_device(name: str) -> bool:
    """Whether a port has hardware: Linux also lists missing UARTs, with type 0."""
    try:
        return (TERMINALS / name / "type").read_text().strip() != "0"
    except OSError:
        return True  # only UARTs have a type


def serial_ports() -> list[SerialPort]:
    """Ports with an adapter, and the computer's tty ports with hardware."""
    names = {link.resolve(): str(link) for link in BY_ID.glob("*")} if BY_ID.is_dir() else {}
    return [
        SerialPort(
            port=each.device,
            stays=names.get(Path(each.device).resolve()),
            adapter=each.description,
            vendor=None if each.vid is None else f"{each.vid:04x}:{each.pid:04x}",
            serial_number=each.serial_number,
        )
        for each in sorted(listed_ports())
        if each.vid is not None or ("tty" in each.device and _has_device(Path(each.device).name))
    ]


def unplugged_port(
    before: list[SerialPort],
    *,
    timeout_s: float,
    stop_requested: StopRequested = never_stop,
    time: TimeSource = WALL_TIME,
) -> SerialPort | None:
    """The port that disappears when a cable is pulled; None if a stop is requested first.

    Raises RobotFaultError if no port of `before` disappears in time, or more than one.
    """
    gone: list[SerialPort] = []

    def over() -> bool:
        if stop_requested():
            return True
        left = {each.port for each in serial_ports()}
        gone.extend(each for each in before if each.port not in left)
        return bool(gone)

    if not comes_true(over, timeout_s, poll_s=POLL_S, time=time):
        raise RobotFaultError(
            f"no port disappeared within {timeout_s:g} s; is it the cable of a serial adapter?"
        )
    if len(gone) > 1:
        raise RobotFaultError(
            f"more than one port disappeared: {', '.join(each.port for each in gone)}; pull one cable"
        )
    return gone[0] if gone else None
