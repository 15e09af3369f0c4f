"""What a camera sees of a simulated robot: its pictures by MuJoCo, with the flaws of a real camera."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.export.render import Canvas
from hexctl.robot.formats.link_frames import BASE_LINK
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.model import Robot
from hexctl.robot.rotations import about_z
from hexctl.simulators.camera.usual_camera import BLUR_PX, LOOK_AT_M, NOISE, POSITION_M
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import MODULES, Picture, tag_modules

#: The camera by which MuJoCo draws has no distortion; a lens wider than this would need too many pixels.
MOST_FOV_DEG = 140.0

#: Maximum edge of a rendered picture.
MOST_PX = 4096

#: Texture of a tag: pixels per module, and modules with its white edge.
_MODULE_PX, _EDGED = 24, MODULES + 2

#: Thickness of a sheet of paper on the floor.
_SHEET_M = 0.0005

#: Positions in the noise from which a picture takes its own, in each direction.
_SHIFTS = 64

#: Colours of the floor and of the light.
_FLOOR_RGBA = (0.52, 0.5, 0.46, 1.0)

#: Number of the robot's tag and its edge.
ROBOT_TAG, ROBOT_EDGE_M = 10, 0.1

#: A webcam whose lens bends lines at the edge by 20 px.
WEBCAM = Lens(
    width_px=1280,
    height_px=720,
    matrix=np.array([[960.0, 0, 652], [0, 955, 349], [0, 0, 1]]),
    distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
)

#: Field of view of a webcam with pictures of another shape, whose lens bends nothing.
FOV_DEG = 67.0

CAMERA = Camera.looking(WEBCAM, np.array(POSITION_M), np.array(LOOK_AT_M))

#: Tags on the floor by number, as large as `hexctl see print` makes them.
FLOOR_TAGS = {
    number: PlacedTag(number, edge_m, PlanarPose(*pose))
    for number, (edge_m, *pose) in enumerate(
        [(0.11, 0.0, 0.9, 0.3), (0.16, 0.2, -0.95, 1.0), (0.16, 0.9, 0.1, 2.0), (0.16, -0.6, 0.0, 0.0)]
    )
}


def tag_on(robot: Robot) -> PlacedTag:
    """Tag in the middle of a robot's trunk, on top of it."""
    return PlacedTag(ROBOT_TAG, ROBOT_EDGE_M, PlanarPose(0, 0, 0), robot.body.size_m[2] / 2 + 0.001)


@dataclass(frozen=True, slots=True, eq=False)
class RobotPosture(ArrayFields):
    """Pose and joint angles of a robot.

    Attributes:
        position_floor: position of its base, (3,) in m.
        quaternion_floor: orientation of its base, (4,) as (w, x, y, z).
        joint_positions_rad: (18,).
    """

    position_floor: FloatArray
    quaternion_floor: FloatArray
    joint_positions_rad: FloatArray


