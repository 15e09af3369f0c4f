"""Points of the meshes that a robot description names: STL, binary or text, OBJ and COLLADA."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hexctl.files import read_file
from hexctl.robot.formats.collada import collada_points
from hexctl.robot.formats.link_tree import MOST_BYTES
from hexctl.robot.meshes import STL_HEAD, STL_TRIANGLE
from hexctl.types import FloatArray


class UnreadMeshError(ValueError):
    """Why a mesh was not read."""


def mesh_points(name: str, description: Path) -> FloatArray:
    """Corners of the triangles of a mesh, (N, 3), unscaled; raises UnreadMeshError.

    Args:
        name: file name in the description; a package is sought in and next to the folders above it.
        description: path of the description.
    """
    file = next((place for place in _places(name, description) if place.is_file()), None)
    if file is None:
        raise UnreadMeshError("not found")
    kind = file.suffix.lower()
    if kind not in READERS:
        raise UnreadMeshError(f"a {kind or 'nameless'} file is not read, only {', '.join(READERS)}")
    try:
        content = read_file(file, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise UnreadMeshError(str(error)) from error
    try:
        points = READERS[kind](content)
    except ValueError as error:
        raise UnreadMeshError("is not a complete mesh") from error
    if not len(points) or not np.isfinite(points).all():
        raise UnreadMeshError("is not a complete mesh")
    return points


def _places(name: str, description: Path) -> Iterator[Path]:
    name = name.removeprefix("file://").replace("\\", "/")
    folders = (description.parent, *description.resolve().parents[:4])
    if "://" not in name:
        yield from (folder / name for folder in folders)
        return
    package, _, inside = name.partition("://")[2].partition("/")
    for folder in folders:
        yield folder / inside
        yield folder / package / inside
        yield folder / "src" / package / inside


def _stl(content: bytes) -> FloatArray:
    count = int.from_bytes(content[80:84], "little")
    if count and len(content) == STL_HEAD + STL_TRIANGLE * count:
        triangles = np.frombuffer(content[STL_HEAD:], dtype=np.uint8).reshape(count, STL_TRIANGLE)
        return np.asarray(triangles[:, 12:48].copy().view("<f4").reshape(-1, 3), dtype=float)
    return _rows(content, b"vertex")


def _obj(content: bytes) -> FloatArray:
    return _rows(content, b"v")


def _rows(content: bytes, word: bytes) -> FloatArray:
    """The three numbers after a word in each line of a text that begins with it."""
    lines = (line.split() for line in content.splitlines())
    points = [[float(part) for part in line[1:4]] for line in lines if line and line[0].lower() == word]
    return np.array(points, dtype=float).reshape(-1, 3)


READERS: dict[str, Callable[[bytes], FloatArray]] = {".stl": _stl, ".obj": _obj, ".dae": collada_points}
