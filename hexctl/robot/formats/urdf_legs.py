"""Legs of a URDF, recognised by the geometry of its joints and not by their names."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.errors import InputError, argument
from hexctl.robot.formats.urdf_tree import UrdfJoint, UrdfTree
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS, ArrayFields, FloatArray

#: Tolerance of axes: files write 1.5707, and mounts lean a little.
AXIS_TOLERANCE_RAD = math.radians(3.0)
#: Shorter coxae do not show the direction of a leg.
SHORTEST_COXA_M = 0.005
#: Tolerance of a foot next to the plane of its leg, and of differences between legs.
PLANE_TOLERANCE_M, LEG_TOLERANCE_M = 0.006, 0.006


@dataclass(frozen=True, slots=True, eq=False)
class UrdfLeg(ArrayFields):
    """A leg in the frame of the body, in hexctl's terms.

    Attributes:
        tips: the tibia and the links that are fixed to it.
        mount_m: coxa axis, (3,).
        yaw_rad: direction of the leg at angle zero.
        vectors_m: coxa, femur and tibia as (outward, up) at angle zero, (3, 2).
        signs: 1 if the angles of the file and of hexctl have the same sign, -1 if not, (3,).
    """

    joints: tuple[UrdfJoint, ...]
    tips: tuple[str, ...]
    mount_m: FloatArray
    yaw_rad: float
    vectors_m: FloatArray
    signs: FloatArray
    foot_known: bool

    @property
    def azimuth_rad(self) -> float:
        """Direction of its mount, or of the leg if the mount is on the body's axis."""
        x, y = self.mount_m[:2].tolist()
        return math.atan2(y, x) if math.hypot(x, y) > 1e-3 else self.yaw_rad


def find_legs(tree: UrdfTree, facing: FloatArray, foot_m: FloatArray | None) -> list[UrdfLeg]:
    """Legs of a robot, counter-clockwise from the front left, or from the one that points ahead.

    Args:
        facing: transform from the frame of the root to that of the body, x forward and z up, (4, 4).
        foot_m: position of the feet in the frames of the last links, (3,); None takes it from the file.

    Raises InputError for anything that differs from six such legs.
    """
    chains = _chains(tree)
    legs = [_leg(tree, chain, facing, foot_m) for chain in chains]
    start_rad = -math.radians(1.0)
    return sorted(legs, key=lambda leg: (leg.azimuth_rad - start_rad) % math.tau)


def _chains(tree: UrdfTree) -> list[tuple[UrdfJoint, ...]]:
    found: dict[tuple[str, ...], tuple[UrdfJoint, ...]] = {}
    for link in tree.links:
        if link not in tree.children:
            chain = tree.hinges(link)
            found[tuple(joint.name for joint in chain)] = chain
    chains = [
        chain
        for names, chain in found.items()
        if not any(other[: len(names)] == names for other in found if other != names)
    ]
    legs = [chain for chain in chains if len(chain) == JOINTS_PER_LEG]
    longer = next((chain for chain in chains if len(chain) > JOINTS_PER_LEG), None)
    if longer is not None:
        raise InputError(
            f"urdf: got a chain of {len(longer)} hinges from {longer[0].name} to {longer[-1].name}; "
            f"allowed: legs of {JOINTS_PER_LEG}"
        )
    if len(legs) != N_LEGS:
        raise InputError(f"urdf: got {len(legs)} chains of {JOINTS_PER_LEG} hinges; allowed: {N_LEGS} legs")
    if len({chain[0].name for chain in legs}) != N_LEGS:
        raise InputError(f"urdf: got legs that share the hinge {legs[0][0].name}; allowed: legs of their own")
    return legs