class SceneRenderer:
    """Draws robots with tags as a camera sees them. It belongs to the thread that made it; close it."""

    def __init__(
        self,
        robot: Robot,
        camera: Camera,
        floor_tags: Mapping[int, PlacedTag],
        robot_tag: PlacedTag,
        *,
        noise: float = NOISE,
        blur_px: float = BLUR_PX,
        shadow: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Build the scene and a rendering context; the flaws of its pictures are those of `TwinCamera`.

        Raises the errors of `Canvas`, and InputError for a too wide lens.
        """
        self.camera, self._blur_px, self._shadow_depth = camera, blur_px, shadow
        self._random = np.random.default_rng(seed)
        self._drawn, self._maps = _drawn_lens(camera.lens)
        self._canvas = Canvas(self._drawn.width_px, self._drawn.height_px)
        import mujoco

        self._mujoco = mujoco
        self.model = _scene(mujoco, robot, camera, self._drawn, floor_tags, robot_tag)
        self.data = mujoco.MjData(self.model)
        self._view = mujoco.MjvCamera()
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.model.camera("see").id
        self._scene = self._canvas.new_scene(self.model)
        size = (camera.lens.height_px + _SHIFTS, camera.lens.width_px + _SHIFTS, 3)
        self._noise = (noise * self._random.standard_normal(size)).astype(np.float32)

    def move_camera(self, camera: Camera) -> None:
        """Draw from another position from now on, through the same lens."""
        self.camera = camera
        seen = self.model.camera("see")
        seen.pos = camera.position_floor
        seen.quat = _camera_quaternion(self._mujoco, camera)

    def draw(self, posture: RobotPosture, at_s: float = 0.0) -> Picture:
        """Grey picture (H, W) at a time."""
        return np.asarray(cv2.cvtColor(self.draw_color(posture, at_s), cv2.COLOR_RGB2GRAY))

    def draw_color(self, posture: RobotPosture, at_s: float = 0.0) -> Picture:
        """Picture (H, W, 3), red first, at a time."""
        return self.develop(self.expose(posture), at_s)

    def expose(self, posture: RobotPosture) -> Picture:
        """What a lens without distortion sees, a little more than the picture."""
        mujoco, qpos = self._mujoco, self.data.qpos
        qpos[:3], qpos[3:7] = posture.position_floor, posture.quaternion_floor
        qpos[7:] = posture.joint_positions_rad
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        everything, look = mujoco.mjtCatBit.mjCAT_ALL, mujoco.MjvOption()
        mujoco.mjv_updateScene(self.model, self.data, look, None, self._view, everything, self._scene)
        return self._canvas.draw(self._scene)

    def develop(self, exposed: Picture, at_s: float = 0.0) -> Picture:
        """Picture (H, W, 3), red first, of what `expose` gave; on any thread, one picture after the other."""
        columns_rows, rests = self._maps
        bent = cv2.remap(exposed, columns_rows, rests, cv2.INTER_LINEAR)
        return self._flawed(np.asarray(bent, dtype=np.uint8), at_s)

    def _flawed(self, picture: NDArray[np.uint8], at_s: float) -> Picture:
        if self._blur_px > 0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), self._blur_px))
        if self._shadow_depth > 0:
            light = _shadow(picture.shape[1], at_s, self._shadow_depth)
            picture = (picture * light[:, np.newaxis]).astype(np.uint8)
        # The same noise at another position in each picture: to draw a million new numbers takes longer.
        row, column = self._random.integers(_SHIFTS, size=2)
        noise = self._noise[row:, column:][: picture.shape[0], : picture.shape[1]]
        return np.asarray(cv2.add(picture, noise, dtype=cv2.CV_8U))

    def close(self) -> None:
        """Free what draws."""
        self._canvas.close()

    def __enter__(self) -> "SceneRenderer":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _drawn_lens(lens: Lens) -> tuple[Lens, tuple[Any, Any]]:
    """Lens without distortion that sees all that a lens sees, and where its picture has each pixel of it."""
    rows, columns = np.mgrid[: lens.height_px, : lens.width_px].astype(float)
    rays = lens.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    if not np.isfinite(rays).all():
        raise InputError(
            f"the lens sees beyond {MOST_FOV_DEG / 2:g} deg of its axis; allowed: a narrower one"
        )
    focal_px = float(np.sqrt(lens.matrix[0, 0] * lens.matrix[1, 1]))
    right, up = (float(np.abs(rays[:, axis]).max()) for axis in (0, 1))
    if math.degrees(2 * math.atan(max(right, up))) > MOST_FOV_DEG:
        raise InputError(f"the lens sees more than {MOST_FOV_DEG:g} deg; allowed: a narrower one")
    focal_px = min(focal_px, MOST_PX / (2 * right + 0.01), MOST_PX / (2 * up + 0.01))
    width_px, height_px = (2 * math.ceil(focal_px * reach) + 2 for reach in (right, up))
    drawn = Lens.assumed(width_px, height_px, math.degrees(2 * math.atan(width_px / 2 / focal_px)))
    where = rays[:, :2] * focal_px + ((width_px - 1) / 2, (height_px - 1) / 2)
    shape = (lens.height_px, lens.width_px)
    columns, rows = (where[:, axis].reshape(shape).astype(np.float32) for axis in (0, 1))
    # OpenCV itself rounds pixels to 1/32 px, each time if this is not done once.
    return drawn, cv2.convertMaps(columns, rows, cv2.CV_16SC2)


def _scene(
    mujoco: Any, robot: Robot, camera: Camera, lens: Lens, floor_tags: Mapping[int, PlacedTag],
    robot_tag: PlacedTag,
) -> Any:  # fmt: skip
    """Model of the robot with a sheet on its trunk and sheets on the floor, and the camera `see`."""
    spec = mujoco.MjSpec.from_string(mjcf_of(robot))
    # Smooth edges take four times as long to draw; the blur of a lens smooths them afterwards.
    spec.visual.quality.offsamples = 0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = lens.width_px, lens.height_px
    floor = spec.geom("floor")
    floor.material, floor.rgba = "", _FLOOR_RGBA
    turned = _camera_quaternion(mujoco, camera)
    fovy_deg = math.degrees(2 * math.atan(lens.height_px / 2 / lens.matrix[1, 1]))
    spec.worldbody.add_camera(name="see", pos=camera.position_floor, quat=turned, fovy=fovy_deg)
    for tag in floor_tags.values():
        _add_sheet(mujoco, spec, spec.worldbody, tag)
    _add_sheet(mujoco, spec, spec.body(BASE_LINK), robot_tag)
    return spec.compile()


def _camera_quaternion(mujoco: Any, camera: Camera) -> FloatArray:
    """Orientation (4,) of a camera as MuJoCo has it, which looks along -z, with y up."""
    turned = np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ravel(camera.rotation * (1.0, -1.0, -1.0)))
    return turned


def _add_sheet(mujoco: Any, spec: Any, body: Any, tag: PlacedTag) -> None:
    """Add a tag with its white edge, as a thin box; its upper side is at the tag's height."""
    name = f"tag{tag.tag_id}"
    modules = np.pad(~tag_modules(tag.tag_id), 1, constant_values=True)
    pixels = np.kron(modules, np.ones((_MODULE_PX, _MODULE_PX))).astype(np.uint8) * 235 + 10
    texture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=pixels.shape[1],
        height=pixels.shape[0],
        nchannel=3,
    )
    texture.data = np.repeat(pixels[..., np.newaxis], 3, axis=2).tobytes()
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    half_m = tag.edge_m * _EDGED / MODULES / 2
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[half_m, half_m, _SHEET_M / 2],
        pos=[
            tag.pose.x_m,
            tag.pose.y_m,
            tag.height_m - _SHEET_M / 2 + (_SHEET_M if tag.height_m == 0 else 0),
        ],
        quat=about_z(tag.pose.yaw_rad),
        material=name,
        contype=0,
        conaffinity=0,
        mass=0,
    )


def _shadow(width_px: int, at_s: float, depth: float) -> NDArray[np.float32]:
    """Light (W,) under a soft shadow, as of a person who walks by: as broad as a third of the picture."""
    columns = np.arange(width_px, dtype=np.float32) / width_px
    middle = 0.5 + 0.7 * math.sin(0.6 * at_s)
    return np.asarray(1 - depth * np.exp(-(((columns - middle) / 0.15) ** 4)), dtype=np.float32)
