"""Schema of robot files. Lengths are in metres and angles in degrees, as the keys' suffixes.

`Body`, `ServoModel` and `GaitDefaults` are sections of the file and parts of the `Robot`.
"""

import math
from dataclasses import field
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    Field,
    field_validator,
    model_validator,
)

from hexctl.robot.configs import (
    AngleDeg,
    Coordinate,
    Fraction,
    Length,
    Mass,
    Number,
    Positive,
    Section,
    Whole,
    file_part,
    keys_of,
    section_in,
)
from hexctl.robot.sensors import SENSORS, Sensor, in_order, usual_sensors
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_KINDS, JOINT_NAMES, N_LEGS

Moments = TypeVar("Moments", tuple[float, float, float], tuple[float, float, float, float])


def _possible_inertia(moments: Moments) -> Moments:
    """Three principal moments, or moments and product of a link; raises ValueError for those of no body."""
    principal = moments if len(moments) == 3 else principal_moments(moments)
    if min(principal) <= 0 or not all(moment < sum(principal) - moment for moment in principal):
        raise ValueError(
            f"got {', '.join(f'{moment:g}' for moment in moments)}; allowed: principal moments of inertia "
            "above 0, each below the sum of the other two"
        )
    return moments


Inertia = Annotated[tuple[Positive, Positive, Positive], AfterValidator(_possible_inertia)]


def even_box_m(mass_kg: float, moments_kg_m2: tuple[float, float, float]) -> tuple[float, float, float]:
    """Length, width and height of the evenly filled box with a mass and principal moments of inertia.

    A box of sides a, b, c has I_x = m (b^2 + c^2) / 12 and so on: a^2 = 6 (I_y + I_z - I_x) / m.
    """
    total = sum(moments_kg_m2)
    x, y, z = (math.sqrt(6 * (total - 2 * own) / mass_kg) for own in moments_kg_m2)
    return x, y, z


#: Names of robots: lower case letters, digits, hyphens and underscores.
NAME = r"^[a-z0-9][a-z0-9_-]{0,39}$"


@file_part("body")
class Body:
    """The trunk: a box or an upright cylinder, centred on the body frame.

    Attributes:
        shape: of the trunk.
        mass_kg: of the trunk with everything on it.
        size_m: length, width, height; a cylinder's diameter is its length.
        com_m: centre of mass in the body frame.
        inertia_kg_m2: moments of inertia about axes through the centre of mass, parallel to the body frame;
            None for those of the evenly filled shape.

    Raises InputError for an invalid value.
    """

    # A factory, because a fingerprint has every shape, and leaves out defaults.
    shape: Literal["box", "cylinder"] = field(default_factory=lambda: "box")
    size_m: tuple[Length, Length, Length]
    mass_kg: Mass
    com_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    inertia_kg_m2: Inertia | None = None


class MountSection(Section):
    """Mount of a leg: `position_m` and `yaw_deg`, or `radius_m` and `azimuth_deg` for a radial leg.

    Attributes:
        position_m: the coxa axis in the body frame.
        yaw_deg: direction of the leg at coxa angle zero, counter-clockwise from the front.
        radius_m: distance of the coxa axis from the middle of the body.
        azimuth_deg: direction of the mount and of the leg.
    """

    position_m: tuple[Coordinate, Coordinate, Coordinate] | None = None
    yaw_deg: AngleDeg | None = None
    radius_m: Length | None = None
    azimuth_deg: AngleDeg | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        cartesian = (self.position_m is not None) + (self.yaw_deg is not None)
        radial = (self.radius_m is not None) + (self.azimuth_deg is not None)
        if (cartesian, radial) not in ((2, 0), (0, 2)):
            got = ", ".join(sorted(self.model_fields_set)) or "no key"
            raise ValueError(f"got {got}; allowed: position_m and yaw_deg, or radius_m and azimuth_deg")
        return self

    @property
    def yaw_rad(self) -> float:
        """Direction of the leg at coxa angle zero."""
        return math.radians(self.azimuth_deg or 0.0 if self.yaw_deg is None else self.yaw_deg)

    @property
    def place_m(self) -> tuple[float, float, float]:
        """Coxa axis in the body frame."""
        if self.position_m is not None:
            return self.position_m
        radius_m = self.radius_m or 0.0
        return radius_m * math.cos(self.yaw_rad), radius_m * math.sin(self.yaw_rad), 0.0


