"""Frames of a robot's links: their names in URDF and ROS, and their poses on their parents.

`base_link` is the body frame. The frames of coxa, femur and tibia are at their joints, x along the leg and z
up at joint angle zero; the foot frame is at the centre of the foot sphere.
"""

from dataclasses import dataclass

import numpy as np

from hexctl.robot.model import Robot
from hexctl.robot.rotations import xyzw
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, N_LEGS, ArrayFields, FloatArray

#: The body frame, and the link with the trunk's mass: dynamics libraries refuse inertia in a root link.
BASE_LINK, TRUNK_LINK = "base_link", "trunk"

#: Links that joints move, in the order of joint arrays, and their parents.
JOINT_LINKS = tuple(f"leg{leg}_{kind}_link" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS)
JOINT_PARENTS = tuple(
    BASE_LINK if index % JOINTS_PER_LEG == 0 else JOINT_LINKS[index - 1] for index in range(N_JOINTS)
)
#: Frames at the centres of the feet.
FOOT_LINKS = tuple(f"leg{leg}_foot" for leg in range(1, N_LEGS + 1))


@dataclass(frozen=True, slots=True, eq=False)
class LinkTransforms(ArrayFields):
    """Poses of N links in the frames of their parents.

    Origins are in m, (N, 3), and orientations (w, x, y, z), leading shape + (N, 4).
    """

    parents: tuple[str, ...]
    children: tuple[str, ...]
    translations_m: FloatArray
    quaternions: FloatArray

    @property
    def frames(self) -> tuple[tuple[str, str], ...]:
        """Parent and child of each link."""
        return tuple(zip(self.parents, self.children, strict=True))

    @property
    def numbers(self) -> FloatArray:
        """Rows of x, y, z and quaternion (x, y, z, w) as in ROS, leading shape + (7 N,)."""
        turns = xyzw(self.quaternions)
        rows = [np.broadcast_to(self.translations_m, (*turns.shape[:-1], 3)), turns]
        return np.concatenate(rows, axis=-1).reshape(*turns.shape[:-2], -1)


def link_transforms(robot: Robot, joint_positions_rad: FloatArray) -> LinkTransforms:
    """Transforms of the 18 links that joints move, for `tf`, at joint angles of leading shape + (18,)."""
    half_rad = (joint_positions_rad + _zero_yaws(robot)) / 2
    quaternions = np.zeros((*half_rad.shape, 4))
    quaternions[..., 0] = np.cos(half_rad)
    # A coxa turns about z, femur and tibia about -y: a negative turn about y lifts what points along x.
    coxae = slice(None, None, JOINTS_PER_LEG)
    quaternions[..., coxae, 3] = np.sin(half_rad[..., coxae])
    for index in (1, 2):
        joints = slice(index, None, JOINTS_PER_LEG)
        quaternions[..., joints, 2] = -np.sin(half_rad[..., joints])
    return LinkTransforms(JOINT_PARENTS, JOINT_LINKS, _origins(robot), quaternions)


def fixed_transforms(robot: Robot) -> LinkTransforms:
    """Transforms of the links that nothing moves, trunk and feet, for `tf_static`."""
    outward_m, up_m = robot.link_vectors_m[-1]
    tibiae = JOINT_LINKS[JOINTS_PER_LEG - 1 :: JOINTS_PER_LEG]
    translations_m = np.array([[0.0, 0.0, 0.0], *([[outward_m, 0.0, up_m]] * N_LEGS)])
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (1 + N_LEGS, 1))
    return LinkTransforms((BASE_LINK, *tibiae), (TRUNK_LINK, *FOOT_LINKS), translations_m, quaternions)


def _zero_yaws(robot: Robot) -> FloatArray:
    """Yaws of the mounts in the places of the coxae, (18,)."""
    yaws_rad = np.zeros(N_JOINTS)
    yaws_rad[::JOINTS_PER_LEG] = robot.mount_yaws_rad
    return yaws_rad


def _origins(robot: Robot) -> FloatArray:
    """Origins of the 18 moving links in the frames of their parents, (18, 3)."""
    origins_m = np.zeros((N_LEGS, JOINTS_PER_LEG, 3))
    origins_m[:, 0] = robot.mount_positions_body
    origins_m[:, 1:, 0] = robot.link_vectors_m[:-1, 0]
    origins_m[:, 1:, 2] = robot.link_vectors_m[:-1, 1]
    return origins_m.reshape(N_JOINTS, 3)
