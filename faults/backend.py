"""Backends of the matrix: how a robot is reached, and the robot file with servos mounted so that it walks."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import yaml

from hexctl.backends.pwm.pulse_board import find_board
from hexctl.robot.configs import config_root
from hexctl.robot.servos.drivers import BOARDS, FAMILIES
from hexctl.types import JOINT_NAMES

#: Horns of the servos on a bus, and what a keeper does: hold, so that the last motion is that of the walk.
ON_A_BUS: dict[str, Any] = {
    "femur": {"offset_deg": -10},
    "tibia": {"offset_deg": 40},
    "if_computer_dies": "hold",
    **{name: {"id": number} for number, name in enumerate(JOINT_NAMES, start=1)},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Backend:
    """One column of the matrix.

    Attributes:
        name: as `hexctl serve --backend` has it; `sim` is a simulation in the controller's own process, and
            `zenoh` a served simulation.
        base: the shipped robot.
        servos: the section `servos` of its file.
        moves_take_time: whether a servo is told how long to take, and what it steers for changes meanwhile.
        plugin: folder of the package that has its driver; empty for those of hexctl.
    """

    name: str
    base: str = "ant"
    servos: dict[str, Any] = field(default_factory=dict)
    moves_take_time: bool = False
    plugin: str = ""

    @property
    def served(self) -> bool:
        """Whether a server stands between controller and robot."""
        return self.name != "sim"

    @property
    def boarded(self) -> bool:
        """Whether the twin is behind a board or a bus, in a process of its own."""
        return self.name not in ("sim", "zenoh")

    @property
    def serial_bus(self) -> bool:
        """Whether its servos are on a serial bus and report."""
        return self.name in FAMILIES or bool(self.plugin)

    @property
    def hobby(self) -> bool:
        """Whether its servos report nothing."""
        return self.name in BOARDS

    @property
    def goes_limp(self) -> bool:
        """Whether its board ends the pulses by itself if nothing commands it."""
        return self.hobby and find_board(self.name).has_watchdog

    @property
    def kinds(self) -> frozenset[str]:
        """Words of the faults that its simulated board of hobby servos knows; none for others."""
        return frozenset(resolve_name(find_board(self.name).simulated).kinds if self.hobby else ())

    @property
    def garbling(self) -> str:
        """Word of the fault that damages what its board answers."""
        return "nack" if "nack" in self.kinds else "garble"

    def install(self, folder: Path) -> dict[str, str]:
        """Install its plug-in into a folder; variables with which programs find it."""
        if not self.plugin:
            return {}
        site = str(folder / "site")
        source = shutil.copytree(config_root().parent / self.plugin, folder / "plug-in")
        pip = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", site)
        subprocess.run([sys.executable, *pip, str(source)], check=True, timeout=120)
        return {"PYTHONPATH": os.pathsep.join([site, os.environ.get("PYTHONPATH", "")])}

    def write_file(self, folder: Path) -> Path:
        """Write the robot file into a folder."""
        content = yaml.safe_load((config_root() / "robots" / f"{self.base}.yaml").read_text(encoding="utf-8"))
        content["servos"] = self.servos
        path = folder / f"{self.base}-{self.name}.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path


BACKENDS = {
    backend.name: backend
    for backend in (
        Backend(name="sim"),
        Backend(name="zenoh"),
        Backend(name="mavlink", servos={"tibia": {"offset_deg": 75}}),
        Backend(name="dynamixel", base="phantomx", servos={**ON_A_BUS, "model": "xl430-w250"}),
        Backend(name="feetech", base="phantomx", servos={**ON_A_BUS, "model": "sts3215"}),
        Backend(name="lx16a", base="phantomx", servos={**ON_A_BUS, "model": "lx16a"}, moves_take_time=True),
        Backend(
            name="hiwonder",
            base="phantomx",
            servos={**ON_A_BUS, "model": "hts35h"},
            moves_take_time=True,
            plugin="examples/hiwonder",
        ),
        Backend(name="servo2040", servos={"tibia": {"offset_deg": 40}}),
        *(
            Backend(name=board, servos={"tibia": {"offset_deg": 40}, "if_computer_dies": "hold"})
            for board in ("pca9685", "maestro", "ssc32")
        ),
    )
}
