"""A place where a camera looks at a floor, as a file: lens, tags, where the camera stands."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError, argument
from hexctl.files import atomic_write, replacing
from hexctl.robot.configs import Number, file_says, read_mapping, validate
from hexctl.robot.model import Robot
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.camera_view import visible_circle
from hexctl.vision.detection.floor import FloorTag
from hexctl.vision.detection.lens import Lens, load_lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.robot_tracker import RobotTag
from hexctl.vision.detection.tags import HOME_TAG, TAG_IDS
from hexctl.vision.sheet import BAR_LENGTH_MM, BAR_MM


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Place(ArrayFields):
    """A camera over a floor with tags, and the tag of the robot there. Its edges are true ones, in m.

    Attributes:
        camera: where it stands, with its lens.
        floor_tags: by number.
        robot_tag: on the robot.
        bar_mm: as the 100 mm bar of the sheet was measured; edges were scaled by it.
        lens_file: of the lens; None for one that is only assumed.
        latency_s: from a motion to the time stamp of its picture, None where it was not measured.
    """

    camera: Camera
    floor_tags: Mapping[int, FloorTag]
    robot_tag: RobotTag
    bar_mm: float = BAR_MM
    lens_file: Path | None = None
    latency_s: float | None = None

    @property
    def floor_corners(self) -> dict[int, FloatArray]:
        """Corners (4, 2) of the tags on the floor in m, by number."""
        return {number: tag.corners for number, tag in self.floor_tags.items()}

    def printed(self, bar_mm: float) -> "Place":
        """The same place by another length of the bar: all that was learned by the edges is scaled.

        Where the tag is on the robot was not learned, and stays. Raises InputError as `print_scale` does.
        """
        scale = print_scale(bar_mm) / print_scale(self.bar_mm)
        return replace(
            self,
            camera=replace(self.camera, position_floor=scale * self.camera.position_floor),
            floor_tags={
                number: FloorTag(
                    scale * tag.edge_m,
                    PlanarPose(scale * tag.pose.x_m, scale * tag.pose.y_m, tag.pose.yaw_rad),
                )
                for number, tag in self.floor_tags.items()
            },
            robot_tag=replace(self.robot_tag, edge_m=scale * self.robot_tag.edge_m),
            bar_mm=bar_mm,
        )

    @property
    def fov_deg(self) -> float:
        """From the left to the right edge of the picture, of a lens without distortion."""
        lens = self.camera.lens
        return 2 * math.degrees(math.atan(lens.width_px / 2 / float(lens.matrix[0, 0])))


def arena_of(place: Place, robot: Robot) -> tuple[tuple[float, float], float]:
    """Middle (x, y) and radius in m of the largest circle on the floor in which a robot is seen standing.

    `hexctl.adapt` takes them as `home_m` and `arena_m`. Raises InputError for a camera that sees its tag
    nowhere.
    """
    height_m = robot.standing_height_m + place.robot_tag.height_m
    return visible_circle(place.camera, height_m, place.robot_tag.edge_m)


_Tag = Annotated[int, Field(ge=TAG_IDS[0], le=TAG_IDS[-1])]
_EdgeMm = Annotated[Number, Field(ge=5, le=2000)]
_Metres = Annotated[Number, Field(ge=-100, le=100)]
_Degrees = Annotated[Number, Field(ge=-360, le=360)]
_Pixels = Annotated[int, Field(ge=16, le=20000)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class _FloorTagFile(_Strict):
    edge_mm: _EdgeMm
    x_m: _Metres
    y_m: _Metres
    yaw_deg: _Degrees


class _RobotTagFile(_Strict):
    id: _Tag
    edge_mm: _EdgeMm
    x_m: _Metres = 0.0
    y_m: _Metres = 0.0
    yaw_deg: _Degrees = 0.0
    height_m: _Metres


class _AssumedLensFile(_Strict):
    width_px: _Pixels
    height_px: _Pixels
    fov_deg: Annotated[Number, Field(ge=10, le=150)]


class _CameraFile(_Strict):
    position_m: Annotated[list[_Metres], Field(min_length=3, max_length=3)]
    #: w, x, y, z, from the camera's frame to the floor's.
    orientation: Annotated[list[Annotated[Number, Field(ge=-1, le=1)]], Field(min_length=4, max_length=4)]
    #: Width and height of its pictures; those of the calibration unless given.
    picture_px: Annotated[list[_Pixels], Field(min_length=2, max_length=2)] | None = None


class _PlaceFile(_Strict):
    """Edges are those written on the sheet; where the bar is not 100 mm long, all of them are scaled."""

    lens: str | None = None
    assumed_lens: _AssumedLensFile | None = None
    bar_mm: Annotated[Number, Field(ge=BAR_LENGTH_MM.low, le=BAR_LENGTH_MM.high)] = BAR_MM
    floor_tags: dict[_Tag, _FloorTagFile]
    robot_tag: _RobotTagFile
    camera: _CameraFile
    latency_s: Annotated[Number, Field(ge=0, le=2)] | None = None


def print_scale(bar_mm: float) -> float:
    """Factor of all edges, by the measured length of the bar. Raises InputError outside `BAR_LENGTH_MM`."""
    BAR_LENGTH_MM.check(argument("bar_mm"), bar_mm)
    return bar_mm / BAR_MM


def save_place(place: Place, path: str | Path) -> None:
    """Write a place as YAML, in place of an earlier file, whose comments are lost.

    Raises InputError for a lens that is neither of a file nor only assumed, and for a file that cannot be
    written.
    """
    path = Path(path)
    lens = place.camera.lens
    if place.lens_file is None and lens.calibrated:
        raise InputError(
            "place: got a calibrated lens without its file; allowed: a lens_file, or an assumed lens"
        )
    scale = print_scale(place.bar_mm)
    content: dict[str, object] = {}
    if place.lens_file is None:
        content["assumed_lens"] = {
            "width_px": lens.width_px, "height_px": lens.height_px, "fov_deg": round(place.fov_deg, 6)
        }  # fmt: skip
    else:
        content["lens"] = str(_relative(place.lens_file, path.parent))
    tag = place.robot_tag
    content |= {
        "bar_mm": place.bar_mm,
        "floor_tags": {
            number: {"edge_mm": _rounded(1000 * each.edge_m / scale), **_pose(each.pose)}
            for number, each in sorted(place.floor_tags.items())
        },
        "robot_tag": {
            "id": tag.tag_id, "edge_mm": _rounded(1000 * tag.edge_m / scale), **_pose(tag.mount),
            "height_m": tag.height_m,
        },
        "camera": _camera(place.camera),
    }  # fmt: skip
    if place.latency_s is not None:
        content["latency_s"] = place.latency_s
    try:
        atomic_write(path, _yaml(content))
    except OSError as error:
        raise _not_written(path, error) from error


def store_latency(path: Path, latency_s: float) -> None:
    """Write a camera's latency into the file of its place; all its other lines, and its comments, stay.

    A file in braces is written again as a whole, without its comments. Raises InputError for a file that
    cannot be read or written.
    """
    _store(path, "latency_s", latency_s)


def store_camera(path: Path, camera: Camera) -> None:
    """Write where a camera stands, and the size of its pictures, into the file of its place.

    What stays, and what is raised, are as with `store_latency`.
    """
    _store(path, "camera", _camera(camera))


def _camera(camera: Camera) -> dict[str, object]:
    """A camera as the file has it, without its lens."""
    quaternion = Rotation.from_matrix(camera.rotation).as_quat(scalar_first=True)
    return {
        "position_m": [_rounded(value) for value in camera.position_floor],
        "orientation": [_rounded(value) for value in quaternion],
        "picture_px": [camera.lens.width_px, camera.lens.height_px],
    }


def _store(path: Path, key: str, value: object) -> None:
    wanted = {**read_mapping(path), key: value}
    text = _with_value(path.read_text(encoding="utf-8"), key, value)
    try:
        with replacing(path) as draft:
            draft.write_text(text, encoding="utf-8")
            if not file_says(draft, wanted):
                draft.write_text(_yaml(wanted), encoding="utf-8")
    except OSError as error:
        raise _not_written(path, error) from error


def _with_value(text: str, key: str, value: object) -> str:
    """Text of a file with another value of a key in its place, with its comment; else at the end."""
    # A mapping of one number alone would be written in braces.
    lines = _yaml({key: value}) if isinstance(value, Mapping) else f"{key}: {value}"
    first, *more = lines.rstrip().splitlines()
    # Its line without the comment, which is kept, and the lines below it that are indented.
    pattern = re.compile(rf"^{key}[ \t]*:[^#\n]*?([ \t]*(?:#.*)?)$(?:\n[ \t]+.*)*", re.MULTILINE)
    changed, count = pattern.subn(lambda found: "\n".join([f"{first}{found[1]}", *more]), text)
    return changed if count else "\n".join([text.rstrip(), first, *more, ""])


def _yaml(content: dict[str, object]) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None)


def _not_written(path: Path, error: OSError) -> InputError:
    return InputError(f"{argument('place')}: {path} cannot be written: {error.strerror}")


def load_place(path: str | Path) -> Place:
    """Place of a file. Raises InputError, by key, for anything else."""
    path = Path(path)
    content = validate(_PlaceFile, read_mapping(path), path)
    scale = print_scale(content.bar_mm)
    if HOME_TAG not in content.floor_tags:
        raise InputError(f"{path}: floor_tags: got {sorted(content.floor_tags)}; allowed: with {HOME_TAG}")
    if content.robot_tag.id in content.floor_tags:
        raise InputError(f"{path}: robot_tag.id: got {content.robot_tag.id}; allowed: no tag of the floor")
    norm = float(np.linalg.norm(content.camera.orientation))
    if abs(norm - 1) > 0.01:
        raise InputError(f"{path}: camera.orientation: got a length of {norm:.3g}; allowed: 1")
    if content.camera.position_m[2] <= 0:
        raise InputError(
            f"{path}: camera.position_m: got a height of {content.camera.position_m[2]:g} m; allowed: above 0"
        )
    rotation = Rotation.from_quat(content.camera.orientation, scalar_first=True).as_matrix()
    lens_file = None if content.lens is None else path.parent / content.lens
    tag = content.robot_tag
    return Place(
        camera=Camera(_lens(content, path), rotation, np.array(content.camera.position_m)),
        floor_tags={
            number: FloorTag(each.edge_mm / 1000 * scale, _planar(each))
            for number, each in content.floor_tags.items()
        },
        robot_tag=RobotTag(tag.id, tag.edge_mm / 1000 * scale, _planar(tag), tag.height_m),
        bar_mm=content.bar_mm,
        lens_file=lens_file,
        latency_s=content.latency_s,
    )


def _lens(content: _PlaceFile, path: Path) -> Lens:
    """The lens of the file that is named, or the assumed one, for the pictures of the camera."""
    if (content.lens is None) == (content.assumed_lens is None):
        raise InputError(f"{path}: got lens and assumed_lens, or none; allowed: one of them")
    if content.lens is not None:
        if not (path.parent / content.lens).is_file():
            raise InputError(f"{path}: lens: got {content.lens}; allowed: a file that is there")
        lens = load_lens(path.parent / content.lens)
    else:
        assumed = content.assumed_lens
        assert assumed is not None  # noqa: S101  one of them is there
        lens = Lens.assumed(assumed.width_px, assumed.height_px, assumed.fov_deg)
    if content.camera.picture_px is None:
        return lens
    width_px, height_px = content.camera.picture_px
    try:
        return lens.scaled(width_px, height_px)
    except InputError as error:
        raise InputError(f"{path}: camera.picture_px: {error}") from error


def _relative(file: Path, folder: Path) -> Path:
    """Path of a file from a folder, if it lies below; else its whole path."""
    file, folder = file.resolve(), folder.resolve()
    return file.relative_to(folder) if file.is_relative_to(folder) else file


def _planar(values: _FloorTagFile | _RobotTagFile) -> PlanarPose:
    return PlanarPose(values.x_m, values.y_m, math.radians(values.yaw_deg))


def _pose(pose: PlanarPose) -> dict[str, float]:
    return {
        "x_m": _rounded(pose.x_m), "y_m": _rounded(pose.y_m), "yaw_deg": _rounded(math.degrees(pose.yaw_rad))
    }  # fmt: skip


def _rounded(value: float) -> float:
    """As many digits as are worth reading: micrometres."""
    return round(float(value), 6)
