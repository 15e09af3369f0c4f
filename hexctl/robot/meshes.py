"""Meshes that a robot is drawn with in recordings: the section `meshes` of a robot file.

They are not part of the `Robot`: changing them leaves priors, sessions and links valid.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hexctl.errors import InputError
from hexctl.files import read_file
from hexctl.robot.rotations import quaternion_of_euler
from hexctl.robot.schema import MeshesSection, MeshSection
from hexctl.types import JOINT_KINDS, ArrayFields, FloatArray

#: Maximum size of a mesh file; recordings contain all of it.
MOST_BYTES = 200_000_000

#: Parts that can have a mesh.
PARTS = ("body", *JOINT_KINDS)


@dataclass(frozen=True, eq=False, kw_only=True)
class PartMesh(ArrayFields):
    """The mesh of the trunk or of one link of every leg, with its pose in that part's frame.

    The trunk's frame is the body frame; a link's begins at its joint, x outward and z up at angle zero. The
    scale is metres per unit of the file, the quaternion (w, x, y, z).
    """

    file: Path
    content: bytes = field(repr=False)
    media_type: str
    scale: float
    position_m: FloatArray
    quaternion: FloatArray

    @property
    def coloured(self) -> bool:
        """Whether the file may hold colours."""
        return self.media_type != "model/stl"


#: Meshes by part, one of `PARTS`; a part without one is drawn as a solid.
Meshes = Mapping[str, PartMesh]


def read_meshes(section: MeshesSection, robot_file: Path) -> Meshes:
    """Meshes in a section of a robot file, relative to that file; raises InputError for broken ones."""
    parts = {part: getattr(section, part) for part in PARTS}
    return {part: _read(robot_file, part, mesh) for part, mesh in parts.items() if mesh is not None}


def _read(robot_file: Path, part: str, section: MeshSection) -> PartMesh:
    file = robot_file.parent / section.file
    try:
        content = read_file(file, MOST_BYTES)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{robot_file}: meshes.{part}.file: {file} cannot be read ({reason})") from error
    try:
        kind = media_type(file)
        check_mesh(content, kind)
    except InputError as error:
        raise InputError(f"{robot_file}: meshes.{part}.file: {file}: {error}") from error
    return PartMesh(
        file=file,
        content=content,
        media_type=kind,
        scale=section.scale,
        position_m=np.array(section.position_m),
        quaternion=quaternion_of_euler(*(math.radians(angle) for angle in section.rotation_deg)),
    )


MEDIA_TYPES = {".stl": "model/stl", ".obj": "model/obj", ".glb": "model/gltf-binary"}

#: A binary STL: a header, the number of triangles, and as many records.
STL_HEAD, STL_TRIANGLE = 84, 50

#: A GLB: magic, version and length, then chunks.
GLB_HEAD = struct.Struct("<4sII")


def media_type(file: Path) -> str:
    """Media type of a mesh file, by its suffix; raises InputError for an unknown one."""
    try:
        return MEDIA_TYPES[file.suffix.lower()]
    except KeyError:
        allowed = ", ".join(MEDIA_TYPES)
        raise InputError(f"got a file ending in {file.suffix!r}; allowed: {allowed}") from None


def check_mesh(content: bytes, kind: str) -> None:
    """Raise InputError unless the content is a complete mesh of one of the `MEDIA_TYPES`."""
    {"model/stl": _check_stl, "model/obj": _check_obj, "model/gltf-binary": _check_glb}[kind](content)


def _check_stl(content: bytes) -> None:
    if len(content) >= STL_HEAD:
        (triangles,) = struct.unpack_from("<I", content, STL_HEAD - 4)
        if triangles and len(content) == STL_HEAD + STL_TRIANGLE * triangles:
            return
    text = content.lstrip()
    if text.startswith(b"solid") and b"vertex" in text and b"endsolid" in text:
        return
    raise InputError("is not a complete STL mesh; allowed: binary or text STL with one triangle or more")


def _check_obj(content: bytes) -> None:
    try:
        words = [line.split(maxsplit=1)[:1] for line in content.decode("utf-8").splitlines()]
    except UnicodeDecodeError:
        words = []
    if words.count(["v"]) < 3 or ["f"] not in words:
        raise InputError("is not an OBJ mesh; allowed: a text with vertices (v) and faces (f)")


def _check_glb(content: bytes) -> None:
    if len(content) >= GLB_HEAD.size:
        magic, version, length = GLB_HEAD.unpack_from(content)
        if magic == b"glTF" and version == 2 and length == len(content):
            return
    raise InputError("is not a complete GLB mesh; allowed: binary glTF, version 2")
