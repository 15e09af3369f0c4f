"""Legs of a robot description, recognised by the geometry of its joints and not by their names."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from hexctl.errors import InputError, argument
from hexctl.robot.formats.importing.import_values import rounded
from hexctl.robot.formats.importing.leg_chains import (
    FOOT_TOLERANCE_M,
    LEG_TOLERANCE,
    axis_problem,
    leg_chains,
)
from hexctl.robot.formats.importing.link_tree import LinkTree, TreeJoint
from hexctl.robot.rotations import transformed_points
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, ArrayFields, FloatArray

#: Shorter coxae do not show the direction of a leg.
SHORTEST_COXA_M = 0.005
#: Distance of a foot from the plane of its leg: ignored up to this share of the leg, projected up to that.
PLANE_TOLERANCE, MOST_FOOT_OFFSET_M = 0.025, 0.06
#: A frame or the centre of a sphere this near to the far end of the tibia is the foot, as a share of it.
FOOT_TOLERANCE_SHARE = 0.08
#: Lengths of a tibia as shares of coxa and femur together; shorter and longer ones are no tibiae.
TIBIA_SHARES = (0.25, 8.0)
#: Coxae keep the zeros of the file if the legs have the first share of their ranges in common, and the second
#: one on each side.
LEAST_SHARED, LEAST_AROUND = 0.6, 0.1
#: Length of a tibia of which nothing is known, as a multiple of the femur: the median of the shipped robots.
USUAL_TIBIA = 1.6


@dataclass(frozen=True, slots=True, eq=False)
class TreeLeg(ArrayFields):
    """A leg in hexctl's terms.

    Attributes:
        tips: the tibia and the links fixed to it.
        mount_m: coxa axis, in axes of the body from the root, (3,).
        yaw_rad: direction of the leg at angle zero.
        vectors_m: coxa, femur and tibia as (outward, up) at angle zero, (3, 2).
        signs: 1 if the angles of the file and of hexctl have the same sign, -1 if not, (3,).
        zeros_rad: hexctl's angles at the zeros of the file, (3,).
        foot_m: the foot at angle zero, in axes of the body from the root, (3,).
        foot_offset_m: distance of the foot to the left of the plane of the leg.
        foot_guess: why the foot is a guess, or empty if the file shows it.
    """

    joints: tuple[TreeJoint, ...]
    tips: tuple[str, ...]
    mount_m: FloatArray
    yaw_rad: float
    vectors_m: FloatArray
    signs: FloatArray
    zeros_rad: FloatArray
    foot_m: FloatArray
    foot_offset_m: float
    foot_guess: str


def find_legs(tree: LinkTree, facing: FloatArray, foot_m: FloatArray | None) -> list[TreeLeg]:
    """Legs of a robot, counter-clockwise from the front left, or from the one that points ahead.

    Args:
        facing: transform from the frame of the root to axes of the body, x forward and z up, (4, 4).
        foot_m: position of the feet in the frames of the last links, (3,); None takes it from the file.

    Raises InputError for anything that differs from six such legs.
    """
    legs = [_leg(tree, chain, facing, foot_m) for chain in leg_chains(tree)]
    centre_m = np.mean([leg.mount_m for leg in legs], axis=0)
    start_rad = -math.radians(1.0)
    return sorted(legs, key=lambda leg: (_azimuth_rad(leg, centre_m) - start_rad) % math.tau)


def _azimuth_rad(leg: TreeLeg, centre_m: FloatArray) -> float:
    """Direction of its mount from the centre, or of the leg if its mount is there."""
    x, y = (leg.mount_m - centre_m)[:2].tolist()
    return math.atan2(y, x) if math.hypot(x, y) > 1e-3 else leg.yaw_rad


def _leg(
    tree: LinkTree, chain: tuple[TreeJoint, ...], facing: FloatArray, foot_m: FloatArray | None
) -> TreeLeg:
    frames = [facing @ tree.frame_in_root(joint.child) for joint in chain]
    axes = [frame[:3, :3] @ joint.axis for frame, joint in zip(frames, chain, strict=True)]
    origins_m = [frame[:3, 3] for frame in frames]
    if problem := axis_problem(chain, axes, up=np.array([0.0, 0.0, 1.0])):
        raise InputError(f"robot description: {problem}")
    # Joints beyond the tibia move no foot, or let it turn on the floor.
    tips = tree.carried(chain[-1].child)
    tip_m, guess = (foot_m, "") if foot_m is not None else _foot(tree, tips, frames, axes[2])
    if foot_m is not None:
        _check_foot(foot_m, frames)
    foot = (frames[-1] @ [*tip_m, 1.0])[:3]
    level = axes[1] * [1, 1, 0] / np.linalg.norm(axes[1][:2])
    outward = np.cross(level, [0.0, 0.0, 1.0])
    along_m = float((origins_m[1] - origins_m[0]) @ outward)
    if abs(along_m) < SHORTEST_COXA_M:
        # Femur joints above the coxa axis: the foot shows the direction of the leg.
        along_m = float((foot - origins_m[0]) @ outward)
    outward *= math.copysign(1.0, along_m)
    foot_offset_m = float((foot - origins_m[0]) @ np.cross([0.0, 0.0, 1.0], outward))
    if abs(foot_offset_m) > MOST_FOOT_OFFSET_M:
        raise InputError(
            f"robot description: the foot of the leg of {chain[0].name} is {1000 * abs(foot_offset_m):.0f} "
            f"mm outside the plane of its leg; allowed: {1000 * MOST_FOOT_OFFSET_M:g} mm"
        )
    points = np.array([*origins_m, foot])
    plane = np.column_stack([points @ outward, points[:, 2]])
    lifting = np.cross(outward, [0.0, 0.0, 1.0])  # the turn that lifts what points outward
    signs = [np.sign(axes[0][2]), np.sign(axes[1] @ lifting), np.sign(axes[2] @ lifting)]
    return TreeLeg(
        joints=chain,
        tips=tuple(tips),
        mount_m=origins_m[0],
        yaw_rad=math.atan2(round(outward[1], 12) + 0.0, outward[0]),  # 180 degrees, never -180
        vectors_m=np.diff(plane, axis=0),
        signs=np.array(signs),
        zeros_rad=np.zeros(JOINTS_PER_LEG),
        foot_m=foot,
        foot_offset_m=foot_offset_m,
        foot_guess=guess,
    )


def _foot(
    tree: LinkTree, tips: list[str], frames: list[FloatArray], axis: FloatArray
) -> tuple[FloatArray, str]:
    """Foot in the frame of the tibia, and why it is a guess, or an empty text.

    It is the far end of everything fixed to the tibia. A frame or the centre of a sphere next to that end
    counts before the end itself. The frames are those of the three links and the axis (3,) that of the last
    hinge, in axes of the body.
    """
    knee = np.asarray(np.linalg.inv(tree.frame_in_root(tips[0])), dtype=float)
    foot_m, marked = _far_end(tree, tips, knee)
    far_m = _length_m(foot_m)
    least_m, most_m = _tibia_bounds_m(frames)
    unread = tree.unread_meshes(tips)
    seen = f"its parts end {far_m:.3g} m from the knee" if far_m > 0 else "no frame or solid shows it"
    if unread:
        seen += f"; not read: {', '.join(unread)}"
    if least_m < far_m < most_m:
        return foot_m, "" if marked or not unread else seen
    com_m = tree.links[tips[0]].com_m
    if least_m < 2 * np.linalg.norm(com_m) < most_m:
        return 2 * com_m, f"{seen}; taken as twice as far as the centre of mass"
    guess_m = _usual_foot(frames, axis)
    return guess_m, f"{seen}; a usual length is assumed; --foot gives the real place"


def _check_foot(foot_m: FloatArray, frames: list[FloatArray]) -> None:
    (least_m, most_m), far_m = _tibia_bounds_m(frames), _length_m(foot_m)
    if not least_m < far_m < most_m:
        raise InputError(
            f"{argument('foot')}: got a foot {far_m:.3g} m from the knee; allowed: {least_m:.2g} to "
            f"{most_m:.2g} m, by the length of coxa and femur"
        )


def _tibia_bounds_m(frames: list[FloatArray]) -> tuple[float, float]:
    """Minimum and maximum length of a tibia, by the frames of the three links."""
    upper_m = sum(_length_m(end[:3, 3] - start[:3, 3]) for start, end in pairwise(frames))
    return TIBIA_SHARES[0] * upper_m, TIBIA_SHARES[1] * upper_m


def _far_end(tree: LinkTree, tips: list[str], knee: FloatArray) -> tuple[FloatArray, bool]:
    """Foot at the far end of the parts of a tibia, (3,) in its frame, and whether a frame marks it."""
    frames = {name: knee @ tree.frame_in_root(name) for name in tips}
    marks = [frames[name][:3, 3] for name in tips[1:] if name not in tree.children]
    spheres: list[tuple[FloatArray, float]] = []
    ends = list(marks)
    for name, frame in frames.items():
        for solid in tree.links[name].solids:
            points = transformed_points(solid.ends, frame)
            ends += list(_outermost(points)) if solid.kind == "mesh" else list(points)
            if solid.kind == "sphere":
                spheres.append((points[0], solid.size_m[0]))
    if not ends:
        return np.zeros(3), False
    end = max(ends, key=_length_m)
    near_m = max(FOOT_TOLERANCE_M, FOOT_TOLERANCE_SHARE * _length_m(end))
    foots = [mark for mark in marks if _length_m(mark - end) < near_m]
    balls = [centre for centre, radius_m in spheres if _length_m(centre - end) < near_m + radius_m]
    foots += balls
    foot = min(foots, key=lambda point: _length_m(point - end), default=end)
    return foot, any(mark is foot for mark in foots[: len(foots) - len(balls)])


def _outermost(points: FloatArray) -> FloatArray:
    """Middle of the mesh points farthest from the knee, (1, 3)."""
    lengths_m = np.linalg.norm(points, axis=-1)
    return np.asarray(points[lengths_m > 0.98 * lengths_m.max()].mean(axis=0, keepdims=True))


def _length_m(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


def _usual_foot(frames: list[FloatArray], axis: FloatArray) -> FloatArray:
    """A foot at a usual distance along that axis of the tibia's frame which points down, (3,) in its frame.

    Among axes in the plane of the leg that do not, it is the one that continues the femur.
    """
    femur = frames[2][:3, 3] - frames[1][:3, 3]
    turn = frames[2][:3, :3]
    directions = [sign * turn[:, index] for index in range(3) for sign in (1, -1)]
    in_plane = [one for one in directions if abs(one @ axis) < math.sin(math.radians(10))] or directions
    best = max(in_plane, key=lambda one: float(-one[2] + 0.5 * one @ femur / max(_length_m(femur), 1e-9)))
    return np.asarray(USUAL_TIBIA * _length_m(femur) * (turn.T @ best))


def with_one_zero(legs: list[TreeLeg]) -> list[TreeLeg]:
    """Legs whose vectors at angle zero are those of the first; their `zeros_rad` hold the differences.

    Raises InputError for legs with different link lengths.
    """
    lengths_m, tolerance_m = _lengths_m(legs), LEG_TOLERANCE * _lengths_m(legs)[0].sum()
    for kind, spread_m in zip(JOINT_KINDS, np.ptp(lengths_m, axis=0).tolist(), strict=True):
        if spread_m > tolerance_m:
            raise InputError(
                f"robot description: the {kind} links of the legs differ by {1000 * spread_m:.2g} mm; "
                f"allowed: {1000 * tolerance_m:.2g} mm"
            )
    return [_turned(leg, legs[0].vectors_m, tolerance_m) for leg in legs]


def _lengths_m(legs: list[TreeLeg]) -> FloatArray:
    """Lengths of coxa, femur and tibia of each leg, (6, 3)."""
    return np.array([np.linalg.norm(leg.vectors_m, axis=-1) for leg in legs])


def with_middle_coxae(legs: list[TreeLeg]) -> list[TreeLeg]:
    """Legs whose coxae have their zero in the middle of their ranges, if the legs share little around theirs.

    Ranges of the left and the right legs may be mirrored, or not contain zero.
    """
    ranges_rad = [_coxa_range_rad(leg) for leg in legs]
    known = [one for one in ranges_rad if one is not None]
    if len(known) < len(legs):
        return legs
    low_rad, high_rad = max(low for low, _ in known), min(high for _, high in known)
    shared_rad, own_rad = high_rad - low_rad, min(high - low for low, high in known)
    around_rad = min(-low_rad, high_rad)
    if shared_rad > LEAST_SHARED * own_rad and around_rad > LEAST_AROUND * own_rad:
        return legs
    return [_with_zero(leg, (low + high) / 2) for leg, (low, high) in zip(legs, known, strict=True)]


def _coxa_range_rad(leg: TreeLeg) -> tuple[float, float] | None:
    joint = leg.joints[0]
    if joint.kind != "revolute" or joint.limits_rad is None:
        return None
    low, high = sorted(float(leg.signs[0]) * end for end in joint.limits_rad)
    return (low, high) if 0 < high - low < math.tau else None


def _with_zero(leg: TreeLeg, angle_rad: float) -> TreeLeg:
    """A leg whose coxa has its zero at an angle."""
    zeros_rad = leg.zeros_rad - np.array([angle_rad, 0.0, 0.0])
    return replace(leg, yaw_rad=leg.yaw_rad + angle_rad, zeros_rad=zeros_rad)


def _turned(leg: TreeLeg, wanted_m: FloatArray, tolerance_m: float) -> TreeLeg:
    """A leg with other zeros of femur and tibia, if its links point elsewhere than those of another leg."""
    if np.abs(leg.vectors_m - wanted_m).max() <= tolerance_m:
        return leg
    if np.abs(leg.vectors_m[0] - wanted_m[0]).max() > tolerance_m:
        raise InputError(
            f"robot description: the coxa of {leg.joints[0].name} ends at another height than that of other "
            f"legs; allowed: a difference of {1000 * tolerance_m:.2g} mm"
        )
    slopes = [np.arctan2(vectors[1:, 1], vectors[1:, 0]) for vectors in (leg.vectors_m, wanted_m)]
    femur_rad, both_rad = (slopes[0] - slopes[1]).tolist()
    zeros_rad = [0.0, math.remainder(femur_rad, math.tau), math.remainder(both_rad - femur_rad, math.tau)]
    lengths_m = np.linalg.norm(leg.vectors_m[1:], axis=-1)
    directions = np.column_stack([np.cos(slopes[1]), np.sin(slopes[1])])
    vectors_m = np.vstack([leg.vectors_m[:1], lengths_m[:, np.newaxis] * directions])
    return replace(leg, vectors_m=vectors_m, zeros_rad=np.array(zeros_rad))


@dataclass(frozen=True, slots=True)
class FootProjection:
    """Feet to the left of the planes of their legs, by leg; exact in a stance if all legs have one size of b.

    A foot at (r, b) of a leg, outward and left, is put at (r + c, 0) of the leg turned by atan2(b, r0), with
    r0 of the stance and r0 + c = hypot(r0, b).

    Attributes:
        offsets_m: b, with the sign of each leg.
        offset_m: size of b, the mean of the legs.
        coxa_end_m: of the file, (outward, up).
        yaws_rad: of the legs in the file.
    """

    offsets_m: tuple[float, ...]
    offset_m: float
    coxa_end_m: tuple[float, float]
    yaws_rad: tuple[float, ...]

    @classmethod
    def of(cls, legs: list[TreeLeg]) -> Self | None:
        """Projection of feet; None if all of them are near the planes of their legs."""
        offsets_m = tuple(leg.foot_offset_m for leg in legs)
        if max(map(abs, offsets_m)) <= PLANE_TOLERANCE * _lengths_m(legs).sum(axis=-1).mean():
            return None
        outward_m, up_m = np.mean([leg.vectors_m[0] for leg in legs], axis=0).tolist()
        yaws_rad = tuple(leg.yaw_rad for leg in legs)
        return cls(offsets_m, float(np.mean(np.abs(offsets_m))), (outward_m, up_m), yaws_rad)

    def outward_m(self, outward_m: float) -> float:
        """Distance of the foot from the coxa axis, of its distance in the plane of the leg."""
        return math.hypot(outward_m, self.offset_m)

    def sections(self, content: dict[str, Any], outward_m: float) -> dict[str, Any]:
        """The sections `mounts` and `links` of a robot file for a stance."""
        longer_m = self.outward_m(outward_m) - outward_m
        yaws_deg = [
            rounded(math.degrees(yaw_rad + math.atan2(offset_m, outward_m)))
            for yaw_rad, offset_m in zip(self.yaws_rad, self.offsets_m, strict=True)
        ]
        coxa = content["links"]["coxa"]
        end_m = [rounded(self.coxa_end_m[0] + longer_m), rounded(self.coxa_end_m[1])]
        return {
            "mounts": [
                mount | {"yaw_deg": yaw} for mount, yaw in zip(content["mounts"], yaws_deg, strict=True)
            ],
            "links": content["links"] | {"coxa": coxa | {"end_m": end_m}},
        }

    def note(self, outward_m: float, stride_m: float) -> str:
        """Note on the changed legs, with the largest error of a foot in a stride about a stance."""
        offsets_m = np.abs(self.offsets_m)[:, np.newaxis]
        reach_m = outward_m + stride_m * np.linspace(-0.5, 0.5, 21)
        # Places in the plane of the floor as complex numbers: outward + i left.
        turned = (reach_m + self.outward_m(outward_m) - outward_m) * np.exp(
            1j * np.arctan2(offsets_m, outward_m)
        )
        error_m = float(np.abs(reach_m + 1j * offsets_m - turned).max())
        return (
            f"the feet are up to {1000 * offsets_m.max():.1f} mm outside the planes of their legs: the legs "
            f"were turned to them, and steps are off by up to {1000 * error_m:.1f} mm"
        )
