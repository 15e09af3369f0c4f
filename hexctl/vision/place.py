"""A place file: lens, tags on the floor and the robot, and the pose of the camera."""

import math
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, TypeAdapter, ValidationInfo, field_validator
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError, argument
from hexctl.files import atomic_write
from hexctl.robot.configs import Number, file_part, read_mapping, validate
from hexctl.robot.model import Robot
from hexctl.robot.yaml_text import with_values
from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera, visible_circle
from hexctl.vision.detection.lens import Lens, load_lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import HOME_TAG, TAG_IDS
from hexctl.vision.sheet import BAR_LENGTH_MM, BAR_MM

#: Age of a picture of which nothing is known: of webcams 50 to 120 ms.
USUAL_LATENCY_S = 0.08


def _of_length_1(orientation: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.hypot(*orientation)
    if abs(norm - 1) > 0.01:
        raise ValueError(f"got a length of {norm:.3g}; allowed: 1")
    return orientation


#: A number with as many digits as are worth reading: micrometres.
_Rounded = Annotated[Number, PlainSerializer(lambda value: round(float(value), 6))]
_TagId = Annotated[int, Field(ge=TAG_IDS[0], le=TAG_IDS[-1])]
_EdgeMm = Annotated[_Rounded, Field(ge=5, le=2000, allow_inf_nan=False)]
_Metres = Annotated[_Rounded, Field(ge=-100, le=100, allow_inf_nan=False)]
_Height = Annotated[_Rounded, Field(gt=0, le=100, allow_inf_nan=False)]
_Degrees = Annotated[_Rounded, Field(ge=-360, le=360, allow_inf_nan=False)]
_Cosine = Annotated[_Rounded, Field(ge=-1, le=1, allow_inf_nan=False)]
_Pixels = Annotated[int, Field(ge=16, le=20000)]


@file_part("floor_tag")
class FloorTag:
    """A tag on the floor. The frame has its origin in the middle of the home tag, x along its arrow.

    Attributes:
        edge_mm: nominal edge of its black square.
        x_m: x of its middle.
        y_m: y of its middle.
        yaw_deg: counter-clockwise seen from above.
    """

    edge_mm: _EdgeMm
    x_m: _Metres
    y_m: _Metres
    yaw_deg: _Degrees

    @classmethod
    def at(cls, pose: PlanarPose, edge_mm: float) -> Self:
        """Tag with a pose on the floor."""
        return cls(edge_mm=edge_mm, x_m=pose.x_m, y_m=pose.y_m, yaw_deg=math.degrees(pose.yaw_rad))


@file_part("robot_tag")
class RobotTag:
    """The tag on a robot, in the frame of the robot's base.

    Attributes:
        id: number of the tag.
        edge_mm: nominal edge of its black square.
        x_m: x of its middle.
        y_m: y of its middle.
        yaw_deg: counter-clockwise seen from above.
        height_m: height above the origin of the base.
    """

    id: _TagId
    edge_mm: _EdgeMm
    x_m: _Metres = 0.0
    y_m: _Metres = 0.0
    yaw_deg: _Degrees = 0.0
    height_m: _Metres


@file_part("assumed_lens")
class AssumedLens:
    """A lens without distortion, of which no calibration is known.

    Attributes:
        width_px: of the pictures.
        height_px: of the pictures.
        fov_deg: from the left to the right edge of the picture.
    """

    width_px: _Pixels
    height_px: _Pixels
    fov_deg: Annotated[_Rounded, Field(ge=10, le=150, allow_inf_nan=False)]

    def opened(self) -> Lens:
        """The lens."""
        return Lens.assumed(self.width_px, self.height_px, self.fov_deg)


@file_part("camera")
class CameraPose:
    """Pose of a camera over the floor, and its picture size.

    Attributes:
        position_m: position of the lens: x, y, z.
        orientation: quaternion w, x, y, z, from the camera's frame to the floor's.
        picture_px: width and height of its pictures; by default those of the calibration.
    """

    position_m: tuple[_Metres, _Metres, _Height]
    orientation: Annotated[tuple[_Cosine, _Cosine, _Cosine, _Cosine], AfterValidator(_of_length_1)]
    picture_px: tuple[_Pixels, _Pixels] | None = None

    @classmethod
    def of(cls, camera: Camera) -> Self:
        """Pose of a camera."""
        w, x, y, z = Rotation.from_matrix(camera.rotation).as_quat(scalar_first=True).clip(-1, 1).tolist()
        x_m, y_m, z_m = camera.position_floor.tolist()
        return cls(position_m=(x_m, y_m, z_m), orientation=(w, x, y, z), picture_px=camera.lens.size_px)


@file_part("place")
class Place:
    """Contents of a place file: a camera over a floor with tags, and the robot's tag.

    Edges are nominal. `floor_corners` and `tag` are scaled by the measured bar.

    Attributes:
        lens: calibration file; None for an assumed lens.
        assumed_lens: the assumed lens, or None.
        bar_mm: measured length of the sheet's 100 mm bar.
        floor_tags: tags on the floor, by number.
        robot_tag: tag on the robot.
        camera: pose of the camera.
        latency_s: time from a motion to the time stamp of its picture; None if unknown.

    Raises InputError for an invalid value.
    """

    lens: Path | None = None
    assumed_lens: AssumedLens | None = None
    bar_mm: Annotated[_Rounded, Field(ge=BAR_LENGTH_MM.low, le=BAR_LENGTH_MM.high)] = BAR_MM
    floor_tags: dict[_TagId, FloorTag]
    robot_tag: RobotTag
    camera: CameraPose
    latency_s: Annotated[Number, Field(ge=0, le=2, allow_inf_nan=False)] | None = None

    @field_validator("floor_tags")
    @classmethod
    def _with_home(cls, tags: dict[int, FloorTag]) -> dict[int, FloorTag]:
        if HOME_TAG not in tags:
            raise ValueError(f"got {sorted(tags)}; allowed: with {HOME_TAG}")
        return dict(sorted(tags.items()))

    @field_validator("robot_tag")
    @classmethod
    def _on_no_floor(cls, tag: RobotTag, info: ValidationInfo) -> RobotTag:
        if tag.id in info.data.get("floor_tags", ()):
            raise ValueError(f"got id {tag.id}; allowed: no tag of the floor")
        return tag

    def __post_init__(self) -> None:
        if (self.lens is None) == (self.assumed_lens is None):
            raise ValueError("got lens and assumed_lens, or none; allowed: one of them")

    @property
    def scale(self) -> float:
        """True length of what the sheet names 1 long."""
        return self.bar_mm / BAR_MM

    @property
    def picture_age_s(self) -> float:
        """Age of a picture when it comes: as it was measured, else that of most webcams."""
        return USUAL_LATENCY_S if self.latency_s is None else self.latency_s

    @cached_property
    def floor_corners(self) -> dict[int, FloatArray]:
        """Corners (4, 2) of the tags on the floor in m, by number."""
        return {number: _placed(number, tag, self.scale).corners for number, tag in self.floor_tags.items()}

    @property
    def tag(self) -> PlacedTag:
        """The tag on the robot, in its true size."""
        placed = _placed(self.robot_tag.id, self.robot_tag, self.scale)
        return replace(placed, height_m=self.robot_tag.height_m)

    @cached_property
    def viewpoint(self) -> Camera:
        """The camera with its pose and its lens scaled to the picture size.

        Raises InputError for an unreadable lens file and for another aspect ratio.
        """
        rotation = Rotation.from_quat(self.camera.orientation, scalar_first=True)
        lens = load_lens(self.lens or "") if self.assumed_lens is None else self.assumed_lens.opened()
        if self.camera.picture_px is not None:
            lens = lens.scaled(*self.camera.picture_px)
        return Camera(lens, rotation.as_matrix(), np.array(self.camera.position_m))

    def printed(self, bar_mm: float) -> "Place":
        """The same place with another length of the bar, which scales the positions of floor tags and camera.

        The tag's position on the robot does not change. Raises InputError for an impossible length.
        """
        BAR_LENGTH_MM.check(argument("bar_mm"), bar_mm)
        scale = bar_mm / self.bar_mm
        x_m, y_m, z_m = (scale * value for value in self.camera.position_m)
        floor_tags = {
            number: replace(tag, x_m=scale * tag.x_m, y_m=scale * tag.y_m)
            for number, tag in self.floor_tags.items()
        }
        camera = replace(self.camera, position_m=(x_m, y_m, z_m))
        return replace(self, camera=camera, floor_tags=floor_tags, bar_mm=bar_mm)


def _placed(number: int, tag: FloorTag | RobotTag, scale: float) -> PlacedTag:
    pose = PlanarPose(tag.x_m, tag.y_m, math.radians(tag.yaw_deg))
    return PlacedTag(number, scale * tag.edge_mm / 1000, pose)


def arena_of(place: Place, robot: Robot) -> tuple[tuple[float, float], float]:
    """Middle (x, y) and radius in m of the largest circle on the floor in which a robot is seen standing.

    `hexctl.adapt` takes them as `home_m` and `arena_m`. Raises InputError for a camera that sees its tag
    nowhere.
    """
    height_m = robot.standing_height_m + place.robot_tag.height_m
    return visible_circle(place.viewpoint, height_m, place.tag.edge_m)


def arena_of_file(path: Path, robot: Robot) -> tuple[tuple[float, float], float]:
    """`arena_of` the place of a file; raises InputError also for a bad file."""
    return arena_of(load_place(path), robot)


def load_place(path: str | Path) -> Place:
    """Place of a file, whose lens is there. Raises InputError, by key, for anything else."""
    path = Path(path)
    place = validate(Place, read_mapping(path), path)
    if place.lens is not None:
        if not (path.parent / place.lens).is_file():
            raise InputError(f"{path}: lens: got {place.lens}; allowed: an existing file")
        place = replace(place, lens=path.parent / place.lens)
        load_lens(place.lens or "")  # a bad lens file is named before the pose is checked
    try:
        _ = place.viewpoint
    except InputError as error:
        raise InputError(f"{path}: camera.picture_px: {error}") from error
    return place


def save_place(place: Place, path: str | Path) -> None:
    """Write a place as YAML, in place of an earlier file, whose comments stay.

    Raises InputError for a file that cannot be written.
    """
    path = Path(path)
    content = TypeAdapter(Place).dump_python(place, exclude_none=True)
    content["camera"] = {key: list(value) for key, value in content["camera"].items()}
    if place.lens is not None:
        content["lens"] = str(_relative(place.lens, path.parent))
    try:
        before = path.read_text(encoding="utf-8") if path.is_file() else ""
        atomic_write(path, with_values(before, content))
    except OSError as error:
        raise InputError(f"{argument('place')}: {path} cannot be written: {error.strerror}") from error


def _relative(file: Path, folder: Path) -> Path:
    """Path of a file from a folder, if it lies below; else its complete path."""
    file, folder = file.resolve(), folder.resolve()
    return file.relative_to(folder) if file.is_relative_to(folder) else file
