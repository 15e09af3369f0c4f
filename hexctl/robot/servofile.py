"""Write a servo map into a robot file: only its `servos:` section changes, and the old file is kept."""

import os
import shutil
from pathlib import Path

import yaml

from hexctl.errors import InputError
from hexctl.robot.configs import config_root, read_mapping, validate
from hexctl.robot.schema import RobotSchema
from hexctl.robot.servomap import ServoMap
from hexctl.types import JOINT_NAMES

SECTION = "servos"


def check_writable(path: Path) -> None:
    """Raise InputError for a shipped robot file, with how to copy it, and for one that cannot be written."""
    if path.resolve().is_relative_to(config_root().resolve()):
        copy = f"my-{path.name}"
        raise InputError(
            f"calibrate: got the shipped robot {path.stem}; allowed: a file of your own: "
            f"cp {path} {copy}, then hexctl calibrate {copy}"
        )
    if not os.access(path, os.W_OK) or not os.access(path.resolve().parent, os.W_OK):
        raise InputError(f"{path}: cannot be written; allowed: a file, in a folder, that is yours to change")


def back_up(path: Path) -> Path:
    """Copy a file beside itself as `.bak`, or `.bak.2` and so on where there are older ones; return it."""
    number, backup = 2, path.with_name(f"{path.name}.bak")
    while backup.exists():
        backup, number = path.with_name(f"{path.name}.bak.{number}"), number + 1
    shutil.copy2(path, backup)
    return backup


def write_servo_map(path: Path, servo_map: ServoMap) -> None:
    """Replace the `servos:` section of a robot file, or append one; everything else stays to the letter.

    The new file takes the old one's place at once or not at all. Comments inside the section go.
    Raises InputError when the file is no robot file any more.
    """
    place = path.resolve()
    text = place.read_text(encoding="utf-8")
    draft = place.with_name(f".{place.name}.new")
    draft.write_text(replaced(text, section_lines(servo_map)), encoding="utf-8")
    try:
        validate(RobotSchema, read_mapping(draft), path)
        shutil.copymode(place, draft)
        draft.replace(place)
    finally:
        draft.unlink(missing_ok=True)


def section_lines(servo_map: ServoMap) -> list[str]:
    """Return the section that describes a map, every joint written out."""
    lines = [f"{SECTION}: # written by hexctl calibrate"]
    lines.append(f"  us_per_deg: {servo_map.us_per_deg!r}")
    lines.append(f"  centre_us: {servo_map.centre_us:g}")
    if servo_map.low_battery_v is not None:
        lines.append(f"  low_battery_v: {servo_map.low_battery_v!r}")
    for joint, name in enumerate(JOINT_NAMES):
        lines.append(
            f"  {name}: {{channel: {servo_map.channels[joint]}, sign: {servo_map.signs[joint]:g}, "
            f"offset_deg: {float(servo_map.offsets_deg[joint])!r}, "
            f"min_us: {servo_map.min_us[joint]:g}, max_us: {servo_map.max_us[joint]:g}}}"
        )
    return lines


def replaced(text: str, section: list[str]) -> str:
    """Return the text of a robot file with another `servos:` section."""
    lines = text.splitlines()
    begin, end = _section_at(text, len(lines))
    return "\n".join([*lines[:begin], *section, *lines[end:]]) + "\n"


def _section_at(text: str, end_of_file: int) -> tuple[int, int]:
    """Return the lines of the section, from and up to; the end of the file twice where there is none."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    for key, value in pairs:
        if key.value == SECTION:
            lines = text.splitlines()
            end: int = value.end_mark.line + (1 if value.end_mark.column else 0)
            # Comments and blank lines before the next key belong to that.
            while end > key.start_mark.line + 1 and _is_aside(lines[end - 1]):
                end -= 1
            return key.start_mark.line, end
    return end_of_file, end_of_file


def _is_aside(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")
