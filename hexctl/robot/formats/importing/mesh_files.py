"""Points of the meshes that a robot description names: STL, binary or text, OBJ and COLLADA.

The axis that points up in COLLADA (`up_axis`) does not count, because RViz and Gazebo ignore it.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from hexctl.files import is_file, read_file
from hexctl.robot.formats.importing.link_tree import MOST_BYTES
from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.meshes import STL_HEAD, STL_TRIANGLE
from hexctl.robot.rotations import frame_of, placed_points, quaternion_about
from hexctl.types import FloatArray

#: Maximum number of visited nodes of a scene; nodes may be instanced many times.
MOST_NODES = 10_000


class UnreadMeshError(ValueError):
    """Why a mesh was not read."""


def mesh_points(name: str, description: Path) -> FloatArray:
    """Corners of the triangles of a mesh, (N, 3), unscaled; raises UnreadMeshError.

    Its name is that in the description; a package is sought in and next to the folders above it.
    """
    file = next((place for place in _places(name, description) if is_file(place)), None)
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
    found = [placed_points(_vertices(geometry), at) for geometry, at in places]
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
        found.append(np.array((numbers.text or "").split(), dtype=float).reshape(-1, stride)[:, :3])
    return np.concatenate(found)


READERS: dict[str, Callable[[bytes], FloatArray]] = {".stl": _stl, ".obj": _obj, ".dae": collada_points}
