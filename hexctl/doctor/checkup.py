"""State of a computer for hexctl, and which uses work on it.

checkup = doctor()
print(checkup.works["simulate walks"] or "simulates")
"""

import os
from collections.abc import Callable, Container, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.store import RUNS
from hexctl.doctor.connections import Connections, Device, read_connections
from hexctl.doctor.machine import WALK_MB, Drawing, Machine, read_drawing, read_machine
from hexctl.doctor.packages import Packages, read_packages
from hexctl.doctor.plugin_check import PluginReport, read_plugins
from hexctl.doctor.settings_check import SettingsFound, no_option, read_settings_found
from hexctl.export.render import RENDERERS
from hexctl.installation import install_command

#: Packages that each use needs, and the extra that installs them.
USES: dict[str, tuple[str, tuple[str, ...]]] = {
    "simulate walks": ("sim", ("mujoco", "dm-control")),
    "record walks, view them in a browser": ("view", ("rerun-sdk",)),
    "GIF of walks": ("demo", ("mujoco", "rerun-sdk", "pillow")),
    "MP4 of walks": ("pictures", ("mujoco", "rerun-sdk", "pillow", "av")),
    "studies and plots": ("study", ("distributed", "jinja2", "matplotlib", "pyarrow")),
    "Parquet, data frames, LeRobot": ("data", ("pandas", "pyarrow", "rerun-sdk")),
    "a camera over the floor": ("see", ("opencv-python-headless", "pyapriltags", "reportlab")),
    "drive from a phone": ("page", ("websockets",)),
    "boards on I2C": ("i2c", ("smbus2",)),
}

#: Environment variables that influence hexctl.
VARIABLES = ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY", "OMP_NUM_THREADS")


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkup:
    """State of a computer, and which uses work; without names of persons or other computers.

    Attributes:
        packages: versions, and missing packages of extras.
        drawing: renderers without a screen.
        variables: set environment variables.
        works: by use, None if it works, else what is missing and a next step.
    """

    machine: Machine
    packages: Packages
    drawing: Drawing
    connections: Connections
    variables: dict[str, str]
    settings: SettingsFound
    plugins: tuple[PluginReport, ...]
    works: dict[str, str | None]

    def to_dict(self) -> dict[str, Any]:
        """Plain values, the object that `hexctl doctor --json` prints."""
        return asdict(self)


def doctor(
    folder: Path | str = RUNS,
    *,
    is_option: Callable[[str], bool] = no_option,
    commands: Container[str] = (),
) -> Checkup:
    """Examine this computer; it takes a few seconds, moves nothing and opens no device.

    Args:
        folder: of runs, for the disk.
        is_option: whether a variable such as `HEXCTL_RUN_SEED` is an option of a command; without it those
            are reported as unknown.
        commands: names of hexctl's commands, which no plug-in can replace.
    """
    machine, packages = read_machine(Path(folder)), read_packages()
    drawing, connections = read_drawing(), read_connections()
    return Checkup(
        machine=machine,
        packages=packages,
        drawing=drawing,
        connections=connections,
        variables={name: _without_host(name, text) for name in VARIABLES if (text := os.environ.get(name))},
        settings=read_settings_found(is_option),
        plugins=read_plugins(commands),
        works=dict(_works(machine, packages, drawing, connections)),
    )


def _without_host(name: str, text: str) -> str:
    """Drop the computer's name from a display."""
    return f"given:{text.rpartition(':')[2]}" if name == "DISPLAY" and not text.startswith(":") else text


def _works(
    machine: Machine, packages: Packages, drawing: Drawing, connections: Connections
) -> Iterator[tuple[str, str | None]]:
    for use, (extra, names) in USES.items():
        reason = _lacking(packages.lacks(*names), extra)
        if reason is None and use.startswith(("GIF", "MP4")) and not drawing.draws:
            debian = ", or ".join(f"apt-get install {names}" for names in RENDERERS.values())
            reason = f"nothing draws without a screen; on Debian: {debian}"
        if reason is None and use == "boards on I2C":
            reason = _unusable(connections.i2c, "no I2C bus; on a Raspberry Pi: raspi-config")
        yield use, reason
        if use.startswith("record"):
            yield "view walks in a window", reason or (None if drawing.display else "no screen here")
    yield (
        "servos on a serial port",
        _unusable(connections.serial, "no serial port; is the adapter plugged in?"),
    )
    for port in connections.network:
        number = f"{'UDP ' if port.protocol == 'udp' else ''}port {port.number}"
        yield port.use, None if port.free else f"{number} is taken; --listen names another one"
    yield "keep time on a busy machine", None if machine.realtime else REALTIME_ADVICE
    yield "room for recordings", _room(machine)


REALTIME_ADVICE = (
    "the kernel grants no real-time priority; needs rtprio in /etc/security/limits.d, or the systemd unit "
    "that ships"
)


def _lacking(names: tuple[str, ...], extra: str) -> str | None:
    return f"needs {', '.join(names)}: {install_command(extra)}" if names else None


def _unusable(devices: tuple[Device, ...], none: str) -> str | None:
    if not devices:
        return none
    if any(device.usable for device in devices):
        return None
    groups = ",".join(sorted({device.group for device in devices if device.group}))
    if not groups:
        paths = ", ".join(device.path for device in devices)
        return f"{paths} {'is' if len(devices) == 1 else 'are'} for root alone (a console?)"
    return f"not allowed for you: sudo usermod -aG {groups} $USER, then log in again"


def _room(machine: Machine) -> str | None:
    if not machine.folder_writable:
        return "the folder for runs cannot be written; go to another one, or name one by the setting runs"
    walks = machine.disk_free_mb / WALK_MB
    return None if walks >= 100 else f"{machine.disk_free_mb} MB are left, for {walks:.0f} walks of 30 s"