def principal_moments(moments: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Principal moments of a link, the second about y, from its moments and product as in `LinkSection`."""
    xx, yy, zz, xz = moments
    half = math.hypot((xx - zz) / 2, xz)
    return (xx + zz) / 2 - half, yy, (xx + zz) / 2 + half


LinkInertia = Annotated[
    tuple[Positive, Positive, Positive, Annotated[Number, Field(allow_inf_nan=False)]],
    AfterValidator(_possible_inertia),
]


class LinkSection(Section):
    """A link: the vector to its end, and its centre of mass, (outward, up) at joint angle zero.

    Attributes:
        end_m: from the joint to the next joint or the foot.
        mass_kg: of the link with its servo.
        radius_m: of the capsule that stands for the link.
        com_m: centre of mass; the middle of the link unless given.
        inertia_kg_m2: moments about axes outward, left and up through the centre of mass, and the product
            outward-up; by default those of an evenly filled capsule.
    """

    end_m: tuple[Coordinate, Coordinate]
    mass_kg: Mass
    radius_m: Length
    com_m: tuple[Coordinate, Coordinate] | None = None
    inertia_kg_m2: LinkInertia | None = None

    @field_validator("end_m")
    @classmethod
    def _has_length(cls, end_m: tuple[float, float]) -> tuple[float, float]:
        if end_m == (0.0, 0.0):
            raise ValueError("got a link of length 0; allowed: above 0 m")
        return end_m


class LinksSection(Section):
    """The three links of a leg."""

    coxa: LinkSection
    femur: LinkSection
    tibia: LinkSection

    @property
    def each(self) -> tuple[LinkSection, LinkSection, LinkSection]:
        """Coxa, femur and tibia."""
        return self.coxa, self.femur, self.tibia

    @property
    def ends_m(self) -> tuple[tuple[float, float], ...]:
        """Vectors of coxa, femur and tibia."""
        return tuple(link.end_m for link in self.each)


class JointSection(Section):
    """Range, speed, torque and play of one joint; None for the stiffness is the servo's.

    Attributes:
        min_deg: lower end of the range; the guard clips commands to it.
        max_deg: upper end of the range.
        max_speed_deg_s: maximum speed of commands.
        max_torque_nm: stall torque of the servo.
        dry_friction_nm: friction of the gears at rest.
        no_load_speed_deg_s: speed without load, at which the torque is zero.
        stiffness_nm_per_rad: of this joint's servo; that of `servo` unless given.
        play_deg: backlash from stop to stop.
    """

    min_deg: AngleDeg
    max_deg: AngleDeg
    max_speed_deg_s: Positive
    max_torque_nm: Positive
    dry_friction_nm: Annotated[Number, Field(ge=0, allow_inf_nan=False)] = 0.0
    no_load_speed_deg_s: Positive | None = None
    stiffness_nm_per_rad: Positive | None = None
    play_deg: Annotated[Number, Field(ge=0, le=20, allow_inf_nan=False)] = 0.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_deg >= self.max_deg:
            raise ValueError(
                f"got min_deg {self.min_deg:g} and max_deg {self.max_deg:g}; allowed: min_deg below max_deg"
            )
        return self

    @model_validator(mode="after")
    def _can_turn(self) -> Self:
        if self.dry_friction_nm >= self.max_torque_nm:
            raise ValueError(
                f"got dry_friction_nm {self.dry_friction_nm:g} and max_torque_nm {self.max_torque_nm:g}; "
                "allowed: a friction below the torque"
            )
        if self.no_load_speed_deg_s is not None and self.no_load_speed_deg_s < self.max_speed_deg_s:
            raise ValueError(
                f"got max_speed_deg_s {self.max_speed_deg_s:g} and no_load_speed_deg_s "
                f"{self.no_load_speed_deg_s:g}; allowed: max_speed_deg_s up to the speed without load"
            )
        return self


class JointsSection(Section):
    """The three joints of a leg."""

    coxa: JointSection
    femur: JointSection
    tibia: JointSection

    @property
    def each(self) -> tuple[JointSection, JointSection, JointSection]:
        """Coxa, femur and tibia."""
        return self.coxa, self.femur, self.tibia

    @model_validator(mode="after")
    def _all_or_none(self) -> Self:
        without = [kind for kind in JOINT_KINDS if getattr(self, kind).no_load_speed_deg_s is None]
        if 0 < len(without) < len(JOINT_KINDS):
            raise ValueError(
                f"got no no_load_speed_deg_s for {', '.join(without)}; allowed: one for every joint kind, or "
                "for none"
            )
        return self


class StanceSection(Section):
    """The nominal foot: outward from the coxa axis, up from the body frame.

    Attributes:
        outward_m: from the coxa axis outward.
        up_m: from the body frame up; negative is below.
    """

    outward_m: Length
    up_m: Coordinate


#: Viscous friction of the gears of a small servo, where it is not known.
USUAL_GEAR_DAMPING_NM_S_PER_RAD = 0.02


@file_part("servo")
class ServoModel:
    """Position control of the simulated servos: torque = stiffness * error - damping * speed.

    Attributes:
        stiffness_nm_per_rad: at the proportional gain that the servo has in this robot.
        damping_nm_s_per_rad: of the control; friction and back-EMF are those of the joints.
        gear_damping_nm_s_per_rad: viscous friction, with and without power.
        rotor_inertia_kg_m2: of the motor, as the joint feels it.
        dead_time_s: from a target to the first torque.
        load_friction: share of the stall torque that the gears lose at it, besides the dry friction.
    """

    stiffness_nm_per_rad: Positive
    damping_nm_s_per_rad: Positive
    rotor_inertia_kg_m2: Positive
    dead_time_s: Annotated[Number, Field(ge=0, le=0.1, allow_inf_nan=False)] = 0.0
    gear_damping_nm_s_per_rad: Annotated[Number, Field(ge=0, le=10, allow_inf_nan=False)] = (
        USUAL_GEAR_DAMPING_NM_S_PER_RAD
    )
    load_friction: Annotated[Number, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0


@file_part("gait")
class GaitDefaults:
    """Default gait of a robot; amplitude and height are fractions of the size E, `size_m`.

    Attributes:
        pace_hz: gait cycles per second.
        amplitude: length of a step.
        height: height of a step.
    """

    pace_hz: Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)]
    amplitude: Fraction
    height: Fraction


class MeshSection(Section):
    """Mesh of one part: a file, relative to the robot file, and its pose in the frame of the part.

    Attributes:
        file: path relative to the robot file.
        scale: metres per unit of the file.
        position_m: in the frame of the part.
        rotation_deg: about x, y and z of that frame.
    """

    file: Annotated[str, Field(min_length=1)]
    scale: Annotated[Number, Field(gt=0, le=1000, allow_inf_nan=False)] = 1.0
    position_m: tuple[Coordinate, Coordinate, Coordinate] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[AngleDeg, AngleDeg, AngleDeg] = (0.0, 0.0, 0.0)


class MeshesSection(Section):
    """Meshes in recordings; a part without one is drawn as a solid."""

    body: MeshSection | None = None
    coxa: MeshSection | None = None
    femur: MeshSection | None = None
    tibia: MeshSection | None = None


def _check_key(schema: type, path: str) -> None:
    """Refuse a path such as `links.tibia.end_m` if it is no key of a schema."""
    place: type | None = schema
    for name in path.split("."):
        fields = keys_of(place) or {}
        if name not in fields:
            keys = f"one of {', '.join(sorted(fields))}" if fields else "nothing after it"
            raise ValueError(f"got {path}; allowed: keys of a robot file; in place of {name!r}, {keys}")
        place = section_in(fields[name].annotation)


P_GAIN = "p_gain"


class _GainStiffness(Section):
    """Stiffness of servos whose firmware has a P gain."""

    p_gain: Annotated[Whole, Field(ge=1)]
    stiffness_nm_per_rad_per_p_gain: Positive


_GAIN_KEYS = tuple(_GainStiffness.model_fields)


class RobotSchema(Section):
    """A complete robot file.

    Attributes:
        name: lower case letters, digits, hyphens and underscores.
        description: one line for lists.
        size_m: the size E of which amplitude, height and body raise are fractions.
        body: the trunk.
        mounts: of the six legs, counter-clockwise from the front left.
        links: lengths and masses of a leg.
        foot_radius_m: of the ball at the end of the tibia.
        joints: ranges and strengths of a leg.
        stance: where the feet stand.
        servo: the simulated servos.
        gait: the default gait.
        servos: the real servos: driver, port, direction and offset.
        sensors: what the robot measures, and what its simulation does; by default what its servos report.
        meshes: looks in recordings.
        unknown: keys whose values were not measured, such as `body.mass_kg`.
    """

    name: Annotated[str, Field(pattern=NAME)]
    description: str = ""
    size_m: Length
    body: Body
    mounts: Annotated[list[MountSection], Field(min_length=N_LEGS, max_length=N_LEGS)]
    links: LinksSection
    foot_radius_m: Length
    joints: JointsSection
    stance: StanceSection
    servo: ServoModel
    gait: GaitDefaults
    servos: ServosSection = ServosSection()
    sensors: tuple[Sensor, ...] | None = None
    meshes: MeshesSection = MeshesSection()
    unknown: tuple[str, ...] = ()

    @field_validator("servo", mode="before")
    @classmethod
    def _stiffness_of_gain(cls, given: Any) -> Any:
        """A file may have the P gain of the firmware and the stiffness per unit of it, not the stiffness."""
        if not isinstance(given, dict) or P_GAIN not in given:
            return given
        gains = _GainStiffness.model_validate({key: given[key] for key in _GAIN_KEYS if key in given})
        if "stiffness_nm_per_rad" in given:
            raise ValueError(f"got {P_GAIN} and stiffness_nm_per_rad; allowed: one of them")
        rest = {key: value for key, value in given.items() if key not in _GAIN_KEYS}
        return {**rest, "stiffness_nm_per_rad": gains.p_gain * gains.stiffness_nm_per_rad_per_p_gain}

    @field_validator("sensors")
    @classmethod
    def _each_once(cls, sensors: tuple[Sensor, ...] | None) -> tuple[Sensor, ...] | None:
        if sensors is not None and len(set(sensors)) < len(sensors):
            raise ValueError(f"got {', '.join(sensors)}; allowed: each of {', '.join(SENSORS)} once")
        return None if sensors is None else in_order(sensors)

    @property
    def measured(self) -> tuple[Sensor, ...]:
        """What the robot measures."""
        if self.sensors is not None:
            return self.sensors
        joints = [getattr(self.servos, name) for name in JOINT_NAMES]
        foot_switches = any(joint.touch is not None for joint in joints)
        return usual_sensors(self.servos.driver, self.servos.model, foot_switches=foot_switches)

    @field_validator("unknown")
    @classmethod
    def _are_keys(cls, unknown: tuple[str, ...]) -> tuple[str, ...]:
        for path in unknown:
            _check_key(cls, path)
        return unknown
