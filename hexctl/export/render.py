"""Pictures of a recorded trial by MuJoCo without a screen, with EGL or OSMesa."""

import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.control.scoring.score import filled
from hexctl.errors import HexctlError, MissingExtraError
from hexctl.palette import FAILED_COLORS, LINE_COLOR, NOTICED_COLORS
from hexctl.recording.recorded_trial import LEG_CONDITIONS, RecordedTrial
from hexctl.recording.style import TRAIL_COLOR, Color
from hexctl.robot.formats.link_frames import JOINT_LINKS
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS, FloatArray

#: Renderers without a screen in the order of attempts, and the Debian packages of each.
RENDERERS = {"egl": "libegl1 libgl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}

#: Colours and opacity of a leg's links by its condition; an intact leg has the robot's own.
LEG_LOOKS = {
    "noticed": (NOTICED_COLORS, 1.0),
    "failed": (FAILED_COLORS, 1.0),
    "missing": (FAILED_COLORS, 0.15),
}

#: Maximum geoms of a scene, enough for the robot and its trail.
MOST_GEOMS = 1000

#: Ticks of a piece of the trail, and the maximum number of pieces.
PIECE_TICKS, MOST_PIECES = 10, 600


class NoRendererError(HexctlError, RuntimeError):
    """The machine cannot draw without a screen."""


def open_context(width_px: int, height_px: int) -> Any:
    """A current OpenGL context without a screen.

    If the environment variable `MUJOCO_GL` is `egl` or `osmesa`, only that one is tried.

    Raises NoRendererError with the packages to install, and MissingExtraError without MuJoCo.
    """
    try:
        import hexctl.mujoco_import  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError("drawing", "pictures") from error
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    tried, reasons = (wanted,) if wanted in RENDERERS else tuple(RENDERERS), []
    for name in tried:
        try:
            context = import_module(f"mujoco.{name}").GLContext(width_px, height_px)
            context.make_current()
        except Exception as error:  # noqa: BLE001  missing or broken libraries raise anything
            reasons.append(f"{name}: {_reason(error)}")
            _forget_opengl()
        else:
            return context
    packages = ", or ".join(f"apt-get install {RENDERERS[name]}" for name in tried)
    others = " or ".join(f"MUJOCO_GL={name}" for name in RENDERERS if name not in tried)
    raise NoRendererError(
        f"nothing here draws without a screen ({'; '.join(reasons)}); on Debian: {packages}"
        f"{others and f', or set {others}'}"
    )


def _reason(error: Exception) -> str:
    if isinstance(error, AttributeError):  # of PyOpenGL, whose library is None
        return "its library is missing"
    return " ".join(str(error).split())[:80]


def _forget_opengl() -> None:
    """PyOpenGL keeps the first library that it tried."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for name in [name for name in sys.modules if name.partition(".")[0] == "OpenGL"]:
        del sys.modules[name]


class Canvas:
    """An image that MuJoCo draws into. Close it: its context belongs to the thread that made it."""

    def __init__(self, width_px: int, height_px: int) -> None:
        """Open a context of that size; raises what `open_context` raises."""
        self._context = open_context(width_px, height_px)
        import mujoco

        self._mujoco, self._opengl = mujoco, None
        self._view = mujoco.MjrRect(0, 0, width_px, height_px)
        self._pixels = np.empty((height_px, width_px, 3), dtype=np.uint8)

    def new_scene(self, model: Any) -> Any:
        """An empty scene with the textures of a model, without shadows and reflections."""
        mujoco = self._mujoco
        scene = mujoco.MjvScene(model, MOST_GEOMS)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._opengl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._opengl)
        return scene

    def draw(self, scene: Any) -> NDArray[np.uint8]:
        """Picture of a scene, (height, width, 3)."""
        mujoco = self._mujoco
        self._context.make_current()
        mujoco.mjr_render(self._view, scene, self._opengl)
        mujoco.mjr_readPixels(self._pixels, None, self._view, self._opengl)
        return np.flipud(self._pixels).copy()

    def close(self) -> None:
        """Free the context."""
        if self._opengl is not None:
            self._opengl.free()
        self._context.free()


class PosedRobot:
    """The MuJoCo model of a robot and its state, in given poses."""

    def __init__(self, robot: Robot, floor_quaternion: FloatArray) -> None:
        """Make the model, on a floor of an orientation (w, x, y, z)."""
        import mujoco

        self._mujoco = mujoco
        spec = mujoco.MjSpec.from_string(mjcf_of(robot))
        spec.geom("floor").quat = floor_quaternion
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._legs = _Legs(self.model)

    def place(
        self,
        position_m: FloatArray,
        quaternion: FloatArray,
        joints_rad: FloatArray,
        conditions: NDArray[np.int64],
    ) -> None:
        """Put the robot at a pose with joints, (18,), and the colours of conditions of its legs, (6,)."""
        mujoco, qpos = self._mujoco, self.data.qpos
        qpos[:3], qpos[3:7], qpos[7:] = position_m, quaternion, joints_rad
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self._legs.paint(conditions)


class RobotRenderer:
    """Draws a robot in given poses. Close it: the context belongs to the thread that made it."""

    def __init__(
        self, robot: Robot, floor_quaternion: FloatArray, camera: str, width_px: int, height_px: int
    ) -> None:
        """Make model, scene and context; raises what `open_context` raises."""
        self._canvas = Canvas(width_px, height_px)
        import mujoco

        self._mujoco, self.posed = mujoco, PosedRobot(robot, floor_quaternion)
        self.model, self.data = self.posed.model, self.posed.data
        self._scene = self._canvas.new_scene(self.model)
        self._look, self._camera = mujoco.MjvOption(), mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = self.model.camera(camera).id

    def picture(self, add: Callable[[Any], None] = lambda _: None) -> NDArray[np.uint8]:
        """Picture of the robot where it was placed, (height, width, 3); `add` adds to its scene."""
        mujoco = self._mujoco
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self.model, self.data, self._look, None, self._camera, everything, self._scene)
        add(self._scene)
        return self._canvas.draw(self._scene)

    def close(self) -> None:
        """Free the context."""
        self._canvas.close()


class RunRenderer(RobotRenderer):
    """Draws ticks of a trial. Close it: the context belongs to the thread that made it."""

    def __init__(self, trial: RecordedTrial, camera: str, width_px: int, height_px: int) -> None:
        """Make model, scene and context; raises what `open_context` raises."""
        super().__init__(trial.robot, trial.floor_quaternion, camera, width_px, height_px)
        self._trial, self._trail_world = trial, _trail_world(trial)
        self._positions_m, self._quaternions = positions_m(trial), quaternions(trial)

    def place(self, row: int) -> None:
        """Put the robot at its pose of a tick, with its leg colours."""
        joints_rad, conditions = self._trial.measured_rad[row], self._trial.leg_conditions[row]
        self.posed.place(self._positions_m[row], self._quaternions[row], joints_rad, conditions)

    def draw(self, row: int) -> NDArray[np.uint8]:
        """Picture of a tick, (height, width, 3), with the line of travel and the trail."""
        self.place(row)
        foot_m, course = self._trial.robot.foot_radius_m, self._trial.course_world

        def add(scene: Any) -> None:
            if course is not None:
                add_line(scene, course[0], course[1], foot_m / 2, LINE_COLOR)
            add_trail(scene, self._trail_world[: row // PIECE_TICKS + 1], foot_m / 2)

        return self.picture(add)


def add_trail(scene: Any, trail_m: FloatArray, radius_m: float) -> None:
    """Add the last pieces of a trail through points of the world, (N, 3), except NaN, to a scene."""
    for begin, end in pairwise(trail_m[-MOST_PIECES:]):
        if np.isfinite([begin, end]).all():
            add_line(scene, begin, end, radius_m, TRAIL_COLOR)


def add_line(scene: Any, begin: FloatArray, end: FloatArray, radius_m: float, color: Color) -> None:
    """Add a line between two points of the world to a scene, unless it is full."""
    import mujoco

    geom = add_geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, color)
    if geom is not None:
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, radius_m, begin, end)


def add_box(scene: Any, low_m: Sequence[float], high_m: Sequence[float], color: Color) -> None:
    """Add a box along the axes of the world, between two corners, to a scene, unless it is full."""
    import mujoco

    low, high = np.asarray(low_m, dtype=float), np.asarray(high_m, dtype=float)
    add_geom(scene, mujoco.mjtGeom.mjGEOM_BOX, color, (high - low) / 2, (low + high) / 2)


def add_geom(
    scene: Any,
    kind: Any,
    color: Color,
    size_m: FloatArray | None = None,
    at_m: FloatArray | None = None,
    axes: FloatArray | None = None,
) -> Any:
    """Add a solid (`mjtGeom`, half sizes, axes as columns) to a scene and return it; None if full."""
    import mujoco

    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*(part / 255 for part in color), 1.0], dtype=np.float32)
    size_m, at_m = (np.zeros(3) if given is None else given for given in (size_m, at_m))
    mujoco.mjv_initGeom(geom, kind, size_m, at_m, (np.eye(3) if axes is None else axes).ravel(), rgba)
    geom.size[:] = size_m  # capsules and cylinders differ from a model
    scene.ngeom += 1
    return geom


class _Legs:
    def __init__(self, model: Any) -> None:
        self._model = model
        self._materials, self._colors = model.geom_matid.copy(), model.geom_rgba.copy()
        links = [model.body(name).id for name in JOINT_LINKS]
        self._geoms = [np.flatnonzero(model.geom_bodyid == link) for link in links]

    def paint(self, conditions: NDArray[np.int64]) -> None:
        model = self._model
        model.geom_matid[:], model.geom_rgba[:] = self._materials, self._colors
        for leg in range(N_LEGS):
            look = LEG_LOOKS.get(LEG_CONDITIONS[conditions[leg]])
            if look is None:
                continue
            colors, opacity = look
            for index, kind in enumerate(JOINT_KINDS):
                geoms = self._geoms[JOINTS_PER_LEG * leg + index]
                model.geom_matid[geoms] = -1
                model.geom_rgba[geoms] = [*(part / 255 for part in colors[kind]), opacity]


def _trail_world(trial: RecordedTrial) -> FloatArray:
    """Path of the body in pieces, (N, 3), NaN before its walk, just above the line of travel."""
    at = np.arange(0, len(trial), PIECE_TICKS)
    way = trial.base_position_world[at]
    way[trial.walk_s[at] <= 0] = np.nan
    if trial.course_world is None:
        return np.full_like(way, np.nan)
    normal_world = trial.floor_normal_world
    way[:, 2] -= (way - trial.course_world[0]) @ normal_world / normal_world[2]
    way[:, 2] += trial.robot.foot_radius_m / 4
    return way


def positions_m(trial: RecordedTrial) -> FloatArray:
    """Positions of the base, (T, 3); unknown ones are the last known one, or above the origin."""
    found_m = trial.base_position_world.copy()
    known = trial.posed
    if not known.any():
        found_m[:] = (0.0, 0.0, trial.robot.standing_height_m)
        return found_m
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), int(known.argmax())))
    return np.asarray(found_m[last])


def quaternions(trial: RecordedTrial) -> FloatArray:
    """Orientations of the base as w, x, y, z, (T, 4): the last known one, else level and straight ahead."""
    found = filled(trial.base_quaternion_world).copy()
    found[~np.isfinite(found).all(axis=-1)] = (1.0, 0.0, 0.0, 0.0)
    return np.asarray(found)
