"""Points of COLLADA meshes (.dae), placed by the nodes of their scene.

The axis that points up (`up_axis`) does not count: RViz and Gazebo, in which robot descriptions are made,
ignore it.
"""

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.rotations import frame_of, placed_points, quaternion_about
from hexctl.types import FloatArray

#: Maximum number of visited nodes of a scene; nodes may be instanced many times.
MOST_NODES = 10_000


def collada_points(content: bytes) -> FloatArray:
    """Points, (N, 3) in m; raises ValueError for no COLLADA file."""
    root = parse_xml(content)
    ids = {element.get("id", ""): element for element in root.iter()}
    unit = root.find("{*}asset/{*}unit")
    metre = 1.0 if unit is None else float(unit.get("meter", "1"))
    shown = root.find("{*}scene/{*}instance_visual_scene")
    scene = root.find("{*}library_visual_scenes/{*}visual_scene") if shown is None else _target(ids, shown)
    places = _places(scene, ids) if scene is not None else ((one, np.eye(4)) for one in _geometries(root))
    found = [placed_points(_points(geometry), at) for geometry, at in places]
    return metre * np.concatenate([np.zeros((0, 3)), *found])


def _geometries(root: Element) -> list[Element]:
    return root.findall("{*}library_geometries/{*}geometry")


def _target(ids: dict[str, Element], element: Element, key: str = "url") -> Element | None:
    return ids.get(element.get(key, "").removeprefix("#"))


def _places(scene: Element, ids: dict[str, Element]) -> Iterator[tuple[Element, FloatArray]]:
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


def _points(geometry: Element) -> FloatArray:
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
