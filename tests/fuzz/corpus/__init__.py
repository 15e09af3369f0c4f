"""Inputs that reached something new, a file for each target, an input in base64 on each line."""

from base64 import b64decode, b64encode
from collections.abc import Iterable
from pathlib import Path

FOLDER = Path(__file__).parent

#: Bytes of all inputs that are kept of a target.
MOST_BYTES = 40_000


def kept(name: str) -> tuple[bytes, ...]:
    """Inputs that are kept of a target, the shortest first."""
    path = FOLDER / f"{name}.txt"
    return tuple(b64decode(line) for line in path.read_text().splitlines()) if path.is_file() else ()


def keep(name: str, inputs: Iterable[bytes]) -> int:
    """Keep the shortest inputs of a target in place of those before; how many are kept."""
    chosen, total = [], 0
    for data in sorted(set(inputs), key=lambda each: (len(each), each)):
        total += len(data)
        if total > MOST_BYTES:
            break
        chosen.append(data)
    (FOLDER / f"{name}.txt").write_text("".join(b64encode(data).decode() + "\n" for data in chosen))
    return len(chosen)
