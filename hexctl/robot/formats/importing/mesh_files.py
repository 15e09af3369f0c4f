"""Points of the meshes that a robot description names: STL, binary or text, OBJ and COLLADA.

The axis that points up in COLLADA (`up_axis`) does not count, because RViz and Gazebo ignore it.
"""

import io
import math
import re
import unicodedata
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import starmap
from pathlib import Path, PurePosixPath
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np

from hexctl.files import is_file, is_folder, read_file
from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.meshes import STL_HEAD, STL_TRIANGLE
from hexctl.robot.rotations import frame_of, quaternion_about, transformed_points
from hexctl.types import FloatArray

#: Maximum size of a mesh, and of all meshes of a description; text counts more, because it takes longer.
MOST_BYTES, MOST_BYTES_OF_ALL, TEXT_WEIGHT = 20_000_000, 60_000_000, 3

#: A package as launch files and xacro name it.
FIND = re.compile(r"^\$\((?:find|find-pkg-share) ([^)]*)\)")

#: Maximum number of visited nodes of a scene; nodes may be instanced many times.
MOST_NODES = 10_000


class UnreadMeshError(ValueError):
    """Why a mesh was not read."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshReader:
    """Reads the meshes that a description names, each file once, up to a total size.

    Attributes:
        description: its path; meshes are sought from its folder, packages in and next to the folders above.
    """

    description: Path
    _read: dict[Path, FloatArray] = field(default_factory=dict)
    _sizes: list[int] = field(default_factory=list)

    def points(self, name: str) -> FloatArray:
        """Distinct corners of the triangles of a mesh, (N, 3), unscaled; raises UnreadMeshError."""
        file = find_mesh(name, self.description.parent, *self.description.resolve().parents[:4])
        if file is None:
            raise UnreadMeshError("not found")
        if file not in self._read:
            self._read[file] = self._points(file)
        return self._read[file]

    def _points(self, file: Path) -> FloatArray:
        kind = file.suffix.lower()
        if kind not in READERS:
            raise UnreadMeshError(f"a {kind or 'nameless'} file is not read, only {', '.join(READERS)}")
        try:
            content = read_file(file, MOST_BYTES)
        except (OSError, ValueError) as error:
            raise UnreadMeshError(str(error)) from error
        self._sizes.append(len(content) * (1 if b"\0" in content[:STL_HEAD] else TEXT_WEIGHT))
        if sum(self._sizes) > MOST_BYTES_OF_ALL:
            raise UnreadMeshError(f"the meshes before it have {MOST_BYTES_OF_ALL / 1e6:g} MB")
        try:
            points = READERS[kind](content)
        except ValueError as error:
            raise UnreadMeshError("is not a complete mesh") from error
        if not len(points) or not np.isfinite(points).all():
            raise UnreadMeshError("is not a complete mesh")
        return _distinct(points)


def _distinct(points: FloatArray) -> FloatArray:
    """Points without those within a 65000th of the extent of another one."""
    low, spans = points.min(axis=0), np.maximum(np.ptp(points, axis=0), 1e-300)
    cells = ((points - low) / spans * 0xFFFF).astype(np.int64)
    _, first = np.unique(cells @ np.array([1, 1 << 16, 1 << 32]), return_index=True)
    return np.asarray(points[np.sort(first)])


def find_mesh(name: str, *folders: Path) -> Path | None:
    """File of a mesh named in a description, sought from folders; in another case only if there is none else.

    Names may be URLs, with `%20` for a space, and paths of Windows.
    """
    name = FIND.sub(r"package://\1", name.removeprefix("file://").replace("\\", "/"))
    spellings = dict.fromkeys((name, unquote(name)))
    places = [(folder, place) for one in spellings for folder in folders for place in _places(one)]
    exact = (folder / place for folder, place in places if is_file(folder / place))
    return next(exact, None) or next(filter(None, starmap(_in_any_case, places)), None)


def _places(name: str) -> Iterator[str]:
    if "://" not in name:
        yield name
        return
    package, _, inside = name.partition("://")[2].partition("/")
    yield from (inside, f"{package}/{inside}", f"src/{package}/{inside}")


def _in_any_case(folder: Path, place: str) -> Path | None:
    """The file at a place in a folder whose name differs at most in case or in the form of its accents."""
    at = folder
    for part in PurePosixPath(place).parts:
        found = at / part
        if not is_file(found) and not is_folder(found):
            found = next((one for one in _content(at) if _folded(one.name) == _folded(part)), found)
        at = found
    return at if is_file(at) else None


def _content(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except (OSError, ValueError):
        return []


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def stl_volume(file: Path) -> float:
    """Volume of a binary STL in its unit, by signed tetrahedra; NaN for any other file."""
    try:
        corners = _binary_stl(read_file(file, MOST_BYTES)).reshape(-1, 3, 3)
    except (OSError, ValueError):
        return math.nan
    first, second, third = np.moveaxis(corners - corners[:1, :1], 1, 0)
    return abs(float(np.sum(first * np.cross(second, third)))) / 6 or math.nan


def _stl(content: bytes) -> FloatArray:
    corners = _binary_stl(content)
    return corners if len(corners) else _rows(content, b"vertex")


def _binary_stl(content: bytes) -> FloatArray:
    count = int.from_bytes(content[80:84], "little")
    if len(content) != STL_HEAD + STL_TRIANGLE * count:
        return np.zeros((0, 3))
    triangles = np.frombuffer(content[STL_HEAD:], dtype=np.uint8).reshape(count, STL_TRIANGLE)
    return np.asarray(triangles[:, 12:48].copy().view("<f4").reshape(-1, 3), dtype=float)


def _obj(content: bytes) -> FloatArray:
    return _rows(content, b"v")


def _rows(content: bytes, word: bytes) -> FloatArray:
    """The three numbers after a word in each line of a text that begins with it."""
    lines = (line for line in io.BytesIO(content) if line.lstrip()[: len(word)].lower() == word)
    rows = [line for line in lines if line.split(maxsplit=1)[0].lower() == word]
    if not rows:
        return np.zeros((0, 3))
    return np.loadtxt(rows, usecols=(1, 2, 3), comments=None, ndmin=2, encoding="latin-1")


def collada_points(content: bytes) -> FloatArray:
    """Points of a COLLADA file, (N, 3) in m, placed by the nodes of its scene; or ValueError."""
    root = parse_xml(content)
    ids = {element.get("id", ""): element for element in root.iter()}
    unit = root.find("{*}asset/{*}unit")
    metre = 1.0 if unit is None else float(unit.get("meter", "1"))
    shown = root.find("{*}scene/{*}instance_visual_scene")
    scene = root.find("{*}library_visual_scenes/{*}visual_scene") if shown is None else _target(ids, shown)
    if scene is not None:
        places = _placed_geometries(scene, ids)
    else:
        places = ((one, np.eye(4)) for one in root.findall("{*}library_geometries/{*}geometry"))
    found = [transformed_points(_vertices(geometry), at) for geometry, at in places]
    return metre * np.concatenate([np.zeros((0, 3)), *found])


def _target(ids: dict[str, Element], element: Element, key: str = "url") -> Element | None:
    return ids.get(element.get(key, "").removeprefix("#"))


def _placed_geometries(scene: Element, ids: dict[str, Element]) -> Iterator[tuple[Element, FloatArray]]:
    """Geometries of a scene with their frames, (4, 4)."""
    waiting, count = [(scene, np.eye(4))], 0
    while waiting:
        node, at = waiting.pop()
        at, count = at @ _frame(node), count + 1
        if count > MOST_NODES:
            raise ValueError(f"has more than {MOST_NODES} nodes")
        for child in node:
            tag = _tag(child)
            if tag == "node":
                waiting.append((child, at))
            elif tag == "instance_node" and (target := _target(ids, child)) is not None:
                waiting.append((target, at))
            elif tag == "instance_geometry" and (target := _target(ids, child)) is not None:
                yield target, at


def _tag(element: Element) -> str:
    return element.tag.rpartition("}")[2]


def _frame(node: Element) -> FloatArray:
    """Product of the transforms of a node, (4, 4)."""
    frame = np.eye(4)
    for child in node:
        tag, values, step = _tag(child), (child.text or "").split(), np.eye(4)
        if tag == "matrix":
            step = np.array(values, dtype=float).reshape(4, 4)
        elif tag == "translate":
            step = frame_of(np.array(values, dtype=float))
        elif tag == "scale":
            step[[0, 1, 2], [0, 1, 2]] = np.array(values, dtype=float)
        elif tag == "rotate":
            *axis, degrees = map(float, values)
            step = frame_of(np.zeros(3), quaternion_about(axis, math.radians(degrees)))
        frame = frame @ step
    return frame


def _vertices(geometry: Element) -> FloatArray:
    """Positions of the vertices of a geometry, (N, 3)."""
    found = [np.zeros((0, 3))]
    sources = {element.get("id", ""): element for element in geometry.iter()}
    for put in geometry.findall("{*}mesh/{*}vertices/{*}input[@semantic='POSITION']"):
        source = _target(sources, put, "source")
        numbers = None if source is None else source.find("{*}float_array")
        if source is None or numbers is None:
            continue
        accessor = source.find("{*}technique_common/{*}accessor")
        stride = 3 if accessor is None else int(accessor.get("stride", "3"))
        found.append(_numbers(numbers.text or "").reshape(-1, stride)[:, :3])
    return np.concatenate(found)


def _numbers(text: str) -> FloatArray:
    """Numbers of a text; raises ValueError for anything else."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, sep=" ")
        except DeprecationWarning as error:
            raise ValueError("has text in place of numbers") from error


READERS: dict[str, Callable[[bytes], FloatArray]] = {".stl": _stl, ".obj": _obj, ".dae": collada_points}
