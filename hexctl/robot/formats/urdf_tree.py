"""A third-party URDF as a tree of links and joints, placed in the frame of the root."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from hexctl.errors import InputError
from hexctl.files import read_file
from hexctl.robot.meshes import STL_HEAD, STL_TRIANGLE
from hexctl.types import FloatArray

MOST_BYTES = 20_000_000

#: Maximum number of links; the time to place them grows with its square.
MOST_LINKS = 500

HINGES = ("revolute", "continuous")


@dataclass(frozen=True, eq=False)
class UrdfShape:
    """A solid of a link: kind `box`, `cylinder`, `sphere` or `mesh`, and its frame in that of the link.

    Sizes in m are length, width and height, or radius and length; a mesh has points in its own frame, (N, 3).
    """

    kind: str
    size_m: tuple[float, ...]
    frame: FloatArray
    points_m: FloatArray | None = None

    @property
    def corners(self) -> FloatArray:
        """Points at its ends in the frame of the link, (N, 3) in m."""
        if self.points_m is not None:
            points = self.points_m
        elif self.kind == "sphere":
            points = np.zeros((1, 3))
        elif self.kind == "cylinder":
            points = np.array([[0, 0, end * self.size_m[1] / 2] for end in (-1, 1)])
        else:
            axis = int(np.argmax(self.size_m))
            points = np.array([np.eye(3)[axis] * end * self.size_m[axis] / 2 for end in (-1, 1)])
        return np.asarray(points @ self.frame[:3, :3].T + self.frame[:3, 3])


@dataclass(frozen=True, eq=False)
class UrdfLink:
    """A link: its mass, None if missing, its centre of mass, and its solids."""

    name: str
    mass_kg: float | None
    com_m: FloatArray
    shapes: tuple[UrdfShape, ...]


@dataclass(frozen=True, eq=False)
class UrdfJoint:
    """A joint: its frame in that of its parent, its axis in its own, and limits, None if missing."""

    name: str
    kind: str
    parent: str
    child: str
    frame: FloatArray
    axis: FloatArray
    limits_rad: tuple[float, float] | None
    torque_nm: float | None
    speed_rad_s: float | None

    @property
    def hinge(self) -> bool:
        """Whether it turns."""
        return self.kind in HINGES


@dataclass(frozen=True, eq=False)
class UrdfTree:
    """Links and joints of a robot by name, joints by that of their child, with a single root."""

    name: str
    root: str
    links: dict[str, UrdfLink]
    joints: dict[str, UrdfJoint]
    children: dict[str, list[str]] = field(default_factory=dict)

    def placed(self, link: str) -> FloatArray:
        """Frame of a link in that of the root with all joints at zero, (4, 4)."""
        frame = np.eye(4)
        while link != self.root:
            frame = self.joints[link].frame @ frame
            link = self.joints[link].parent
        return frame

    def hinges(self, link: str) -> tuple[UrdfJoint, ...]:
        """Hinges between the root and a link, from the root outward."""
        found = []
        while link != self.root:
            joint = self.joints[link]
            found += [joint] if joint.hinge else []
            link = joint.parent
        return tuple(reversed(found))

    def rigid(self, link: str) -> list[str]:
        """A link and all links that are fixed to it."""
        found = [link]
        for child in self.children.get(link, ()):
            if not self.joints[child].hinge:
                found += self.rigid(child)
        return found


def read_urdf(path: Path) -> UrdfTree:
    """Tree of a URDF file; raises InputError for a missing file, no URDF, xacro, or no tree."""
    try:
        text = read_file(path, MOST_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); allowed: a URDF file") from error
    if "<!ENTITY" in text:
        raise InputError(f"{path}: got XML with entities of its own; allowed: a plain URDF")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314  entities, by which XML attacks, are refused above
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is not XML ({error}); allowed: a URDF file") from error
    if root.tag != "robot":
        raise InputError(f"{path}: got XML of a {root.tag!r}; allowed: a URDF, whose root is <robot>")
    if any("xacro" in one.tag or any("${" in value for value in one.attrib.values()) for one in root.iter()):
        raise InputError(f"{path}: has xacro in it; allowed: a URDF, as `xacro FILE > robot.urdf` makes")
    try:
        return _tree(root, path)
    except (ValueError, KeyError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: {error}; allowed: a valid URDF") from error


def _tree(root: Element, path: Path) -> UrdfTree:
    elements = root.findall("link")
    if len(elements) > MOST_LINKS:
        raise InputError(f"{path}: got {len(elements)} links; allowed: a robot of up to {MOST_LINKS}")
    links = {link.name: link for link in (_link(one, path) for one in elements)}
    joints = {joint.child: joint for joint in map(_joint, root.findall("joint"))}
    for joint in joints.values():
        for name in (joint.parent, joint.child):
            if name not in links:
                raise InputError(f"{path}: joint {joint.name} names the link {name!r}, which is not there")
    roots = [name for name in links if name not in joints]
    if len(roots) != 1:
        names = ", ".join(roots[:5]) or "none"
        raise InputError(f"{path}: got {len(roots)} links that nothing carries ({names}); allowed: one")
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        children.setdefault(joint.parent, []).append(joint.child)
    tree = UrdfTree(root.get("name", "robot"), roots[0], links, joints, children)
    if _count(tree, tree.root) != len(links):
        raise InputError(f"{path}: its joints make a loop; allowed: a tree")
    return tree


def _count(tree: UrdfTree, root: str) -> int:
    waiting, count = [root], 0
    while waiting:
        waiting += tree.children.get(waiting.pop(), [])
        count += 1
    return count


def _link(element: Element, path: Path) -> UrdfLink:
    inertial = element.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    com_m = np.zeros(3) if inertial is None else _frame(inertial)[:3, 3]
    shapes = [_shape(part, path) for use in ("collision", "visual") for part in element.findall(use)]
    mass_kg = None if mass is None else _number(mass, "value")
    return UrdfLink(_text(element, "name"), mass_kg, com_m, tuple(one for one in shapes if one is not None))


def _shape(part: Element, path: Path) -> UrdfShape | None:
    frame = _frame(part)
    for kind, keys in (("box", ("size",)), ("cylinder", ("radius", "length")), ("sphere", ("radius",))):
        solid = part.find(f"geometry/{kind}")
        if solid is not None:
            return UrdfShape(kind, tuple(value for key in keys for value in _numbers(solid, key)), frame)
    mesh = part.find("geometry/mesh")
    points_m = None if mesh is None else _mesh_points(mesh, path)
    return None if points_m is None else UrdfShape("mesh", (), frame, points_m)


def _mesh_points(mesh: Element, path: Path) -> FloatArray | None:
    """Corners of the triangles of a binary STL near the URDF, or in its package; None for any other."""
    name = mesh.get("filename", "").removeprefix("file://")
    if name.startswith("package://"):
        name = name.removeprefix("package://").partition("/")[2]
    places = [folder / name for folder in (path.parent, *path.resolve().parents[:3])]
    file = next((place for place in places if place.is_file()), None)
    if file is None or file.suffix.lower() != ".stl" or file.stat().st_size > MOST_BYTES:
        return None
    content = read_file(file, MOST_BYTES)
    count = int.from_bytes(content[80:84], "little")
    if not count or len(content) != STL_HEAD + STL_TRIANGLE * count:
        return None
    triangles = np.frombuffer(content[STL_HEAD:], dtype=np.uint8).reshape(count, STL_TRIANGLE)
    corners = triangles[:, 12:48].copy().view("<f4").reshape(-1, 3).astype(float)
    scale = _numbers(mesh, "scale") if mesh.get("scale") else (1.0, 1.0, 1.0)
    return np.asarray(corners * scale)


def _joint(element: Element) -> UrdfJoint:
    parent, child = (_text(_part(element, tag), "link") for tag in ("parent", "child"))
    axis_element, limit = element.find("axis"), element.find("limit")
    axis = np.array([1.0, 0.0, 0.0] if axis_element is None else _numbers(axis_element, "xyz"))
    kind = _text(element, "type")
    if kind != "fixed" and np.linalg.norm(axis) < 1e-6:
        raise ValueError(f"joint {element.get('name')}: got an axis of length 0")
    limits = None
    if limit is not None and limit.get("lower") and limit.get("upper"):
        limits = (_number(limit, "lower"), _number(limit, "upper"))
    return UrdfJoint(
        name=_text(element, "name"),
        kind=kind,
        parent=parent,
        child=child,
        frame=_frame(element),
        axis=axis / max(float(np.linalg.norm(axis)), 1e-12),
        limits_rad=limits,
        torque_nm=None if limit is None or not limit.get("effort") else _number(limit, "effort"),
        speed_rad_s=None if limit is None or not limit.get("velocity") else _number(limit, "velocity"),
    )


def _frame(element: Element) -> FloatArray:
    """Frame of an `origin`: turns about x, y and z of the parent, then the shift."""
    frame, origin = np.eye(4), element.find("origin")
    if origin is None:
        return frame
    roll, pitch, yaw = _numbers(origin, "rpy") if origin.get("rpy") else (0.0, 0.0, 0.0)
    cr, sr, cp, sp, cy, sy = (part(angle) for angle in (roll, pitch, yaw) for part in (math.cos, math.sin))
    frame[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    if origin.get("xyz"):
        frame[:3, 3] = _numbers(origin, "xyz")
    return frame


def _part(element: Element, tag: str) -> Element:
    part = element.find(tag)
    if part is None:
        raise ValueError(f"{element.tag} {element.get('name')}: has no <{tag}>")
    return part


def _text(element: Element, key: str) -> str:
    text = element.get(key)
    if text is None:
        raise ValueError(f"<{element.tag}> has no {key}")
    return text


def _number(element: Element, key: str) -> float:
    (value,) = _numbers(element, key)
    return value


def _numbers(element: Element, key: str) -> tuple[float, ...]:
    values = tuple(map(float, _text(element, key).split()))
    if not values or not all(map(math.isfinite, values)):
        raise ValueError(f"<{element.tag}> {key}: got {element.get(key)!r}")
    expected = 3 if key in ("xyz", "rpy", "size", "scale") else 1
    if len(values) != expected:
        raise ValueError(f"<{element.tag}> {key}: got {len(values)} numbers; allowed: {expected}")
    return values
