"""The robot model: a frozen description from which kinematics, limits and the simulated body derive."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import cache, cached_property
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from hexctl.errors import InputError, check_type
from hexctl.robot.schema import Body, GaitDefaults, ServoModel
from hexctl.robot.sensors import SENSORS, Sensor, in_order
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, ArrayFields, FloatArray, check_finite, same_value

#: Impedance of dry friction in simulations. With MuJoCo's 0.9 a joint creeps at degrees per second under half
#: its breakaway torque; with this, at hundredths.
STICTION = (0.999, 0.999, 0.001)

#: Arrays with their shapes.
PerLink = Annotated[FloatArray, (JOINTS_PER_LEG,)]
PerJoint = Annotated[FloatArray, (N_JOINTS,)]


@dataclass(frozen=True, eq=False, repr=False)
class Robot(ArrayFields):
    """One hexapod. Body frame: x forward, y left, z up, origin at the height of the mounts' reference.

    The six legs differ only in their mounts. In the vertical plane of a leg, x points outward and z up; each
    link is the vector to its end at joint angle zero. A positive coxa turns counter-clockwise seen from
    above; positive femur and tibia lift the foot. Joint arrays are leg-major, shape (18,).

    Attributes:
        name: short name, by which results, priors and the network identify the robot.
        size_m: the paper's size factor E; gait amplitude and height are fractions of it.
        mount_positions_body: coxa axes, (6, 3) in m.
        mount_yaws_rad: direction in which each leg points at coxa angle zero, (6,).
        link_vectors_m: coxa, femur, tibia at joint angle zero, (3, 2) as (outward, up).
        link_masses_kg: coxa, femur, tibia, (3,).
        link_radii_m: half thickness of the links, (3,).
        foot_radius_m: radius of the foot sphere whose centre is the end of the tibia.
        stance_feet_body: nominal foot positions, (6, 3) in m.
        stance_angles_rad: joint angles of the nominal stance, (18,).
        link_coms_m: centres of mass of coxa, femur and tibia from their joints, (3, 2) as (outward, up); None
            for the middles of the links.
        link_inertias_kg_m2: moments of coxa, femur and tibia about axes outward, left and up through their
            centres of mass, and the products outward-up, (3, 4); None for evenly filled capsules.
        joint_stiffness_nm_per_rad: (18,), or None for the servo's in all joints.
        joint_dry_friction_nm: torque below which a joint does not turn, (18,), or None for none.
        joint_no_load_speed_rad_s: speed at which no torque is left, (18,), or None if torque does not depend
            on speed.
        joint_play_rad: play between servo and joint, from stop to stop, (18,), or None for none.
        sensors: what the robot measures, and what its simulation does; not part of the fingerprint.
    """

    name: str
    size_m: float
    body: Body
    mount_positions_body: Annotated[FloatArray, (N_LEGS, 3)]
    mount_yaws_rad: Annotated[FloatArray, (N_LEGS,)]
    link_vectors_m: Annotated[FloatArray, (JOINTS_PER_LEG, 2)]
    link_masses_kg: PerLink
    link_radii_m: PerLink
    foot_radius_m: float
    joint_lower_rad: PerJoint
    joint_upper_rad: PerJoint
    joint_max_speed_rad_s: PerJoint
    joint_max_torque_nm: PerJoint
    stance_feet_body: Annotated[FloatArray, (N_LEGS, 3)]
    stance_angles_rad: PerJoint
    servo: ServoModel
    gait: GaitDefaults
    link_coms_m: Annotated[FloatArray, (JOINTS_PER_LEG, 2)] | None = None
    joint_stiffness_nm_per_rad: PerJoint | None = None
    joint_dry_friction_nm: PerJoint | None = None
    joint_no_load_speed_rad_s: PerJoint | None = None
    joint_play_rad: PerJoint | None = None
    link_inertias_kg_m2: Annotated[FloatArray, (JOINTS_PER_LEG, 4)] | None = None
    sensors: tuple[Sensor, ...] = SENSORS

    def __post_init__(self) -> None:
        check_type(self.name, str, "robot.name")
        for name in ("size_m", "foot_radius_m"):
            check_type(getattr(self, name), float, f"robot.{name}")
        for name, part in (("body", Body), ("servo", ServoModel), ("gait", GaitDefaults)):
            check_type(getattr(self, name), part, f"robot.{name}")
        if unknown := sorted({*self.sensors} - {*SENSORS}):
            raise InputError(f"robot.sensors: got {', '.join(unknown)}; allowed: {', '.join(SENSORS)}")
        object.__setattr__(self, "sensors", in_order(self.sensors))
        check_arrays(self, "robot")

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, mass_kg={self.mass_kg:g}, fingerprint={self.fingerprint[:12]!r})"

    def __hash__(self) -> int:
        return hash((self.name, self.size_m))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        _freeze(self)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the body, equal for equal ones; fields at their defaults do not count."""
        digest = hashlib.sha256()
        for name, value in changed_fields(self):
            if name == "sensors":
                continue
            digest.update(value.tobytes() if isinstance(value, np.ndarray) else _text(value).encode())
            if name in _OPTIONAL:
                digest.update(name.encode())
        return digest.hexdigest()

    @cached_property
    def mass_kg(self) -> float:
        """Mass of the complete robot in kg."""
        return self.body.mass_kg + N_LEGS * float(self.link_masses_kg.sum())

    @cached_property
    def stiffness_nm_per_rad(self) -> FloatArray:
        """Stiffness of each joint's servo, (18,)."""
        own = self.joint_stiffness_nm_per_rad
        return np.full(N_JOINTS, self.servo.stiffness_nm_per_rad) if own is None else own

    @cached_property
    def dry_friction_nm(self) -> FloatArray:
        """Dry friction of each joint, (18,)."""
        own = self.joint_dry_friction_nm
        return np.zeros(N_JOINTS) if own is None else own

    @cached_property
    def play_rad(self) -> FloatArray:
        """Play of each joint, (18,)."""
        own = self.joint_play_rad
        return np.zeros(N_JOINTS) if own is None else own

    @cached_property
    def back_emf_nm_s_per_rad(self) -> FloatArray:
        """Torque that each joint's motor loses per speed, (18,): stall torque / no-load speed, or 0.

        A direct-current motor at the share u of its voltage gives the torque

            stall * u - (stall / no_load) * speed,  -1 <= u <= 1
        """
        no_load_rad_s = self.joint_no_load_speed_rad_s
        return np.zeros(N_JOINTS) if no_load_rad_s is None else self.joint_max_torque_nm / no_load_rad_s

    @cached_property
    def standing_height_m(self) -> float:
        """Height in m of the body frame above the floor in the nominal stance."""
        return float(self.foot_radius_m - self.stance_feet_body[:, 2].min())

    @property
    def trunk_clearance_m(self) -> float:
        """Height in m of the trunk's underside above the floor in the nominal stance."""
        return self.standing_height_m - self.body.size_m[2] / 2

    @cached_property
    def stance_radius_m(self) -> float:
        """Distance in m of the farthest nominal foot from the body's vertical axis."""
        return float(np.hypot(self.stance_feet_body[:, 0], self.stance_feet_body[:, 1]).max())

    @property
    def stance_outward_m(self) -> float:
        """Distance in m of the nominal feet from the coxa axes."""
        return float(np.hypot(*(self.stance_feet_body - self.mount_positions_body)[0, :2]))

    @cached_property
    def link_lengths_m(self) -> FloatArray:
        """Lengths of coxa, femur and tibia in the leg plane, (3,)."""
        lengths_m: FloatArray = np.sqrt((self.link_vectors_m**2).sum(axis=-1))
        return lengths_m

    @cached_property
    def solid_shares(self) -> FloatArray:
        """Solid share of each link's length, (3,): the tibia ends before the foot, which touches first."""
        return np.array([1.0, 1.0, max(0.5, 1 - self.foot_radius_m / self.link_lengths_m[-1])])

    @cached_property
    def link_slopes_rad(self) -> FloatArray:
        """Slopes of coxa, femur and tibia at joint angle zero, (3,)."""
        return np.arctan2(self.link_vectors_m[:, 1], self.link_vectors_m[:, 0])

    @cached_property
    def leg_triangle(self) -> "LegTriangle":
        """Constants of the inverse kinematics."""
        return LegTriangle.of(self)

    @cached_property
    def leg_azimuths_rad(self) -> FloatArray:
        """Direction of each nominal foot from the body's vertical axis, (6,)."""
        return np.arctan2(self.stance_feet_body[:, 1], self.stance_feet_body[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class LegTriangle(ArrayFields):
    """Constants of the triangle of femur joint, knee and foot, f and t the lengths of femur and tibia.

    Arrays of shape () combine with small arrays in two thirds of the time of plain numbers.

    Attributes:
        least_m: minimum distance from femur joint to foot, |f - t|; above 0.
        most_m: maximum distance, f + t.
        sum_of_squares: f^2 + t^2.
        twice_product: 2 f t.
    """

    coxa_outward_m: FloatArray
    coxa_up_m: FloatArray
    least_m: FloatArray
    most_m: FloatArray
    femur_square: FloatArray
    tibia_square: FloatArray
    sum_of_squares: FloatArray
    twice_femur: FloatArray
    twice_product: FloatArray
    femur_slope_rad: FloatArray
    tibia_slope_rad: FloatArray

    @classmethod
    def of(cls, robot: Robot) -> "LegTriangle":
        """Constants of a robot's legs, which are alike."""
        outward_m, up_m = robot.link_vectors_m[0].tolist()
        _, femur, tibia = robot.link_lengths_m.tolist()
        _, femur_slope_rad, tibia_slope_rad = robot.link_slopes_rad.tolist()
        values = {
            "coxa_outward_m": outward_m,
            "coxa_up_m": up_m,
            "least_m": max(abs(femur - tibia), 1e-9),
            "most_m": femur + tibia,
            "femur_square": femur**2,
            "tibia_square": tibia**2,
            "sum_of_squares": femur**2 + tibia**2,
            "twice_femur": 2 * femur,
            "twice_product": 2 * femur * tibia,
            "femur_slope_rad": femur_slope_rad,
            "tibia_slope_rad": tibia_slope_rad,
        }
        return cls(**{name: np.array(value) for name, value in values.items()})


def check_arrays(part: Any, name: str) -> None:
    """Check shapes and numbers of the arrays of a dataclass by its annotations, and make them read-only.

    Raises InputError that names the part.
    """
    for key, shape, optional in _array_shapes(part.__class__):
        value = getattr(part, key)
        if not (optional and value is None):
            check_finite(value, shape, f"{name}.{key}")
    _freeze(part)


@cache
def _array_shapes(kind: type) -> list[tuple[str, tuple[int, ...], bool]]:
    """Name and shape of each array of a dataclass, and whether it may be None."""
    hints = get_type_hints(kind, include_extras=True)
    each = [(key, hint, part) for key, hint in hints.items() for part in (hint, *get_args(hint))]
    return [
        (key, part.__metadata__[0], part is not hint)
        for key, hint, part in each
        if get_origin(part) is Annotated
    ]


def _freeze(part: object) -> None:
    for value in vars(part).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


_OPTIONAL = {field.name for field in fields(Robot) if field.default is None}


def changed_fields(part: Any) -> list[tuple[str, Any]]:
    """Names and values of the non-default fields of a robot or a part of it."""
    return [
        (field.name, getattr(part, field.name))
        for field in fields(part)
        if field.default is MISSING or not same_value(getattr(part, field.name), field.default)
    ]


def _text(value: Any) -> str:
    """The `repr` of a value, without the default fields of a dataclass."""
    if not is_dataclass(value):
        return repr(value)
    content = ", ".join(f"{name}={part!r}" for name, part in changed_fields(value))
    return f"{type(value).__name__}({content})"


Vector2 = tuple[float, float]


def leg_reach_m(femur: Vector2, tibia: Vector2) -> tuple[float, float]:
    """Minimum and maximum distance in m of a foot from its femur joint."""
    femur_length, tibia_length = math.hypot(*femur), math.hypot(*tibia)
    return abs(femur_length - tibia_length), femur_length + tibia_length


def stance_angles(coxa: Vector2, femur: Vector2, tibia: Vector2, foot: Vector2) -> tuple[float, float]:
    """Femur and tibia angle in rad, knee up, of a foot (outward, up); raises InputError."""
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


def stance(
    mounts_body: FloatArray, yaws_rad: FloatArray, links: Sequence[Vector2], foot: Vector2
) -> tuple[FloatArray, FloatArray]:
    """Nominal feet in the body frame, (6, 3), all at one height, and joint angles, (18,).

    The foot is outward from the coxa axis and up from the body frame. Raises InputError out of reach.
    """
    (coxa, femur, tibia), (outward_m, up_m) = links, foot
    level = mounts_body[:, :2] + outward_m * np.stack([np.cos(yaws_rad), np.sin(yaws_rad)], axis=-1)
    angles: list[float] = []
    for leg, mount_z in enumerate(mounts_body[:, 2].tolist(), start=1):
        try:
            angles += [0.0, *stance_angles(coxa, femur, tibia, (outward_m, up_m - mount_z))]
        except InputError as error:
            raise InputError(f"stance: out of reach for leg {leg}: {error}") from error
    return np.column_stack([level, np.full(N_LEGS, up_m)]), np.array(angles)


def in_stance_of(robot: Robot, outward_m: float) -> Robot:
    """The robot with its nominal feet at a distance outward from the coxa axes; raises InputError."""
    links = [(float(out), float(up)) for out, up in robot.link_vectors_m]
    foot = (outward_m, float(robot.stance_feet_body[0, 2]))
    feet, angles = stance(robot.mount_positions_body, robot.mount_yaws_rad, links, foot)
    return replace(robot, stance_feet_body=feet, stance_angles_rad=angles)
