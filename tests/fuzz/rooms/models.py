"""Targets that are shapes and pictures: URDF of other programs, meshes, and what network cameras send."""

from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from hexctl.errors import HexctlError
from hexctl.robot.formats.importing.robot_import import import_robot
from hexctl.robot.formats.importing.urdf_tree import read_urdf
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot_file
from hexctl.robot.meshes import GLB_HEAD, MEDIA_TYPES, check_mesh
from hexctl.teleop.picture_relay import PictureRelay, _Incoming, _PictureError, jpeg_size
from hexctl.vision.detection.lens_calibration import read_picture
from tests.fuzz.folder import written
from tests.fuzz.target import Target
from tests.robots import shipped

TREE = b"""<robot name="a"><link name="b"><visual><origin xyz="0 0 1" rpy="0 1 0"/><geometry>
<mesh filename="m.stl" scale="1 1 1"/></geometry></visual><inertial><mass value="1"/></inertial></link>
<link name="c"><collision><geometry><box size="1 2 3"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="2" velocity="3"/></joint></robot>"""


def _tree(data: bytes) -> None:
    with written("tree.urdf", data) as path:
        tree = read_urdf(path)
        for link in tree.links:
            assert np.asarray(tree.frame_in_root(link)).shape == (4, 4)
            tree.hinges(link)
            tree.rigid(link)


def _imported(data: bytes) -> None:
    """Import a URDF; the robot file that comes out is a good one, or refused in one line."""
    with written("robot.urdf", data) as path:
        imported = import_robot(path)
        again = path.with_name("imported.yaml")
        again.write_text(imported.text)
        with suppress(HexctlError):
            load_robot_file(again)


def _mesh(data: bytes) -> None:
    for kind in MEDIA_TYPES.values():
        with suppress(HexctlError):
            check_mesh(data, kind)


class Answer:
    """What a camera sends, in pieces of growing size."""

    def __init__(self, data: bytes) -> None:
        self._data, self._size = data, 1

    def read1(self, most: int) -> bytes:
        """The next piece."""
        taken, self._data = self._data[: self._size], self._data[self._size :]
        self._size = min(2 * self._size, most)
        return taken


def _pictures(data: bytes) -> None:
    """Keep what a camera streams until its stream ends, and take it for a single picture too."""
    relay = _relay()
    for read in (_parts, _rest):
        answer: Any = Answer(data)
        with suppress(_PictureError, ValueError):
            read(relay, _Incoming(answer))


def _parts(relay: PictureRelay, incoming: _Incoming) -> None:
    while True:
        relay._keep(incoming.part(b"frame"))


def _rest(relay: PictureRelay, incoming: _Incoming) -> None:
    relay._keep(incoming.rest())


@cache
def _relay() -> PictureRelay:
    return PictureRelay("http://127.0.0.1:1/")


def _jpeg(data: bytes) -> None:
    width, height = jpeg_size(data)
    assert 0 <= width <= 65535
    assert 0 <= height <= 65535


def _still(data: bytes) -> None:
    with written("still.jpg", data) as path:
        assert read_picture(path).ndim == 2


JPEG = (
    b"\xff\xd8\xff\xe0\x00\x10JFIF\0\1\1\0\0\1\0\1\0\0"
    b"\xff\xc0\0\x11\x08\x00\x10\x00\x20\3\1\x22\0\2\x11\1\3\x11\1"
)
PART = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(JPEG), JPEG)
STL = bytes(80) + (1).to_bytes(4, "little") + bytes(50)
GLB = GLB_HEAD.pack(b"glTF", 2, GLB_HEAD.size)


@cache
def _png() -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1])


TARGETS = (
    Target(
        name="urdf-tree",
        read=_tree,
        seeds=(TREE,),
        words=(
            b"<joint",
            b"<link",
            b"nan",
            b"inf",
            b"1e400",
            b"<!ENTITY",
            b"<!DOCTYPE",
            b"${",
            b"<origin",
            b"<axis",
        ),
        most_bytes=2000,
    ),
    Target(
        name="urdf",
        read=_imported,
        seeds=(urdf_of(shipped()).encode(), urdf_of(shipped("pexod")).encode()),
        words=(b"nan", b"inf", b"1e400", b"-1", b"0 0 0", b"fixed", b"continuous", b"prismatic"),
        most_bytes=40_000,
        times=3,
    ),
    Target(
        name="mesh",
        read=_mesh,
        seeds=(STL, GLB, b"v 0 0 0\nv 0 0 1\nv 0 1 0\nf 1 2 3\n", b"solid a\nvertex 0 0 0\nendsolid"),
        words=(b"\nv ", b"\nf ", b"glTF"),
        most_bytes=400,
    ),
    Target(
        name="picture-stream",
        read=_pictures,
        seeds=(PART * 2, PART.replace(b"Content-Length", b"X-Length") * 2, JPEG),
        words=(b"--frame", b"\r\n\r\n", b"Content-Length: 999999999", b"\xff\xd8\xff"),
        most_bytes=1000,
    ),
    Target(
        name="jpeg",
        read=_jpeg,
        seeds=(JPEG,),
        refusals=(ValueError,),
        words=(b"\xff\xc0", b"\xff\xc4"),
        most_bytes=100,
    ),
    Target(
        name="picture",
        read=_still,
        seeds=(_png(),),
        words=(b"IHDR", b"IDAT", b"\xff\xd8\xff"),
        most_bytes=300,
        times=5,
    ),
)
