"""Imports of the package point down, and some rooms are reached by entry points only."""

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "hexctl"

#: Rooms that come in by entry points: nothing else imports them. Simulators draw what vision sees.
OPTIONAL = {"testing", "study", "vision", "simulators"}


@cache
def modules() -> dict[str, Path]:
    """All modules, by dotted name below the package; the package itself has an empty one."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(name: str) -> Iterator[str]:
    """Modules that a module imports: at its top, in functions, and for type checkers."""
    for node in ast.walk(ast.parse(modules()[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "hexctl":
            module = (node.module or "").partition(".")[2]
            for alias in node.names:
                below = f"{module}.{alias.name}".lstrip(".")
                yield below if below in modules() else module
        elif isinstance(node, ast.Import):
            yield from (alias.name[7:] for alias in node.names if alias.name.startswith("hexctl."))


@cache
def arrows() -> dict[str, frozenset[str]]:
    return {name: frozenset(imported(name)) - {name} for name in modules()}


def room_of(name: str) -> str:
    """Room of a module; empty for those directly in the package."""
    room = name.partition(".")[0]
    return room if (PACKAGE / room).is_dir() else ""


def test_rooms_import_what_the_architecture_page_has_and_no_arrow_runs_back_up() -> None:
    page = (PACKAGE.parent / "docs/explanation/architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|([a-z, ]*)\|$", page, re.MULTILINE)
    layers = {room: {*names.replace(",", " ").split()} for room, names in rows}
    found: dict[str, set[str]] = {room: set() for room in map(room_of, modules()) if room}
    for name, below in arrows().items():
        if room := room_of(name):
            found[room] |= {room_of(other) for other in below} - {"", room}
    assert layers == found
    above = [*layers]
    for place, room in enumerate(above):
        assert layers[room] <= {*above[:place]}, room


def test_nothing_else_imports_what_is_behind_an_entry_point() -> None:
    outside = [name for name in modules() if room_of(name) not in OPTIONAL]
    assert not [(a, b) for a in outside for b in arrows()[a] if room_of(b) in OPTIONAL]


def circles() -> Iterator[set[str]]:
    """Modules that import one another, directly or by way of others."""
    below: dict[str, set[str]] = {}
    for name in arrows():
        reached, left = set[str](), [name]
        while left:
            new = arrows()[left.pop()] - reached
            reached |= new
            left += new
        below[name] = reached
    seen = set[str]()
    for name in below:
        if name in below[name] and name not in seen:
            circle = {other for other in below[name] if name in below[other]}
            seen |= circle
            yield circle


def test_no_modules_import_one_another_in_a_circle() -> None:
    assert list(circles()) == []


@pytest.mark.slow
def test_a_robots_computer_needs_no_room_behind_an_entry_point(tmp_path: Path) -> None:
    shutil.copytree(
        PACKAGE, tmp_path / "hexctl", ignore=shutil.ignore_patterns("__pycache__", *sorted(OPTIONAL))
    )
    (tmp_path / "configs").symlink_to(PACKAGE.parent / "configs")
    (tmp_path / "hexctl.toml").write_text("[study]\njobs = 2\n")
    for words, code in (
        ("estop --connect tcp/127.0.0.1:9", 3),
        ("--help", 0),
        ("run --backend mock --no-record --duration 0.2 --robot pexod", 0),
        ("doctor", 0),
        ("study", 2),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "hexctl", *words.split()],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == code, done.stderr
        assert "Traceback" not in done.stderr
    assert "study" in done.stderr
