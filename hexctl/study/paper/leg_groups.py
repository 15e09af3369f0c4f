"""Which legs are one experiment: landscapes that a symmetry of robot and world turns into one another."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hexctl.adapt.prior.samples import moved_codes
from hexctl.backends.sim.world import World
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscape import NUMBERS, Landscape

#: Quantities of a world that favour no leg and no side, whatever their value.
EVEN = frozenset(
    ("friction", "added_mass_share", "contact_time_s", "friction_cone", "time_step_s", "servo_delay_s",
     "servo_backlash_deg", "servo_strength", "servo_stiffness", "roughness_length_m")
)  # fmt: skip

#: Quantities that `_world_allows` checks; others that differ from the flat world's break the symmetry.
EXAMINED = frozenset(
    ("slope_deg", "slope_direction_deg", "roughness_m", "payload_kg", "payload_position_m",
     "body_mass_shift_m")
)  # fmt: skip


def symmetries_of(
    robot: Robot, world: World, self_rotation: str, failure: str = "locked"
) -> tuple[BodySymmetry, ...]:
    """Symmetries that map one leg's landscape to another leg's, the identity first.

    Without self-rotation the direction of travel is fixed in the body; only symmetries that keep it count.
    """
    return tuple(
        one
        for one in body_symmetries(robot)
        if (self_rotation != "none" or one.keeps_heading)
        and ((one.keeps_heading and not one.mirrored) or _world_allows(world, one))
        and not (one.mirrored and _one_sided(failure))
    )


def experiments_of(
    robot: Robot, world: World, self_rotation: str, legs: Sequence[int], failure: str = "locked"
) -> tuple[tuple[int, ...], ...]:
    """Legs in groups, ascending: the landscapes of a group are one experiment and have one vote.

    They differ only by a centimetre or two at the end, because a turned gait begins at another point of
    its cycle.
    """
    symmetries = symmetries_of(robot, world, self_rotation, failure)
    groups: dict[tuple[int, ...], tuple[int, ...]] = {}
    for leg in legs:
        orbit = {symmetry.legs[leg - 1] for symmetry in symmetries}
        group = tuple(other for other in sorted(legs) if other in orbit)
        groups[group] = group
    return tuple(sorted(groups))


def is_mirror_of(
    robot: Robot, world: World, leg: int, other: int, self_rotation: str, failure: str = "locked"
) -> bool:
    """Whether the landscape of a leg is the mirror image of another leg's, or of itself."""
    symmetries = symmetries_of(robot, world, self_rotation, failure)
    return any(symmetry.mirrored and symmetry.legs[leg - 1] == other for symmetry in symmetries)


def image_of(landscape: Landscape, symmetry: BodySymmetry) -> Landscape:
    """Image of a landscape under a symmetry, with the codes of the other leg.

    A mirror changes the sign of deviations and yaw.
    """
    spec = landscape.spec
    codes = moved_codes(symmetry, spec.leg)[landscape.codes - 1]
    order = np.argsort(codes)
    sign = -1.0 if symmetry.mirrored else 1.0
    numbers = landscape.numbers.copy()
    for name in ("signed_m", "yaw_change_rad"):
        numbers[:, NUMBERS.index(name)] *= sign
    paths_m = landscape.paths_m.copy()
    paths_m[..., 1] *= sign
    return Landscape(
        spec=replace(spec, leg=symmetry.legs[spec.leg - 1], codes=tuple(codes[order].tolist())),
        status=landscape.status[order],
        numbers=numbers[order],
        paths_m=paths_m[order],
    )


def landscape_by_symmetry(known: Sequence[Landscape], leg: int) -> Landscape:
    """The landscape of a leg among known ones, or the image of one of them.

    `known` have the same robot, world, failure and self-rotation. Raises KeyError if no symmetry leads to
    the leg.
    """
    for landscape in known:
        if landscape.spec.leg == leg:
            return landscape
    for landscape in known:
        spec = landscape.spec
        for symmetry in symmetries_of(spec.robot, spec.world, spec.self_rotation, spec.failure):
            if symmetry.legs[spec.leg - 1] == leg:
                return image_of(landscape, symmetry)
    raise KeyError(f"leg {leg}")


def _one_sided(failure: str) -> bool:
    """Whether a failure has a left and a right: a coxa stuck off its middle."""
    broken = parse_kind(1, failure)
    return broken.kind == "stuck" and broken.joint == "coxa" and broken.angle_rad != 0


def _world_allows(world: World, symmetry: BodySymmetry) -> bool:
    """Whether a symmetry of the robot is also one of its load, its servos and the floor."""
    plain = World()
    others = [name for name in World.model_fields if name not in EVEN | EXAMINED]
    if any(getattr(world, name) != getattr(plain, name) for name in others):
        return False
    loads = [world.body_mass_shift_m, *([world.payload_position_m] if world.payload_kg else [])]
    if not all(_keeps(symmetry, load[0], load[1]) for load in loads):
        return False
    # The floor does not turn with the body: it is walked in the same direction. A mirror does change it.
    across = abs(math.sin(math.radians(world.slope_direction_deg))) > 1e-9
    return not symmetry.mirrored or not (world.roughness_m or (world.slope_deg and across))


def _keeps(symmetry: BodySymmetry, x: float, y: float) -> bool:
    """Whether a symmetry leaves a point of the body in place."""
    point = np.array([x, y, 0.0])
    return float(np.linalg.norm(symmetry.points(point) - point)) < 1e-9
