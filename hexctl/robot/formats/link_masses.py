"""Masses of a robot's parts as rigid bodies: those of the simulation, in the form of URDF and MJCF."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from hexctl.robot.model import Robot
from hexctl.robot.plausibility import LINK_INERTIAS, TRUNK_INERTIAS, inertia_problem
from hexctl.robot.schema import Body, principal_moments
from hexctl.types import JOINT_KINDS

Vector3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PartMass:
    """Mass of a rigid part in the frame of its link.

    Attributes:
        com_m: centre of mass.
        moments_kg_m2: about the principal axes through the centre of mass.
        tilt_rad: turn about y from the axes of the link to the principal axes.
    """

    mass_kg: float
    com_m: Vector3
    moments_kg_m2: Vector3
    tilt_rad: float = 0.0

    @property
    def link_moments_kg_m2(self) -> tuple[float, float, float, float]:
        """Moments about the axes of the link, x, y and z, and the product of x and z."""
        x, y, z = self.moments_kg_m2
        cos, sin = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        return x * cos**2 + z * sin**2, y, x * sin**2 + z * cos**2, (z - x) * sin * cos


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with half spheres at its ends, from a link's origin to (outward, up)."""

    end_m: tuple[float, float]
    radius_m: float

    @property
    def length_m(self) -> float:
        """Length of its axis."""
        return math.hypot(*self.end_m)

    @property
    def tilt_rad(self) -> float:
        """Turn about y from z to its axis."""
        return math.atan2(*self.end_m)


def link_capsule(robot: Robot, index: int) -> Capsule:
    """Solid of coxa, femur or tibia, 0..2; the tibia is shortened, and the foot touches first."""
    outward_m, up_m = (robot.solid_shares[index] * robot.link_vectors_m[index]).tolist()
    return Capsule((outward_m, up_m), float(robot.link_radii_m[index]))


def link_mass(robot: Robot, index: int) -> PartMass:
    """Mass of coxa, femur or tibia, 0..2, with its moments of inertia, or spread evenly in its capsule.

    With m shared by volume between cylinder (m_c) and spheres (m_s), length h and radius r,

        I_across = m_c (3 r^2 + h^2) / 12 + m_s (2 r^2 / 5 + h (3 r + 2 h) / 8)
        I_along  = m_c r^2 / 2 + m_s 2 r^2 / 5
    """
    mass_kg, capsule = float(robot.link_masses_kg[index]), link_capsule(robot, index)
    if robot.link_coms_m is None:
        com_m, height_m = np.array(capsule.end_m) / 2, capsule.length_m
    else:
        com_m, height_m = robot.link_coms_m[index], float(robot.link_lengths_m[index])
    radius_m = capsule.radius_m
    spheres_kg = mass_kg * 4 * radius_m / (4 * radius_m + 3 * height_m)
    cylinder_kg, ball = mass_kg - spheres_kg, 2 * radius_m**2 / 5
    across = cylinder_kg * (3 * radius_m**2 + height_m**2) / 12
    across += spheres_kg * (ball + height_m * (3 * radius_m + 2 * height_m) / 8)
    along = cylinder_kg * radius_m**2 / 2 + spheres_kg * ball
    com = (float(com_m[0]), 0.0, float(com_m[1]))
    if robot.link_inertias_kg_m2 is not None:
        return _principal(mass_kg, com, robot.link_inertias_kg_m2[index].tolist())
    return PartMass(mass_kg, com, (across, across, along), capsule.tilt_rad)


def _principal(mass_kg: float, com_m: Vector3, moments_kg_m2: list[float]) -> PartMass:
    """A part from its moments about the axes of the link, and the product of x and z."""
    xx, yy, zz, xz = moments_kg_m2
    tilt_rad = 0.5 * math.atan2(2 * xz, zz - xx)
    return PartMass(mass_kg, com_m, principal_moments((xx, yy, zz, xz)), tilt_rad)


def trunk_mass(body: Body) -> PartMass:
    """Mass of the trunk: with its moments of inertia, or those of its shape filled evenly."""
    return PartMass(body.mass_kg, body.com_m, body.inertia_kg_m2 or _even_moments(body))


def inertia_doubts(robot: Robot) -> Iterator[str]:
    """Doubts about moments of inertia that are not those of the masses, one sentence each."""
    body, bare = robot.body, replace(robot, link_inertias_kg_m2=None)
    parts = [("body", body.inertia_kg_m2 or _even_moments(body), _even_moments(body), TRUNK_INERTIAS)]
    for index, kind in enumerate(JOINT_KINDS):
        own, even = (link_mass(one, index).moments_kg_m2 for one in (robot, bare))
        parts.append((f"links.{kind}", own, even, LINK_INERTIAS))
    for part, own, even, bounds in parts:
        if problem := inertia_problem(np.array(own), even, bounds):
            yield f"{part}.inertia_kg_m2: {problem}"


def _even_moments(body: Body) -> Vector3:
    length, width, height = body.size_m
    if body.shape == "cylinder":
        across = body.mass_kg * (3 * (length / 2) ** 2 + height**2) / 12
        return across, across, body.mass_kg * (length / 2) ** 2 / 2
    x, y, z = length**2, width**2, height**2
    return body.mass_kg * (y + z) / 12, body.mass_kg * (x + z) / 12, body.mass_kg * (x + y) / 12