def _leg(
    tree: UrdfTree, chain: tuple[UrdfJoint, ...], facing: FloatArray, foot_m: FloatArray | None
) -> UrdfLeg:
    frames = [facing @ tree.placed(joint.child) for joint in chain]
    axes = [frame[:3, :3] @ joint.axis for frame, joint in zip(frames, chain, strict=True)]
    origins_m = [frame[:3, 3] for frame in frames]
    _check_axes(chain, axes)
    tips = tree.rigid(chain[-1].child)
    tip_m, known = _foot(tree, tips, chain, foot_m)
    foot = (frames[-1] @ [*tip_m, 1.0])[:3]
    level = axes[1] * [1, 1, 0] / np.linalg.norm(axes[1][:2])
    outward = np.cross(level, [0.0, 0.0, 1.0])
    along_m = float((origins_m[1] - origins_m[0]) @ outward)
    if abs(along_m) < SHORTEST_COXA_M:
        # Femur joints above the coxa axis: the foot shows the direction of the leg.
        along_m = float((foot - origins_m[0]) @ outward)
    outward *= math.copysign(1.0, along_m)
    beside_m = float((foot - origins_m[0]) @ np.cross([0.0, 0.0, 1.0], outward))
    if abs(beside_m) > PLANE_TOLERANCE_M:
        raise InputError(
            f"urdf: the foot of the leg of {chain[0].name} is {1000 * abs(beside_m):.0f} mm beside the plane "
            f"of its leg; allowed: {1000 * PLANE_TOLERANCE_M:g} mm"
        )
    points = np.array([*origins_m, foot])
    plane = np.column_stack([points @ outward, points[:, 2]])
    lifting = np.cross(outward, [0.0, 0.0, 1.0])  # the turn that lifts what points outward
    signs = [np.sign(axes[0][2]), np.sign(axes[1] @ lifting), np.sign(axes[2] @ lifting)]
    return UrdfLeg(
        joints=chain,
        tips=tuple(tips),
        mount_m=origins_m[0],
        yaw_rad=math.atan2(outward[1], outward[0]),
        vectors_m=np.diff(plane, axis=0),
        signs=np.array(signs),
        foot_known=known,
    )


def _check_axes(chain: tuple[UrdfJoint, ...], axes: list[FloatArray]) -> None:
    """Refuse a chain that is no leg: a vertical hinge, then two level and parallel ones."""
    off = math.sin(AXIS_TOLERANCE_RAD)
    if np.linalg.norm(axes[0][:2]) > off:
        raise InputError(
            f"urdf: the first hinge of a leg, {chain[0].name}, turns about {_shown(axes[0])} of the body; "
            "allowed: the vertical (of a root whose z axis points up)"
        )
    for joint, axis in zip(chain[1:], axes[1:], strict=True):
        if abs(axis[2]) > off:
            raise InputError(
                f"urdf: the hinge {joint.name} turns about {_shown(axis)}; allowed: a level axis"
            )
    if np.linalg.norm(np.cross(axes[1], axes[2])) > off:
        raise InputError(
            f"urdf: the hinges {chain[1].name} and {chain[2].name} turn about {_shown(axes[1])} and "
            f"{_shown(axes[2])}; allowed: parallel axes"
        )


def _foot(
    tree: UrdfTree, tips: list[str], chain: tuple[UrdfJoint, ...], foot_m: FloatArray | None
) -> tuple[FloatArray, bool]:
    """Foot in the frame of the tibia, and whether it is known or estimated from the centre of mass."""
    if foot_m is not None:
        return foot_m, True
    knee = np.linalg.inv(tree.placed(tips[0]))
    leaves = [name for name in tips[1:] if name not in tree.children]
    points = [(knee @ tree.placed(name))[:3, 3] for name in leaves]
    if not points or max(np.linalg.norm(point) for point in points) < 0.01:
        points = [corner for shape in tree.links[tips[0]].shapes for corner in shape.corners]
    if points:
        return max(points, key=lambda point: float(np.linalg.norm(point))), True
    com_m = tree.links[tips[0]].com_m
    if np.linalg.norm(com_m) < 0.005:
        raise InputError(
            f"urdf: nothing tells where the foot of the leg of {chain[0].name} is; "
            f"allowed: {argument('foot_m')} with its place in the frame of {tips[0]} in m"
        )
    return 2 * com_m, False


def _shown(axis: FloatArray) -> str:
    return f"({', '.join(f'{part:.2f}' for part in axis)})"


def check_alike(legs: list[UrdfLeg]) -> None:
    """Raise InputError for legs with different link lengths, or different poses at angle zero."""
    lengths_m = np.array([np.linalg.norm(leg.vectors_m, axis=-1) for leg in legs])
    for index, kind in enumerate(JOINT_KINDS):
        spread_m = float(np.ptp(lengths_m[:, index]))
        if spread_m > LEG_TOLERANCE_M:
            raise InputError(
                f"urdf: the {kind} links of the legs differ by {1000 * spread_m:.0f} mm; "
                f"allowed: {1000 * LEG_TOLERANCE_M:g} mm"
            )
    off_m = np.abs(np.array([leg.vectors_m for leg in legs]) - legs[0].vectors_m).max(axis=(1, 2))
    if off_m.max() > LEG_TOLERANCE_M:
        other = int(off_m.argmax()) + 1
        raise InputError(
            f"urdf: legs 1 and {other} point in other directions at angle zero "
            f"({1000 * off_m.max():.0f} mm apart); allowed: legs with one zero"
        )
