"""Small meshes for tests, made byte by byte: STL, OBJ and GLB."""

import json
import struct
from collections.abc import Callable, Sequence

import numpy as np

from hexctl.types import FloatArray

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
Faces = Sequence[tuple[int, int, int]]
FACES: Faces = (
    *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
)


def stl(corners: FloatArray, faces: Faces = ((0, 1, 2),)) -> bytes:
    """Binary STL of corners, (N, 3); a triangle unless `faces` are given."""
    records = (struct.pack("<12fH", 0, 0, 0, *corners[[*face]].ravel(), 0) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + b"".join(records)


def text_stl(corners: FloatArray, faces: Faces = ((0, 1, 2),)) -> bytes:
    """The same mesh as text STL."""
    lines = ["solid made"]
    for face in faces:
        vertices = [f"vertex {x} {y} {z}" for x, y, z in corners[[*face]].tolist()]
        lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid made"]).encode()


def obj(corners: FloatArray, faces: Faces = ((0, 1, 2),)) -> bytes:
    """The same mesh as OBJ."""
    vertices = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    return "\n".join([*vertices, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]).encode()


def stl_box() -> bytes:
    """A box with sides of 1 as binary STL."""
    return stl(CORNERS, FACES)


def glb_box(color: tuple[float, float, float] = (0.9, 0.1, 0.9)) -> bytes:
    """The box as GLB in a colour of its own."""
    points, faces = CORNERS.astype("<f4").tobytes(), np.array(FACES).astype("<u2").tobytes()
    low, high = CORNERS.min(axis=0).tolist(), CORNERS.max(axis=0).tolist()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [*color, 1.0]}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5123, "count": 3 * len(FACES), "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(faces)},
        ],
        "buffers": [{"byteLength": len(points) + len(faces)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = points + faces
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


MAKERS: dict[str, Callable[[], bytes]] = {
    "box.stl": stl_box,
    "text.stl": lambda: text_stl(CORNERS, FACES),
    "box.obj": lambda: obj(CORNERS, FACES),
    "box.glb": glb_box,
}
