"""`hexctl doctor`: what this computer has, and what works on it."""

from typing import TYPE_CHECKING, Any

import typer

from hexctl.cli.commands import COMMANDS
from hexctl.cli.console import print_result
from hexctl.cli.settings import is_option, runs_folder
from hexctl.cli.shared_options import JsonOption

if TYPE_CHECKING:
    from hexctl.doctor.checkup import Checkup
    from hexctl.doctor.connections import Device


def doctor(context: typer.Context, as_json: JsonOption = False) -> None:
    """Report what this computer has and what works on it, for a bug report.

    It takes a few seconds, moves nothing, opens no device, and names no person and no other computer.
    """
    from hexctl.doctor.checkup import doctor as look

    root = context.find_root().command
    checkup = look(runs_folder(), is_option=lambda variable: is_option(root, variable), commands=COMMANDS)
    if as_json:
        print_result(checkup.to_dict())
        return
    from hexctl.cli.render.tables import label_table

    works = [(use, "yes" if reason is None else f"NO: {reason}") for use, reason in checkup.works.items()]
    parts: list[Any] = [label_table(_rows(checkup)), "", "what works", label_table(works)]
    print_result(*parts)


def _rows(checkup: "Checkup") -> list[tuple[str, str]]:
    machine, packages, found = checkup.machine, checkup.packages, checkup.connections
    memory = "unknown" if machine.memory_mb is None else "{} MB free of {} MB".format(*machine.memory_mb)
    granted = "real-time priority granted" if machine.realtime else "no real-time priority"
    versions = ", ".join(f"{name} {number}" for name, number in packages.versions.items() if number)
    missing = [extra for extra, names in packages.extras.items() if names]
    drawn = ", ".join(f"{name}: {told or 'no'}" for name, told in checkup.drawing.renderers.items())
    network = ", ".join(
        f"{port.protocol.upper()} {port.number} {'free' if port.free else 'taken'}" for port in found.network
    )
    return [
        ("hexctl", packages.hexctl or "not installed, imported from a folder"),
        ("python", machine.python),
        ("system", f"{machine.system}, {machine.architecture}"),
        ("processor", _processor(checkup)),
        ("memory", memory),
        ("disk", f"{machine.disk_free_mb} MB free{'' if machine.folder_writable else ', cannot be written'}"),
        ("timing", f"{granted}; the latest of 25 ticks of 20 ms came {machine.late_ms:g} ms late"),
        ("drawing", f"{drawn}; {'a' if checkup.drawing.display else 'no'} screen"),
        ("serial ports", _devices(found.serial)),
        ("I2C", _devices(found.i2c)),
        ("gamepads", _devices(found.gamepads)),
        ("network ports", network),
        ("variables", ", ".join(f"{name}={value}" for name, value in checkup.variables.items()) or "none"),
        ("settings", _settings(checkup)),
        *([("unknown variables", ", ".join(unknown))] if (unknown := checkup.settings.unknown) else []),
        ("plug-ins", _plugins(checkup)),
        ("packages", versions),
        ("extras missing", ", ".join(missing) or "none"),
    ]


def _processor(checkup: "Checkup") -> str:
    machine = checkup.machine
    load = "" if machine.load is None else f", load {machine.load:g}"
    governor = "" if machine.governor is None else f", governor {machine.governor}"
    return f"{machine.processor}, {machine.cores} cores{load}{governor}"


NO_SETTINGS = "none: no hexctl.toml here, above, or in ~/.config/hexctl"


def _settings(checkup: "Checkup") -> str:
    by_origin: dict[str, list[str]] = {}
    for one in checkup.settings.values:
        by_origin.setdefault(one.origin, []).append(f"{one.key} = {one.value}")
    return "; ".join(f"{origin}: {', '.join(said)}" for origin, said in by_origin.items()) or NO_SETTINGS


def _plugins(checkup: "Checkup") -> str:
    texts = [
        f"{one.group} {one.name} of {one.distribution} {one.version}: "
        + ("loads" if one.error is None else f"NO: {one.error}")
        for one in checkup.plugins
    ]
    return "\n".join(texts) or "none"


def _devices(devices: "tuple[Device, ...]") -> str:
    """Devices, with the group that gives access to the others."""
    texts = [
        " ".join(filter(None, (device.path, device.name and f"({device.name})")))
        + ("" if device.usable else f" not allowed, {_whose(device)}")
        for device in devices
    ]
    return ", ".join(texts) or "none"


def _whose(device: "Device") -> str:
    return f"group {device.group}" if device.group else "for root alone"
