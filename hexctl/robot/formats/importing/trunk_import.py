"""The trunk of a robot description: its box, its place, its mass and its moments of inertia."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.robot.formats.importing.import_values import (
    LEAST_TRUNK_KG_M3,
    USUAL_HEIGHT_M,
    USUAL_LEG_M,
    Findings,
    UsualMasses,
    possible_tensor,
    rounded,
)
from hexctl.robot.formats.importing.link_tree import JoinedMass, LinkTree, Solid, TreeLink
from hexctl.robot.formats.link_masses import trunk_mass
from hexctl.robot.plausibility import TRUNK_INERTIAS, too_dense
from hexctl.robot.schema import Body
from hexctl.types import FloatArray

#: Minimum side of an assumed trunk, of a usual robot.
LEAST_SIDE_M = 0.05

#: A solid is the trunk if it covers this share of the area between the mounts, in both directions, and is no
#: larger than this multiple of it.
LEAST_COVER, MOST_COVER = 0.5, 2.5

#: The body frame is the centre of the trunk's box if that is near the centre of the mounts: level and in
#: height, as shares of the larger distance between mounts.
NEAR_CENTRE, NEAR_HEIGHT = 1 / 16, 1 / 8

#: Products of inertia above this share of the largest moment are noted when they are left out.
NOTED_PRODUCTS = 0.1


@dataclass(frozen=True, eq=False)
class TrunkBox:
    """Size and centre of the trunk, (3,) each in m in axes of the body; no guess if solids show it."""

    size_m: FloatArray
    centre_m: FloatArray
    shape: str
    guess: str


def trunk_box(tree: LinkTree, facing: FloatArray, mounts_m: FloatArray, leg_m: float) -> TrunkBox:
    """The box around the solids that cover the area between the mounts, (6, 3); else that area.

    Smaller solids are servos, bars and markers; larger ones are floors. Legs of `leg_m` show the size.
    """
    low_m, high_m = mounts_m[:, :2].min(axis=0), mounts_m[:, :2].max(axis=0)
    scale = leg_m / USUAL_LEG_M
    sides_m = np.maximum(high_m - low_m, LEAST_SIDE_M * scale)
    found: list[tuple[Solid, FloatArray, FloatArray, FloatArray]] = []
    for name in tree.rigid(tree.root):
        frame = facing @ tree.frame_in_root(name)
        for solid in tree.links[name].solids:
            least_m, most_m = solid.bounds(frame)
            covered_m = np.minimum(most_m[:2], high_m) - np.maximum(least_m[:2], low_m)
            size_m = most_m - least_m
            if (covered_m > LEAST_COVER * sides_m).all() and (size_m[:2] < MOST_COVER * sides_m).all():
                found.append((solid, least_m, most_m, frame))
    if not found:
        return _between_mounts(tree, mounts_m, np.array([*sides_m, USUAL_HEIGHT_M * scale]))
    least_m, most_m = np.min([one[1] for one in found], axis=0), np.max([one[2] for one in found], axis=0)
    shape = "cylinder" if all(_is_upright(solid, frame) for solid, *_, frame in found) else "box"
    size_m = np.maximum(most_m - least_m, 1e-3)
    return TrunkBox(size_m, (least_m + most_m) / 2, shape, "")


def _is_upright(solid: Solid, frame: FloatArray) -> bool:
    return solid.kind == "cylinder" and abs((frame @ solid.frame)[2, 2]) > 0.999


def _between_mounts(tree: LinkTree, mounts_m: FloatArray, size_m: FloatArray) -> TrunkBox:
    links = tree.rigid(tree.root)
    reason = "no solid covers the area between the mounts, which was taken"
    if unread := tree.unread_meshes(links):
        reason += f"; not read: {', '.join(unread[:3])}{' ...' if len(unread) > 3 else ''}"
    centre_m = mounts_m.mean(axis=0)
    return TrunkBox(size_m, centre_m, "box", reason)


def body_origin(box: TrunkBox, mounts_m: FloatArray) -> FloatArray:
    """Origin of the body frame in axes of the body, (3,): the centre of the trunk's box, or of the mounts.

    A box that is not between the mounts, as when the root is at a corner or on the floor, does not count.
    """
    centre_m = np.asarray(mounts_m.mean(axis=0), dtype=float)
    if box.guess:
        return centre_m
    spread_m = float(np.ptp(mounts_m[:, :2], axis=0).max())
    off_m = box.centre_m - centre_m
    level = float(np.hypot(off_m[0], off_m[1])) < NEAR_CENTRE * spread_m
    even = abs(off_m[2]) < NEAR_HEIGHT * spread_m
    return np.array([*(box.centre_m if level else centre_m)[:2], (box.centre_m if even else centre_m)[2]])


def body_section(
    links: Sequence[TreeLink],
    joined: JoinedMass,
    box: TrunkBox,
    origin_m: FloatArray,
    findings: Findings,
    *,
    least_kg: float,
    usual: UsualMasses,
) -> dict[str, Any]:
    """The section `body` of a robot file: the trunk is all that no leg carries, the links.

    A mass below the least one, or implausible for the box, is replaced by the usual one.
    """
    size_m = [rounded(side) for side in box.size_m]
    if box.guess:
        findings.reasons["body.size_m"] = box.guess
    mass_kg = joined.mass_kg
    body: dict[str, Any] = {"shape": box.shape, "size_m": size_m, "mass_kg": rounded(mass_kg)}
    if mass_kg < max(least_kg, LEAST_TRUNK_KG_M3 * math.prod(size_m)) or too_dense(mass_kg, size_m):
        findings.reasons["body.mass_kg"] = usual.reason(mass_kg, "body")
        return body | {"mass_kg": usual.parts_kg["body"]}
    if joined.missing:
        findings.reasons["body.mass_kg"] = f"{joined.missing}; {mass_kg:g} kg of the rest were taken"
    com_m = joined.com_m - origin_m
    in_origins = all(np.abs(link.com_m).max() < 1e-9 for link in links if link.mass_kg)
    if in_origins and float(np.hypot(*com_m[:2])) > NEAR_CENTRE * max(size_m):
        reason = "got none but the origins of links, which are not in the trunk's centre"
        findings.reasons["body.com_m"] = reason
    elif (np.abs(com_m) > np.array(size_m)).any():
        findings.notes.append("the trunk's centre of mass lies outside it and was left out")
    elif np.abs(com_m).max() > 1e-7:
        body["com_m"] = [rounded(part) for part in com_m]
    return body | _inertia(body, joined, findings)


def _inertia(body: dict[str, Any], joined: JoinedMass, findings: Findings) -> dict[str, list[float]]:
    """Moments of inertia, unless they are those of the trunk's shape, or implausible."""
    tensor, bare = joined.inertia_kg_m2, joined.bare
    key, even = "body.inertia_kg_m2", np.array(trunk_mass(Body(**body)).moments_kg_m2)
    if bare:
        findings.reasons[key] = f"{bare[0]} has none; an evenly filled {body['shape']} was assumed"
        return {}
    if np.allclose(np.diag(tensor), even, rtol=1e-7):
        return {}
    own, problem = possible_tensor(np.diag(np.diag(tensor)), even.tolist(), TRUNK_INERTIAS)
    if problem:
        findings.reasons[key] = f"{problem}; an evenly filled {body['shape']} was assumed"
        return {}
    share = max(abs(tensor[0, 1]), abs(tensor[0, 2]), abs(tensor[1, 2])) / own.max()
    if share > NOTED_PRODUCTS:
        findings.notes.append(
            f"the trunk's products of inertia, up to {100 * share:.0f} % of its moments, were left out"
        )
    return {"inertia_kg_m2": [rounded(moment) for moment in np.diag(own)]}
