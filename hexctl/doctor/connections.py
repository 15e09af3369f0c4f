"""Connections to robots: serial ports, I2C buses, gamepads and network ports, and their permissions."""

import grp
import os
import socket
import stat
from dataclasses import dataclass
from pathlib import Path

from hexctl.backends.serial_ports import serial_ports
from hexctl.teleop.gamepad import find_gamepads, undrivable_pads

#: Default network ports of hexctl, and their use.
NETWORK_PORTS = {
    ("tcp", 7447): "hexctl serve",
    ("udp", 7447): "stop by datagram",
    ("tcp", 7448): "hexctl serve --ros",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A device file, and the group with access to it, empty if only root has it."""

    path: str
    name: str
    group: str
    usable: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPort:
    """A network port of this computer: `tcp` or `udp`, its number, its use, and whether it is free."""

    protocol: str
    number: int
    use: str
    free: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Connections:
    """Devices, and the default network ports of hexctl."""

    serial: tuple[Device, ...]
    i2c: tuple[Device, ...]
    gamepads: tuple[Device, ...]
    network: tuple[NetworkPort, ...]


def read_connections() -> Connections:
    """Devices and network ports of this computer."""
    return Connections(
        serial=tuple(_device(port.port, port.adapter) for port in serial_ports()),
        i2c=tuple(_device(str(path)) for path in sorted(Path("/dev").glob("i2c-*"))),
        gamepads=(
            *(_device(str(path)) for path in find_gamepads()),
            *(_device(str(path), lack) for path, lack in undrivable_pads().items()),
        ),
        network=tuple(
            NetworkPort(protocol=protocol, number=number, use=use, free=_is_free(number, protocol))
            for (protocol, number), use in NETWORK_PORTS.items()
        ),
    )


def _device(path: str, name: str = "") -> Device:
    try:
        group = _group_of(os.stat(path))
    except (KeyError, OSError):
        group = ""
    return Device(path=path, name=name, group=group, usable=os.access(path, os.R_OK | os.W_OK))


def _group_of(found: os.stat_result) -> str:
    """Group with access to a device, or empty; raises KeyError for a group without a name."""
    shared = stat.S_IRGRP | stat.S_IWGRP
    may = found.st_mode & shared == shared and found.st_gid != 0
    return grp.getgrgid(found.st_gid).gr_name if may else ""


def _is_free(number: int, protocol: str = "tcp") -> bool:
    kind = socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
    with socket.socket(socket.AF_INET, kind) as probe:
        if protocol == "tcp":  # with datagrams it would share the port
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", number))
        except OSError:
            return False
    return True
