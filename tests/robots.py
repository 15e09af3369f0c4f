"""Robots for tests: the shipped ones, and robot files that differ from `ant` in something."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from hexctl.robot.configs import config_root
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES

#: Shipped robots with priors and measured uncertainty.
ROBOT_NAMES = ("ant", "phantomx", "pexod")

#: Shipped robots as kits and builds are sold and published, with their servos.
VENDORS_ROBOTS = ("phantomx-ax", "makeyourpet", "freenove-big", "jethexa", "lukas")

Content = dict[str, Any]
Edit = Callable[[Content], None]


@cache
def shipped(name: str = "ant") -> Robot:
    """A shipped robot, loaded once."""
    return load_robot(name)


@cache
def without_friction(name: str) -> Robot:
    """A shipped robot whose joints have no dry friction: what they hold at rest has one solution."""
    return replace(shipped(name), joint_dry_friction_nm=None)


def put(*path_and_value: Any) -> Edit:
    """An edit that sets the value at a path of keys."""
    *path, last, value = path_and_value

    def edit(content: Content) -> None:
        _at(content, path)[last] = value

    return edit


def drop(*path_and_key: Any) -> Edit:
    """An edit that removes a key."""
    *path, last = path_and_key

    def edit(content: Content) -> None:
        del _at(content, path)[last]

    return edit


def with_ids(section: Content, first: int = 1) -> Content:
    """A section `servos` in which joints without an id have one, from `first` on."""
    ids = {name: {"id": first + joint, **section.get(name, {})} for joint, name in enumerate(JOINT_NAMES)}
    return {**section, **ids}


def edited_file(folder: Path, *edits: Edit, base: str = "ant") -> Path:
    """Write a shipped robot's file with edits into a folder and return its path."""
    content = yaml.safe_load((config_root() / "robots" / f"{base}.yaml").read_text(encoding="utf-8"))
    for edit in edits:
        edit(content)
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _at(content: Any, path: list[Any]) -> Any:
    for key in path:
        content = content[key]
    return content
