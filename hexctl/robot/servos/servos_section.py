"""Edits of the section `servos` of a robot file by a calibration, with all other lines unchanged."""

import os
import shutil
from pathlib import Path
from typing import Any

import yaml

from hexctl.errors import InputError
from hexctl.files import replacing
from hexctl.robot.configs import config_root, file_says, read_mapping, validate
from hexctl.robot.schema import RobotSchema
from hexctl.robot.servos.raw_map import LIMIT_KEYS, RawMap
from hexctl.types import JOINT_NAMES

SECTION = "servos"

INDENT = "  "

#: Replacements in a text: begin, end and new text.
Edits = list[tuple[int, int, str]]


def check_writable(path: Path) -> None:
    """Raise InputError for a shipped robot file, with the command that copies it, and for a read-only one."""
    if path.resolve().is_relative_to(config_root().resolve()):
        copy = f"my-{path.name}"
        raise InputError(
            f"calibrate: got the shipped robot {path.stem}; allowed: a file of your own: "
            f"cp {path} {copy}, then hexctl calibrate {copy}"
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
    place, name, keys = path.resolve(), JOINT_NAMES[joint], calibrated_keys(raw_map, joint)
    wanted, text = read_mapping(place), place.read_text(encoding="utf-8")
    section = wanted[SECTION] = dict(wanted.get(SECTION) or {})
    section[name] = {**section.get(name, {}), **keys}
    with replacing(place) as draft:
        draft.write_text(with_joint(text, name, keys), encoding="utf-8")
        if not file_says(draft, wanted):
            draft.write_text(with_section(text, section), encoding="utf-8")
        validate(RobotSchema, read_mapping(draft), path)


def with_joint(text: str, name: str, keys: dict[str, float | int]) -> str:
    """Text of a robot file with other values of some keys of a joint."""
    section = _value(yaml.compose(text, Loader=yaml.SafeLoader), SECTION)
    if not isinstance(section, yaml.MappingNode):
        begin = text if not text or text.endswith("\n") else f"{text}\n"
        return f"{begin}{SECTION}:\n{INDENT}{name}: {_flow(keys)}\n"
    joint = _value(section, name)
    if not isinstance(joint, yaml.MappingNode):
        return _edited(text, [_added(text, section, f"{name}: {_flow(keys)}")])
    there = {key.value: value for key, value in joint.value}
    edits = [
        (there[key].start_mark.index, there[key].end_mark.index, _scalar(value))
        for key, value in keys.items()
        if key in there
    ]
    missing = {key: value for key, value in keys.items() if key not in there}
    if missing:
        between = ", " if joint.flow_style else f"\n{_indent(joint)}"
        entries = between.join(f"{key}: {_scalar(value)}" for key, value in missing.items())
        edits.append(_added(text, joint, entries))
    return _edited(text, edits)


def with_section(text: str, section: dict[str, Any]) -> str:
    """Text of a robot file with another section `servos`, a line for each of its keys."""
    lines = text.splitlines()
    begin, end = _section_at(text, len(lines))
    made = yaml.dump(
        {SECTION: section}, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=10_000
    )
    return "\n".join([*lines[:begin], made.rstrip("\n"), *lines[end:]]) + "\n"


class _Dumper(yaml.SafeDumper):
    """Writes shared values in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _value(node: yaml.Node | None, name: str) -> yaml.Node | None:
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    return next((value for key, value in pairs if key.value == name), None)


def _added(text: str, mapping: yaml.MappingNode, entry: str) -> tuple[int, int, str]:
    if mapping.flow_style:
        at = mapping.end_mark.index - 1
        within = text[mapping.start_mark.index + 1 : at].rstrip()
        comma = ", " if mapping.value and not within.endswith(",") else ""
        return at, at, f"{comma}{entry}"
    lines = text.splitlines(keepends=True)
    end = _end_line(mapping, lines)
    at = sum(map(len, lines[:end]))
    newline = "" if not end or lines[end - 1].endswith("\n") else "\n"
    return at, at, f"{newline}{_indent(mapping)}{entry}\n"


def _indent(mapping: yaml.MappingNode) -> str:
    return " " * int(mapping.value[0][0].start_mark.column)


def _end_line(node: yaml.Node, lines: list[str]) -> int:
    """The line after a node; comments and blank lines before the next key belong to that key."""
    end, column = node.end_mark.line, node.end_mark.column
    # A block ends where the next key begins, a flow and the last line of a file after their content.
    end += int(end < len(lines) and bool(lines[end][:column].strip()))
    while end > node.start_mark.line + 1 and _is_aside(lines[min(end, len(lines)) - 1]):
        end -= 1
    return min(end, len(lines))


def _edited(text: str, edits: Edits) -> str:
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _flow(keys: dict[str, float | int]) -> str:
    return "{" + ", ".join(f"{key}: {_scalar(value)}" for key, value in keys.items()) + "}"


def _scalar(value: float) -> str:
    """A number as YAML reads it back to the last bit: 1e-05 would be text there."""
    return yaml.safe_dump(value).split("\n")[0]


def _section_at(text: str, end_of_file: int) -> tuple[int, int]:
    """First line of the section and the line after it; twice the end of the file if there is none."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    for key, value in pairs:
        if key.value == SECTION:
            return key.start_mark.line, _end_line(value, text.splitlines())
    return end_of_file, end_of_file


def _is_aside(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")
