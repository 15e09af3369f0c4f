"""Edits of the section `servos` of a robot file by a calibration, with all other lines unchanged."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hexctl.errors import InputError
from hexctl.files import replacing
from hexctl.robot.configs import config_root, read_mapping, validate
from hexctl.robot.schema import RobotSchema
from hexctl.robot.servos.raw_map import LIMIT_KEYS, RawMap
from hexctl.robot.yaml_text import with_values
from hexctl.types import JOINT_NAMES

SECTION = "servos"


def check_writable(path: Path, command: str = "calibrate") -> None:
    """Raise InputError for a shipped robot file, with the command that copies it, and for a read-only one."""
    if path.resolve().is_relative_to(config_root().resolve()):
        copy = f"my-{path.name}"
        raise InputError(
            f"{command}: got the shipped robot {path.stem}; allowed: your own file: "
            f"hexctl robot copy {path.stem} {copy}, then hexctl {command} {copy}"
        )
    if not os.access(path, os.W_OK) or not os.access(path.resolve().parent, os.W_OK):
        raise InputError(f"{path}: cannot be written; allowed: a file, in a folder, that is yours to change")


def back_up(path: Path) -> Path:
    """Path of a copy next to a file: `.bak`, or `.bak.2` and so on if earlier ones exist."""
    number, backup = 2, path.with_name(f"{path.name}.bak")
    while backup.exists():
        backup, number = path.with_name(f"{path.name}.bak.{number}"), number + 1
    shutil.copy2(path, backup)
    return backup


def calibrated_keys(raw_map: RawMap, joint: int) -> dict[str, float | int]:
    """Calibrated values of one joint, 0..17, by key of a robot file."""
    lowest, highest = LIMIT_KEYS[raw_map.unit]
    return {
        "sign": int(raw_map.signs[joint]),
        "offset_deg": float(raw_map.offsets_deg[joint]),
        lowest: int(raw_map.least[joint]),
        highest: int(raw_map.most[joint]),
    }


def write_joint(path: Path, raw_map: RawMap, joint: int) -> None:
    """Write sign, offset and limits of one joint, 0..17, into a robot file, atomically.

    Comments stay, except in a section whose joints share keys by anchors. Raises InputError.
    """
    name, keys = JOINT_NAMES[joint], calibrated_keys(raw_map, joint)
    _write_keys(path, lambda section: {name: {**section.get(name, {}), **keys}})


def write_mark(path: Path, mark: str) -> None:
    """Write into a robot file that its legs were walked through, atomically; raises InputError."""
    _write_keys(path, lambda _: {"walked_through": mark})


def _write_keys(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    place = path.resolve()
    wanted, text = read_mapping(place), place.read_text(encoding="utf-8")
    section = wanted[SECTION] = dict(wanted.get(SECTION) or {})
    section.update(change(section))
    with replacing(place) as draft:
        draft.write_text(with_values(text, wanted), encoding="utf-8")
        validate(RobotSchema, read_mapping(draft), path)
