"""Inputs that are kept, in base64, an input on each line behind the name of its target.

`found.txt` has those on which a decoder fell, which stay; a file for each room has those that reach something
new, the shortest of each.
"""

import sys
from base64 import b64decode, b64encode
from collections import defaultdict
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

from tests.fuzz.target import Target

FOLDER = Path(__file__).parent

FOUND = FOLDER / "found.txt"

#: Bytes of all inputs that are kept of a target, those aside on which it fell.
MOST_BYTES = 12_000

PACKAGE = str(FOLDER.parents[2] / "hexctl")


def kept(name: str) -> tuple[bytes, ...]:
    """Inputs that are kept of a target: those on which it fell, then the others, the shortest first."""
    return _kept().get(name, ())


@cache
def _kept() -> dict[str, tuple[bytes, ...]]:
    inputs: dict[str, tuple[bytes, ...]] = defaultdict(tuple)
    for path in (FOUND, *sorted(set(FOLDER.glob("*.txt")) - {FOUND})):
        for name, data in _lines(path):
            inputs[name] += (data,)
    return dict(inputs)


def _lines(path: Path) -> list[tuple[str, bytes]]:
    lines = path.read_text().splitlines() if path.is_file() else []
    return [(name, b64decode(data)) for name, _, data in (line.partition(" ") for line in lines)]


def _write(path: Path, lines: Iterable[tuple[str, bytes]]) -> None:
    path.write_text("".join(f"{name} {b64encode(data).decode()}\n" for name, data in lines))


def keep(room: str, name: str, inputs: Iterable[bytes]) -> None:
    """Keep inputs of a target in place of those before."""
    path = FOLDER / f"{room}.txt"
    others = [line for line in _lines(path) if line[0] != name]
    _write(path, sorted([*others, *((name, data) for data in inputs)], key=lambda line: line[0]))


def keep_found(name: str, inputs: Iterable[bytes]) -> None:
    """Keep inputs on which a target fell, beside those before."""
    _write(FOUND, sorted({*_lines(FOUND), *((name, data) for data in inputs)}))


def reaching(target: Target, inputs: Iterable[bytes]) -> list[bytes]:
    """Of some inputs those that reach a line of hexctl from another line than all shorter ones."""
    chosen: list[bytes] = []
    reached: set[tuple[str, int, int]] = set()
    total = 0
    for data in sorted(set(inputs), key=lambda each: (len(each), each)):
        new = _reached(target, data) - reached
        if new and total + len(data) <= MOST_BYTES:
            reached |= new
            total += len(data)
            chosen.append(data)
    return chosen


def _reached(target: Target, data: bytes) -> set[tuple[str, int, int]]:
    """Steps from line to line of hexctl that an input takes."""
    steps: set[tuple[str, int, int]] = set()

    def call(frame: FrameType, _event: str, _argument: Any) -> Any:
        name, last = frame.f_code.co_filename, frame.f_lineno
        if not name.startswith(PACKAGE):
            return None

        def line(frame: FrameType, event: str, _argument: Any) -> Any:
            nonlocal last
            if event == "line":
                steps.add((name, last, frame.f_lineno))
                last = frame.f_lineno
            return line

        return line

    sys.settrace(call)
    try:
        target.fall(data)
    finally:
        sys.settrace(None)
    return steps
