"""Whether a file is a mesh that a viewer can draw: STL, OBJ or GLB, told by its content."""

import struct
from pathlib import Path

from hexctl.errors import InputError

#: Endings and what they are called on the way to a viewer.
MEDIA_TYPES = {".stl": "model/stl", ".obj": "model/obj", ".glb": "model/gltf-binary"}

#: A binary STL: a header, the number of triangles, and as many records.
STL_HEAD, STL_TRIANGLE = 84, 50

#: A GLB: magic, version and length, then chunks.
GLB_HEAD = struct.Struct("<4sII")


def media_type(file: Path) -> str:
    """Return what a file is by its ending.

    Raises InputError for another ending.
    """
    try:
        return MEDIA_TYPES[file.suffix.lower()]
    except KeyError:
        allowed = ", ".join(MEDIA_TYPES)
        raise InputError(f"got a file ending in {file.suffix!r}; allowed: {allowed}") from None


def check_mesh(content: bytes, kind: str) -> None:
    """Raise InputError unless the content is a whole mesh of a kind of `MEDIA_TYPES`."""
    {"model/stl": _check_stl, "model/obj": _check_obj, "model/gltf-binary": _check_glb}[kind](content)


def _check_stl(content: bytes) -> None:
    if len(content) >= STL_HEAD:
        (triangles,) = struct.unpack_from("<I", content, STL_HEAD - 4)
        if triangles and len(content) == STL_HEAD + STL_TRIANGLE * triangles:
            return
    text = content.lstrip()
    if text.startswith(b"solid") and b"vertex" in text and b"endsolid" in text:
        return
    raise InputError("is no whole STL mesh; allowed: binary or text STL with one triangle or more")


def _check_obj(content: bytes) -> None:
    try:
        words = [line.split(maxsplit=1)[:1] for line in content.decode("utf-8").splitlines()]
    except UnicodeDecodeError:
        words = []
    if words.count(["v"]) < 3 or ["f"] not in words:
        raise InputError("is no OBJ mesh; allowed: a text with vertices (v) and faces (f)")


def _check_glb(content: bytes) -> None:
    if len(content) >= GLB_HEAD.size:
        magic, version, length = GLB_HEAD.unpack_from(content)
        if magic == b"glTF" and version == 2 and length == len(content):
            return
    raise InputError("is no whole GLB mesh; allowed: binary glTF, version 2")
