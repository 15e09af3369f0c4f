"""The robot model: a frozen description from which kinematics, limits and the simulated body derive."""

import hashlib
import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from hexctl.errors import InputError, check_type
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, ArrayFields, FloatArray, check_finite


@dataclass(frozen=True)
class Body:
    """The trunk: a box or an upright cylinder, centred on the body frame.

    `size_m` is length, width, height; a cylinder's diameter is its length.
    """

    shape: str
    size_m: tuple[float, float, float]
    mass_kg: float

    def __post_init__(self) -> None:
        check_type(self.shape, str, "body.shape")
        check_type(self.size_m, (tuple, list), "body.size_m", "length, width and height in m")
        object.__setattr__(self, "size_m", tuple(self.size_m))


@dataclass(frozen=True)
class GaitDefaults:
    """Default gait of a robot; amplitude and height are fractions of the size E."""

    pace_hz: float
    amplitude: float
    height: float


@dataclass(frozen=True)
class ServoModel:
    """Position control of the simulated servos: torque = stiffness * error - damping * speed."""

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    rotor_inertia_kg_m2: float


@dataclass(frozen=True, eq=False, repr=False)
class Robot(ArrayFields):
    """One hexapod. Body frame: x forward, y left, z up, origin at the height of the mounts' reference.

    The six legs are alike and differ in their mounts. In the vertical plane of a leg, x points outward and
    z up; each link is the vector to its end at joint angle zero. A positive coxa turns counter-clockwise
    seen from above; positive femur and tibia lift the foot. Joint arrays are leg-major, shape (18,).

    Attributes:
        name: short name, by which results, priors and the network identify the robot.
        size_m: the paper's size factor E; gait amplitude and height are fractions of it.
        body: shape and mass of the trunk.
        mount_positions_body: coxa axes, (6, 3) in m.
        mount_yaws_rad: direction in which each leg points at coxa angle zero, (6,).
        link_vectors_m: coxa, femur, tibia at joint angle zero, (3, 2) as (outward, up).
        link_masses_kg: coxa, femur, tibia, (3,).
        link_radii_m: half thickness of the links, (3,).
        foot_radius_m: radius of the foot sphere whose centre is the end of the tibia.
        joint_lower_rad: (18,).
        joint_upper_rad: (18,).
        joint_max_speed_rad_s: (18,).
        joint_max_torque_nm: (18,).
        stance_feet_body: nominal foot positions, (6, 3) in m.
        stance_angles_rad: joint angles that put the feet there, (18,).
        servo: the simulated servos' stiffness and damping.
        gait: default pace, amplitude and height.
    """

    name: str
    size_m: float
    body: Body
    mount_positions_body: FloatArray
    mount_yaws_rad: FloatArray
    link_vectors_m: FloatArray
    link_masses_kg: FloatArray
    link_radii_m: FloatArray
    foot_radius_m: float
    joint_lower_rad: FloatArray
    joint_upper_rad: FloatArray
    joint_max_speed_rad_s: FloatArray
    joint_max_torque_nm: FloatArray
    stance_feet_body: FloatArray
    stance_angles_rad: FloatArray
    servo: ServoModel
    gait: GaitDefaults

    def __post_init__(self) -> None:
        check_type(self.name, str, "robot.name")
        for name in ("size_m", "foot_radius_m"):
            check_type(getattr(self, name), float, f"robot.{name}")
        for name, part in (("body", Body), ("servo", ServoModel), ("gait", GaitDefaults)):
            check_type(getattr(self, name), part, f"robot.{name}")
        for name, shape in _SHAPES.items():
            check_finite(getattr(self, name), shape, f"robot.{name}")
        self._freeze()

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, mass_kg={self.mass_kg:g}, fingerprint={self.fingerprint[:12]!r})"

    def __hash__(self) -> int:
        return hash((self.name, self.size_m))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._freeze()

    def _freeze(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the description: equal for two robots exactly if their descriptions are."""
        digest = hashlib.sha256()
        for field in fields(self):
            value = getattr(self, field.name)
            digest.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
        return digest.hexdigest()

    @cached_property
    def mass_kg(self) -> float:
        """Mass of the whole robot in kg."""
        return self.body.mass_kg + N_LEGS * float(self.link_masses_kg.sum())

    @cached_property
    def standing_height_m(self) -> float:
        """Height in m of the body frame above the floor in the nominal stance."""
        return float(self.foot_radius_m - self.stance_feet_body[:, 2].min())

    @cached_property
    def stance_radius_m(self) -> float:
        """Distance in m of the farthest nominal foot from the body's vertical axis."""
        return float(np.hypot(self.stance_feet_body[:, 0], self.stance_feet_body[:, 1]).max())

    @cached_property
    def link_lengths_m(self) -> FloatArray:
        """Lengths of coxa, femur and tibia in the leg plane, (3,)."""
        lengths_m: FloatArray = np.sqrt((self.link_vectors_m**2).sum(axis=-1))
        return lengths_m

    @cached_property
    def link_slopes_rad(self) -> FloatArray:
        """Slopes of coxa, femur and tibia at joint angle zero, (3,)."""
        return np.arctan2(self.link_vectors_m[:, 1], self.link_vectors_m[:, 0])

    @cached_property
    def leg_azimuths_rad(self) -> FloatArray:
        """Direction of each nominal foot from the body's vertical axis, (6,)."""
        return np.arctan2(self.stance_feet_body[:, 1], self.stance_feet_body[:, 0])


#: Shapes of a robot's arrays.
_SHAPES = {
    "mount_positions_body": (N_LEGS, 3),
    "mount_yaws_rad": (N_LEGS,),
    "link_vectors_m": (JOINTS_PER_LEG, 2),
    "link_masses_kg": (JOINTS_PER_LEG,),
    "link_radii_m": (JOINTS_PER_LEG,),
    "joint_lower_rad": (N_JOINTS,),
    "joint_upper_rad": (N_JOINTS,),
    "joint_max_speed_rad_s": (N_JOINTS,),
    "joint_max_torque_nm": (N_JOINTS,),
    "stance_feet_body": (N_LEGS, 3),
    "stance_angles_rad": (N_JOINTS,),
}

Vector2 = tuple[float, float]


def leg_reach_m(femur: Vector2, tibia: Vector2) -> tuple[float, float]:
    """Least and greatest distance in m of a foot from its femur joint."""
    femur_length, tibia_length = math.hypot(*femur), math.hypot(*tibia)
    return abs(femur_length - tibia_length), femur_length + tibia_length


def stance_angles(coxa: Vector2, femur: Vector2, tibia: Vector2, foot: Vector2) -> tuple[float, float]:
    """Femur and tibia angle in rad that put the foot at (outward, up) from the coxa axis, knee up.

    The scalar form of `hexctl.ik.legs.solve_legs`, for the robot file: the law of cosines in the triangle
    femur joint, knee, foot. Raises InputError for a foot out of reach.
    """
    outward, up = foot[0] - coxa[0], foot[1] - coxa[1]
    distance = math.hypot(outward, up)
    least, most = leg_reach_m(femur, tibia)
    if not least < distance < most:
        raise InputError(
            f"the foot is {distance:.4f} m from the femur joint; allowed: {least:.4f} to {most:.4f} m"
        )
    femur_length, tibia_length = math.hypot(*femur), math.hypot(*tibia)
    at_hip = math.acos((femur_length**2 + distance**2 - tibia_length**2) / (2 * femur_length * distance))
    at_knee = math.acos((femur_length**2 + tibia_length**2 - distance**2) / (2 * femur_length * tibia_length))
    femur_slope = math.atan2(up, outward) + at_hip
    tibia_slope = femur_slope + at_knee - math.pi
    femur_rad = femur_slope - math.atan2(femur[1], femur[0])
    tibia_rad = tibia_slope - math.atan2(tibia[1], tibia[0]) - femur_rad
    return math.remainder(femur_rad, math.tau), math.remainder(tibia_rad, math.tau)
