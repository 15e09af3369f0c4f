"""A robot in viser's scene: parts of one kind are instances of one mesh, which keeps the scene light.

The scene has no shadow maps, which cost three times the rest without a graphics card. Shadows are flat shapes
on the floor below the links.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hexctl.backends.sim.terrain import Floor
from hexctl.browser.floor_scene import heights_in_plane
from hexctl.browser.robot_parts import (
    Shape,
    foot_shape,
    leg_poses,
    link_shape,
    nose_shape,
    trunk_shape,
)
from hexctl.errors import InputError
from hexctl.palette import BODY_COLOR, FAILED_COLORS, LINK_COLORS, NOTICED_COLORS, Color
from hexctl.robot.failure import Failure
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot
from hexctl.robot.rotations import frame_of, matrix_of
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS, BoolArray, FloatArray, RobotState

#: Feet on the floor, in the air, and without a known contact.
TOUCHING_COLOR, LIFTED_COLOR, UNFELT_COLOR = (64, 220, 120), (96, 108, 124), (206, 212, 220)

NOSE_COLOR: Color = (240, 240, 240)
SHADOW_COLOR: Color = (10, 12, 16)

#: Opacity of shadows, of a missing leg, and of the grey robot.
SHADOW_OPACITY, MISSING_OPACITY, GREY_OPACITY = 0.45, 0.12, 0.55

#: Colour of all parts of the grey robot.
GREY: Color = (150, 150, 156)

#: Height of shadows over the floor.
SHADOW_HEIGHT_M = 0.002

#: A square of 1 m on the floor.
_SQUARE = Shape(
    np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)

#: Called with the leg, 1..6, and the kind of the joint that was clicked.
OnClick = Callable[[int, str], object]


class RobotScene:
    """Draws a robot below a node of viser's scene.

    Args:
        scene: viser's, whose node `name` is made.
        floor: of the world, on which shadows fall.
        grey: whether all of it is grey, and lets the other robot be seen through it.
        on_click: called from viser's threads.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        robot: Robot,
        meshes: Meshes,
        floor: Floor,
        *,
        grey: bool = False,
        on_click: OnClick | None = None,
    ) -> None:
        self._robot, self._floor, self._grey = robot, floor, grey
        self._offset_m = np.zeros(3)
        plain: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False}
        if grey:
            plain["opacity"] = GREY_OPACITY
        self._root = scene.add_frame(name, show_axes=False)
        base = f"{name}/base"
        self._base = scene.add_frame(base, show_axes=False)
        trunk, nose = trunk_shape(robot, meshes.get("body")), nose_shape(robot)
        color: Color = GREY if grey else BODY_COLOR
        scene.add_mesh_simple(f"{base}/body", trunk.vertices_m, trunk.triangles, color=color, **plain)
        scene.add_mesh_simple(f"{base}/front", nose.vertices_m, nose.triangles, color=NOSE_COLOR, **plain)

        def instances(path: str, shape: Shape, count: int, color: Color, **more: Any) -> Any:
            return scene.add_batched_meshes_simple(
                path,
                shape.vertices_m.astype(np.float32),
                shape.triangles,
                np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
                np.zeros((count, 3)),
                batched_colors=np.tile(np.array(color, np.uint8), (count, 1)),
                **{"lod": "off", **plain, **more},
            )

        self._links = []
        for link, kind in enumerate(JOINT_KINDS):
            mesh = meshes.get(kind)
            color = GREY if grey else LINK_COLORS[kind]
            lod = "off" if mesh is None else "auto"
            handle = instances(f"{base}/{kind}", link_shape(robot, link, mesh), N_LEGS, color, lod=lod)
            if on_click is not None:
                handle.on_click(_clicked(on_click, kind))
            self._links.append(handle)
        self._feet = instances(f"{base}/feet", foot_shape(robot), N_LEGS, GREY if grey else UNFELT_COLOR)
        if on_click is not None:
            self._feet.on_click(_clicked(on_click, JOINT_KINDS[-1]))
        self._shadows = instances(
            f"{name}/shadows",
            _SQUARE,
            1 + N_LEGS * JOINTS_PER_LEG,
            SHADOW_COLOR,
            opacity=SHADOW_OPACITY,
            wxyz=floor.quaternion_world,
            batched_scales=self._shadow_scales(np.ones((N_LEGS, JOINTS_PER_LEG))),
        )
        self._contacts: list[int] | None = None

    def remove(self) -> None:
        """Take the robot out of the scene."""
        self._root.remove()

    def place(self, offset_m: FloatArray) -> None:
        """Draw the robot aside from where it is, by (3,) in m of the world."""
        self._offset_m = np.asarray(offset_m, dtype=float)
        self._root.position = self._offset_m

    def show(self, state: RobotState) -> None:
        """Draw a state whose pose of the body is known."""
        position_m, quaternion = state.base_position_world, state.base_quaternion_world
        if position_m is None or quaternion is None:
            raise InputError("scene: got a state without a pose; allowed: with position and orientation")
        poses = leg_poses(self._robot, state.joint_positions_rad)
        self._base.position, self._base.wxyz = position_m, quaternion
        for link, handle in enumerate(self._links):
            handle.batched_positions = poses.joints_m[:, link]
            handle.batched_wxyzs = poses.quaternions[:, link]
        self._feet.batched_positions = poses.feet_m
        self._show_contacts(state.foot_contacts)
        points_m = np.concatenate([poses.joints_m, poses.feet_m[:, np.newaxis]], axis=1)
        self._show_shadows(points_m, frame_of(position_m, quaternion))

    def color(self, failed: Mapping[int, Failure], noticed: Mapping[int, Failure]) -> None:
        """Colour failed legs red, and those that only the walk thinks failed amber; missing ones fade."""
        for link, (kind, handle) in enumerate(zip(JOINT_KINDS, self._links, strict=True)):
            colors = [
                self._color_of(leg, link, kind, failed.get(leg), noticed.get(leg))
                for leg in range(1, N_LEGS + 1)
            ]
            handle.batched_colors = np.array(colors, np.uint8)

        missing = [leg in failed and failed[leg].kind == "missing" for leg in range(1, N_LEGS + 1)]
        opacities = np.where(missing, MISSING_OPACITY, 1.0).astype(np.float32) if any(missing) else None
        for handle in (*self._links, self._feet):
            handle.batched_opacities = opacities

    def _color_of(
        self, leg: int, link: int, kind: str, failed: Failure | None, noticed: Failure | None
    ) -> Color:
        joint = JOINTS_PER_LEG * (leg - 1) + link
        for failure, colors in ((failed, FAILED_COLORS), (noticed, NOTICED_COLORS)):
            if failure is not None and joint in failure.joints:
                return colors[kind]
        return GREY if self._grey else LINK_COLORS[kind]

    def _show_contacts(self, contacts: BoolArray | None) -> None:
        felt = None if contacts is None else contacts.tolist()
        if felt == self._contacts or self._grey:
            return
        self._contacts = felt
        colors = [UNFELT_COLOR] * N_LEGS
        if felt is not None:
            colors = [TOUCHING_COLOR if one else LIFTED_COLOR for one in felt]
        self._feet.batched_colors = np.array(colors, np.uint8)

    def _show_shadows(self, points_body: FloatArray, frame: FloatArray) -> None:
        """Rectangles on the floor below links, from joint to joint (6, 4, 3), and below the trunk."""
        plane = matrix_of(self._floor.quaternion_world)
        points = (points_body @ frame[:3, :3].T + frame[:3, 3] + self._offset_m) @ plane
        starts, ends = points[:, :-1, :2], points[:, 1:, :2]
        along = (ends - starts).reshape(-1, 2)
        trunk, ahead = (frame[:3, 3] + self._offset_m) @ plane, frame[:3, 0] @ plane
        middles = np.concatenate([[trunk[:2]], ((starts + ends) / 2).reshape(-1, 2)])
        half_yaws = np.arctan2([ahead[1], *along[:, 1]], [ahead[0], *along[:, 0]]) / 2
        flat = np.zeros((len(middles), 4))
        flat[:, 0], flat[:, 3] = np.cos(half_yaws), np.sin(half_yaws)
        heights_m = heights_in_plane(self._floor, middles) + SHADOW_HEIGHT_M
        self._shadows.batched_positions = np.column_stack([middles, heights_m]) - self._offset_m @ plane
        self._shadows.batched_wxyzs = flat
        lengths_m = np.hypot(along[:, 0], along[:, 1]).reshape(N_LEGS, JOINTS_PER_LEG)
        self._shadows.batched_scales = self._shadow_scales(lengths_m)

    def _shadow_scales(self, lengths_m: FloatArray) -> FloatArray:
        length, width, _ = self._robot.body.size_m
        scales = np.ones((1 + N_LEGS * JOINTS_PER_LEG, 3))
        scales[0, :2] = length, width if self._robot.body.shape == "box" else length
        radii_m = np.tile(self._robot.link_radii_m, N_LEGS)
        scales[1:, 0] = lengths_m.ravel() + 2 * radii_m
        scales[1:, 1] = 2 * radii_m
        return scales


def _clicked(on_click: OnClick, kind: str) -> Callable[[Any], None]:
    def clicked(event: Any) -> None:
        if event.instance_index is not None:
            on_click(event.instance_index + 1, kind)

    return clicked
