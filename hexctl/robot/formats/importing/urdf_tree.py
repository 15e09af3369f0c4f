"""A third-party URDF as a tree of links and joints."""

import math
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from hexctl.errors import InputError
from hexctl.files import read_file
from hexctl.robot.formats.importing.link_tree import (
    MOST_BYTES,
    MOST_LINKS,
    LinkTree,
    Solid,
    TreeJoint,
    TreeLink,
    tree_of,
)
from hexctl.robot.formats.importing.mesh_files import MeshReader, UnreadMeshError
from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.rotations import frame_of, quaternion_of_euler
from hexctl.types import FloatArray


def read_urdf(path: Path) -> LinkTree:
    """Tree of a URDF file; raises InputError for a missing file, no URDF, xacro, or no tree."""
    try:
        content = read_file(path, MOST_BYTES)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error}); allowed: a URDF file") from error
    try:
        root = parse_xml(content)
    except ValueError as error:
        raise InputError(f"{path}: {error}; allowed: a plain URDF") from error
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


def _tree(root: Element, path: Path) -> LinkTree:
    elements = root.findall("link")
    if len(elements) > MOST_LINKS:
        raise ValueError(f"got {len(elements)} links; allowed: a robot of up to {MOST_LINKS}")
    meshes = MeshReader(path)
    links, joints = [_link(one, meshes) for one in elements], [_joint(one) for one in root.findall("joint")]
    # The world, to which the robot is joined by a floating joint, is no part of it.
    left_out_kg: dict[str, float] = {}
    worlds = {joint.parent for joint in joints if joint.loose} - {joint.child for joint in joints}
    if len(worlds) == 1 and sum(joint.parent in worlds for joint in joints) == 1:
        left_out_kg = {link.name: link.mass_kg for link in links if link.name in worlds and link.mass_kg}
        links = [link for link in links if link.name not in worlds]
        joints = [joint for joint in joints if joint.parent not in worlds]
    return tree_of(root.get("name", "robot"), links, joints, left_out_kg=left_out_kg)


def _link(element: Element, meshes: MeshReader) -> TreeLink:
    inertial = element.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    com_m = np.zeros(3) if inertial is None else _frame(inertial)[:3, 3]
    uses = [_solids(element.findall(use), meshes) for use in ("collision", "visual")]
    complete = any(solids and not unread for solids, unread in uses)
    return TreeLink(
        name=_text(element, "name"),
        mass_kg=None if mass is None else _number(mass, "value"),
        com_m=com_m,
        inertia_kg_m2=None if inertial is None else _inertia(inertial),
        solids=tuple(one for solids, _ in uses for one in solids),
        unread_meshes=() if complete else tuple(one for _, unread in uses for one in unread),
    )


def _solids(parts: list[Element], meshes: MeshReader) -> tuple[list[Solid], list[str]]:
    """Solids of the visual or the collision parts of a link, and the unread meshes among them."""
    solids, unread = [], []
    for part in parts:
        try:
            solid = _solid(part, meshes)
        except UnreadMeshError as error:
            unread.append(str(error))
        else:
            solids += [] if solid is None else [solid]
    return solids, unread


def _inertia(inertial: Element) -> FloatArray | None:
    """Tensor along the axes of the link, (3, 3)."""
    inertia = inertial.find("inertia")
    if inertia is None:
        return None
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (_number(inertia, key) if inertia.get(key) else 0.0 for key in keys)
    turn = _frame(inertial)[:3, :3]
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return np.asarray(turn @ tensor @ turn.T)


def _solid(part: Element, meshes: MeshReader) -> Solid | None:
    frame = _frame(part)
    for kind, keys in (("box", ("size",)), ("cylinder", ("radius", "length")), ("sphere", ("radius",))):
        solid = part.find(f"geometry/{kind}")
        if solid is not None:
            return Solid(kind, tuple(value for key in keys for value in _numbers(solid, key)), frame)
    mesh = part.find("geometry/mesh")
    return None if mesh is None else Solid("mesh", (), frame, _mesh(mesh, meshes))


def _mesh(mesh: Element, meshes: MeshReader) -> FloatArray:
    """Scaled points of a mesh; raises UnreadMeshError with its name and the reason."""
    name = mesh.get("filename", "")
    try:
        scale = _numbers(mesh, "scale") if mesh.get("scale") else (1.0, 1.0, 1.0)
        return np.asarray(meshes.points(name) * scale)
    except UnreadMeshError as error:
        raise UnreadMeshError(f"{name} ({error})") from error


def _joint(element: Element) -> TreeJoint:
    parent, child = (_text(_part(element, tag), "link") for tag in ("parent", "child"))
    axis_element, limit, dynamics = (element.find(tag) for tag in ("axis", "limit", "dynamics"))
    mimic = element.find("mimic")
    axis = np.array([1.0, 0.0, 0.0] if axis_element is None else _numbers(axis_element, "xyz"))
    kind = _text(element, "type")
    if kind != "fixed" and np.linalg.norm(axis) < 1e-6:
        raise ValueError(f"joint {element.get('name')}: got an axis of length 0")
    low, high = _optional(limit, "lower"), _optional(limit, "upper")
    return TreeJoint(
        name=_text(element, "name"),
        kind=kind,
        parent=parent,
        child=child,
        frame=_frame(element),
        axis=axis / max(float(np.linalg.norm(axis)), 1e-12),
        # A missing end is 0 in URDF.
        limits_rad=None if low is None and high is None else (low or 0.0, high or 0.0),
        torque_nm=_optional(limit, "effort"),
        speed_rad_s=_optional(limit, "velocity"),
        friction_nm=_optional(dynamics, "friction"),
        damping_nm_s_per_rad=_optional(dynamics, "damping"),
        follows=None if mimic is None else mimic.get("joint", "another joint"),
    )


def _optional(element: Element | None, key: str) -> float | None:
    return None if element is None or not element.get(key) else _number(element, key)


def _frame(element: Element) -> FloatArray:
    """Frame of an `origin`: turns about x, y and z of the parent, then the shift."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    turns_rad = _numbers(origin, "rpy") if origin.get("rpy") else (0.0, 0.0, 0.0)
    position_m = _numbers(origin, "xyz") if origin.get("xyz") else (0.0, 0.0, 0.0)
    return frame_of(position_m, quaternion_of_euler(*turns_rad))


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
