"""Simulated worlds: floor, load and servo condition, and domain randomization over them."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.draws import COLUMNS, Distribution, DrawnFailure, draw_failures
from hexctl.backends.sim.flaws import Section, SensorFaults, SensorNoise
from hexctl.errors import InputError, argument, check_type, shown
from hexctl.files import is_file
from hexctl.robot.configs import Number, find_config, is_family, read_mapping, validate
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_JOINTS, N_LEGS, FloatArray

#: Maximum calibration error of a joint.
MAX_JOINT_OFFSET_DEG = 45.0

#: Marks a quantity of which a simulation draws with its seed where it is not 0.
DRAWN = "drawn with the seed"

Offset = Annotated[Number, Field(ge=-1, le=1, allow_inf_nan=False)]

#: Members of one family; the legs of a prior take theirs from blocks far apart.
MAX_MEMBERS = 1 << 20

#: List quantities of a world, whose elements are drawn independently.
_PARTS = {
    "body_mass_shift_m": 3,
    "payload_position_m": 3,
    "joint_offset_deg": N_JOINTS,
    "joint_stiffness": N_JOINTS,
    "joint_friction_nm": N_JOINTS,
    "servo_backlash_deg": N_JOINTS,
    "tibia_error": N_LEGS,
}

#: Quantities with discrete values, which cannot be randomized; a kind may set them.
_IN_STEPS = (
    "time_step_s",
    "solver_tolerance",
    "friction_cone",
    "sensor_noise",
    "sensor_faults",
    "failures",
    "healings",
)


@dataclass(frozen=True, slots=True)
class OneOrSeveral:
    """Check of a number within bounds, not below `least` if it is one for all, or a list of some lengths."""

    low: float
    high: float
    counts: tuple[int, ...] = (JOINTS_PER_LEG, N_JOINTS)
    least: float = -math.inf

    def __call__(self, given: Any) -> Any:
        """The value; raises ValueError for another one."""
        several, least = isinstance(given, list | tuple), max(self.low, self.least)
        numbers, low = (given, self.low) if several else ([given], least)
        plain = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
        within = plain and all(low <= number <= self.high for number in numbers)
        if not within or (several and len(given) not in self.counts):
            lengths = " or ".join(map(str, self.counts))
            raise ValueError(
                f"got {shown(given)}; allowed: {least:g} to {self.high:g}, or a list of {lengths}, each "
                f"{self.low:g} to {self.high:g}"
            )
        return given


_PLAY_DEG = BeforeValidator(OneOrSeveral(0.0, 20.0))
_STIFFNESS = BeforeValidator(OneOrSeveral(0.01, 20.0))
_FRICTION_NM = BeforeValidator(OneOrSeveral(0.0, 5.0))
_EXCESS = BeforeValidator(OneOrSeveral(-0.2, 0.2, (N_LEGS,)))
_OFFSETS_DEG = BeforeValidator(OneOrSeveral(-MAX_JOINT_OFFSET_DEG, MAX_JOINT_OFFSET_DEG, (N_JOINTS,), 0.0))


class World(Section):
    """All parameters of a simulation except the robot; the defaults are the flat world.

    Attributes:
        friction: sliding friction between feet and floor.
        friction_ratio: the feet's friction along the world's y axis, as a multiple of that along its x axis,
            as on wood or carpet. Shanks are not affected.
        slope_deg: inclination of the floor.
        slope_direction_deg: uphill direction, counter-clockwise from the x axis.
        roughness_m: standard deviation of the floor's height; 0 is an even floor.
        roughness_length_m: typical width of a bump.
        step_height_m: the floor is square blocks of random heights, up to this much apart; 0 without.
        pit_depth_m: depth of the pits, each a sunken block; 0 without.
        block_m: side of a block or pit.
        ramp_deg: inclination of ramps that go up and down in turn along the floor's x axis; 0 without.
        ramp_length_m: horizontal length of a ramp.
        on_stand: whether the trunk is held above the floor, so that the legs move freely.
        payload_kg: mass carried on the body.
        payload_position_m: its position in the body frame.
        added_mass_share: mass added to the trunk, as a share of the complete robot's; negative takes away.
        body_mass_shift_m: shift of the trunk's centre of mass from the robot file's, in the body frame.
        contact_time_s: time constant of contacts; longer is a softer floor. On blocks and pits it is at
            most the one at which a falling foot sinks in by its radius.
        friction_cone: `pyramidal` is faster but weaker diagonally: walks depend on their compass direction by
            decimetres.
        time_step_s: step of the physics, an integer part of the 20 ms tick.
        solver_tolerance: of the contact solver. With MuJoCo's 1e-8 walks depend on their compass direction by
            up to 2 cm in 30 s; with 1e-12, by 0.1 mm in most.
        servo_delay_s: delay from a target to the servo's motion besides the dead time of the robot file, in
            whole steps of the physics.
        servo_backlash_deg: play between a servo and its joint, from stop to stop: one number, three for coxa,
            femur and tibia, or one per joint; 0 for the robot file's.
        servo_strength: the servos' torque limit as a fraction of the robot file's.
        servo_stiffness: the servos' stiffness as a multiple of the robot file's.
        servo_damping: the damping of the servos' control as a multiple of the robot file's.
        rotor_inertia_kg_m2: None for the robot file's.
        joint_stiffness: multiples of `servo_stiffness`: one, three for coxa, femur and tibia, or one per
            joint.
        joint_friction_nm: dry friction, in the same form; None for the robot file's.
        tibia_error: excess length of the tibias, as a share: one number, or one for each leg.
        joint_offset_deg: calibration error: a standard deviation, or 18 errors.
        state_latency_s: age of a state when it is read; rounded to whole steps of the physics.
        lost_commands: share of the control periods with a lost command; the servos keep the last one.
        lost_poses: share of the control periods without position and orientation.
        sensor_faults: omitted in files if there are none, as are the next two.
        failures: such as `5:locked@8`: leg, failure, seconds since the walk began.
        healings: such as `5@20`: leg, seconds since the walk began.
    """

    friction: Annotated[Number, Field(gt=0, le=5, allow_inf_nan=False)] = 0.8
    friction_ratio: Annotated[Number, Field(ge=0.2, le=5, allow_inf_nan=False)] = 1.0
    slope_deg: Annotated[Number, Field(ge=0, le=40, allow_inf_nan=False)] = 0.0
    slope_direction_deg: Annotated[Number, Field(ge=-360, le=360, allow_inf_nan=False)] = 0.0
    roughness_m: Annotated[Number, Field(ge=0, le=0.2, allow_inf_nan=False), DRAWN] = 0.0
    roughness_length_m: Annotated[Number, Field(ge=0.02, le=2, allow_inf_nan=False)] = 0.1
    step_height_m: Annotated[Number, Field(ge=0, le=0.2, allow_inf_nan=False), DRAWN] = 0.0
    pit_depth_m: Annotated[Number, Field(ge=0, le=0.2, allow_inf_nan=False), DRAWN] = 0.0
    block_m: Annotated[Number, Field(ge=0.05, le=2, allow_inf_nan=False)] = 0.25
    ramp_deg: Annotated[Number, Field(ge=0, le=40, allow_inf_nan=False)] = 0.0
    ramp_length_m: Annotated[Number, Field(ge=0.1, le=4, allow_inf_nan=False)] = 0.5
    on_stand: bool = False
    payload_kg: Annotated[Number, Field(ge=0, le=1000, allow_inf_nan=False)] = 0.0
    payload_position_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    added_mass_share: Annotated[Number, Field(ge=-0.5, le=5, allow_inf_nan=False)] = 0.0
    body_mass_shift_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    contact_time_s: Annotated[Number, Field(ge=0.005, le=0.2, allow_inf_nan=False)] = 0.02
    friction_cone: Literal["elliptic", "pyramidal"] = "elliptic"
    time_step_s: Annotated[Number, Field(ge=0.0005, le=0.005, allow_inf_nan=False)] = 0.002
    solver_tolerance: Annotated[Number, Field(ge=1e-15, le=1e-3, allow_inf_nan=False)] = 1e-12
    servo_delay_s: Annotated[Number, Field(ge=0, le=0.5, allow_inf_nan=False)] = 0.0
    servo_backlash_deg: Annotated[float | tuple[float, ...], _PLAY_DEG] = 0.0
    servo_strength: Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    servo_stiffness: Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    servo_damping: Annotated[Number, Field(ge=0, le=20, allow_inf_nan=False)] = 1.0
    rotor_inertia_kg_m2: Annotated[Number, Field(gt=0, le=1, allow_inf_nan=False)] | None = None
    joint_stiffness: Annotated[float | tuple[float, ...], _STIFFNESS] = 1.0
    joint_friction_nm: Annotated[float | tuple[float, ...], _FRICTION_NM] | None = None
    tibia_error: Annotated[float | tuple[float, ...], _EXCESS] = 0.0
    joint_offset_deg: Annotated[float | tuple[float, ...], _OFFSETS_DEG, DRAWN] = 0.0
    sensor_noise: Annotated[SensorNoise, DRAWN] = SensorNoise()
    state_latency_s: Annotated[Number, Field(ge=0, le=0.1, allow_inf_nan=False)] = 0.0
    lost_commands: Annotated[Number, Field(ge=0, le=0.5, allow_inf_nan=False), DRAWN] = 0.0
    lost_poses: Annotated[Number, Field(ge=0, le=0.95, allow_inf_nan=False), DRAWN] = 0.0
    sensor_faults: SensorFaults = SensorFaults()
    failures: tuple[str, ...] = ()
    healings: tuple[str, ...] = ()

    @property
    def even_floor(self) -> bool:
        """Whether the floor is a plane, level or sloping."""
        return not (self.roughness_m or self.step_height_m or self.pit_depth_m or self.ramp_deg)

    @property
    def seeded(self) -> bool:
        """Whether a simulation depends on its seed; a list of joint offsets does not."""
        drawn = {name: field for name, field in World.model_fields.items() if DRAWN in field.metadata}
        values = {name: getattr(self, name) for name in drawn}
        return any(
            value != drawn[name].default and not isinstance(value, tuple) for name, value in values.items()
        )

    @property
    def repeats(self) -> bool:
        """Whether the trials of one seed are alike: no noise and no losses are drawn for each."""
        return self.sensor_noise == SensorNoise() and not (self.lost_commands or self.lost_poses)

    @property
    def steps_per_tick(self) -> int:
        """Physics steps per control period."""
        return round(PERIOD_S / self.time_step_s)

    @property
    def latency_steps(self) -> int:
        """Age of a state in steps of the physics."""
        return round(self.state_latency_s / self.time_step_s)

    @field_validator("failures", "healings")
    @classmethod
    def _events(cls, given: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        parse = parse_failure_event if info.field_name == "failures" else parse_healing
        try:
            return tuple(str(parse(text)) for text in given)
        except InputError as error:
            raise ValueError(str(error)) from error

    @property
    def events(self) -> tuple[FailureEvent, ...]:
        """Scheduled failures and healings of a walk, by time."""
        events = (*map(parse_failure_event, self.failures), *map(parse_healing, self.healings))
        return tuple(sorted(events, key=lambda event: event.at_s))

    @field_validator("time_step_s")
    @classmethod
    def _divides_the_tick(cls, step_s: float) -> float:
        if abs(round(PERIOD_S / step_s) * step_s - PERIOD_S) > 1e-9:
            raise ValueError(f"got {step_s:g}; allowed: {PERIOD_S:g} s divided by a whole number")
        return step_s


def per_joint(given: float | tuple[float, ...]) -> FloatArray:
    """Values of the 18 joints, (18,), of one number, one for each joint kind, or one for each joint."""
    values = np.atleast_1d(np.asarray(given, dtype=float))
    return np.tile(values, N_JOINTS // len(values))


def per_leg(given: float | tuple[float, ...]) -> FloatArray:
    """Values of the six legs, (6,), of one number or one for each leg."""
    return np.broadcast_to(np.asarray(given, dtype=float), (N_LEGS,))


def _can_be_drawn(key: str) -> bool:
    """Whether a key of ranges is a continuous quantity, or a joint kind of one."""
    name, dot, kind = key.partition(".")
    if dot:
        return _PARTS.get(name) == N_JOINTS and kind in JOINT_KINDS
    return name in World.model_fields and name not in _IN_STEPS


def _parts(key: str) -> int:
    name, dot, _ = key.partition(".")
    return N_LEGS if dot else _PARTS.get(name, 1)


class Kind(BaseModel):
    """A subset of the worlds with common values, by the keys of a world file, that no range expresses."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    world: dict[str, Any] = {}

    @field_validator("world")
    @classmethod
    def _is_a_world(cls, values: dict[str, Any]) -> dict[str, Any]:
        World.model_validate(values)
        return values


class DomainRandomization(BaseModel):
    """A family of worlds: numbered members of a quasi-random (Sobol) design over distributions.

    Any aligned block of 2^n members is evenly spread.

    Attributes:
        seed: scrambles the design.
        ranges: the randomized quantities, by the keys of a world file; every element of a list is drawn
            independently. A key may name one joint kind: `joint_stiffness.coxa`.
        kinds: subsets to which the members belong in turn; one plain kind unless given.
        failures: failures during walks, each of another leg.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Annotated[int, Field(ge=0, strict=True)]
    ranges: dict[str, Distribution]
    kinds: tuple[Kind, ...] = (Kind(name="plain"),)
    failures: tuple[DrawnFailure, ...] = ()

    @model_validator(mode="after")
    def _makes_worlds(self) -> "DomainRandomization":
        self._check_joint_kinds()
        unknown = [key for key in self.ranges if not _can_be_drawn(key)]
        if unknown or not self.kinds:
            raise ValueError(
                f"got {', '.join(unknown) or 'no kinds'}; allowed: quantities of a world file that have no "
                "steps, and kinds"
            )
        self._check_failures()
        for share in (0.0, 1.0):
            self._world(np.full(self._dimensions, share), self.kinds[0])
        return self

    def _check_joint_kinds(self) -> None:
        """Refuse a quantity drawn both complete and by joint kind, or lacking kinds without a default."""
        for name in {key.partition(".")[0] for key in self.ranges if "." in key}:
            keys = [f"{name}.{kind}" for kind in JOINT_KINDS]
            given = [key for key in (name, *keys) if key in self.ranges]
            if name in given or (name == "joint_friction_nm" and given != keys):
                raise ValueError(f"got {', '.join(given)}; allowed: {name} alone, or {', '.join(keys)}")

    def _check_failures(self) -> None:
        for earlier, draw in enumerate(self.failures):
            if len(draw.legs) <= earlier:
                raise ValueError(
                    f"got {earlier + 1} failures, of which one has the legs {shown(list(draw.legs))}; "
                    "allowed: for each more legs than there are failures before it"
                )
        setting = [kind.name for kind in self.kinds if {"failures", "healings"} & kind.world.keys()]
        if self.failures and setting:
            raise ValueError(
                f"got drawn failures together with those of the kind {setting[0]}; allowed: only one of them"
            )

    def members(self, first: int, count: int) -> list[World]:
        """Worlds first .. first + count - 1."""
        shares = self._shares(first, count)
        return [self._world(row, self.kind(first + index)) for index, row in enumerate(shares)]

    def kind(self, number: int) -> Kind:
        """The kind of a member."""
        return self.kinds[number % len(self.kinds)]

    def spare(self, distribution: Distribution, first: int, count: int) -> FloatArray:
        """Values, (count,), of one more quantity of the members, outside the world."""
        return distribution.at(self._shares(first, count)[:, -1])

    @cached_property
    def _dimensions(self) -> int:
        return sum(_parts(key) for key in self.ranges) + COLUMNS * len(self.failures) + 1

    def _shares(self, first: int, count: int) -> FloatArray:
        if not (count >= 1 and first >= 0 and first + count <= MAX_MEMBERS):
            raise InputError(f"{argument('world')}: got member {first}; allowed: 0..{MAX_MEMBERS - 1}")
        from scipy.stats.qmc import Sobol

        sequence = Sobol(self._dimensions, scramble=True, rng=np.random.default_rng(self.seed))
        if first:
            sequence.fast_forward(first)
        # One at a time keeps SciPy from warning about unbalanced draws.
        return np.asarray(np.concatenate([sequence.random(1) for _ in range(count)]))

    def _world(self, shares: Sequence[float] | FloatArray, kind: Kind) -> World:
        values: dict[str, Any] = {}
        at = 0
        for key, distribution in self.ranges.items():
            parts = _parts(key)
            drawn = distribution.at(np.asarray(shares[at : at + parts])).tolist()
            name, dot, joint_kind = key.partition(".")
            if dot:
                usual = World.model_fields[name].default or 0.0  # no friction is 0 for the other joints
                joints = values.setdefault(name, [usual] * N_JOINTS)
                joints[JOINT_KINDS.index(joint_kind) :: JOINTS_PER_LEG] = drawn
            else:
                values[key] = drawn if parts > 1 else drawn[0]
            at += parts
        values |= draw_failures(self.failures, np.asarray(shares[at:]))
        return World.model_validate(values | kind.world)


def load_randomization(name_or_path: str | Path) -> DomainRandomization:
    """Family of worlds of a shipped name (`randomised`, `transfer`) or a YAML file; raises InputError."""
    path = find_config("worlds", name_or_path)
    content = read_mapping(path)
    if not is_family(content):
        raise InputError(f"{path}: has no `ranges`; allowed: a family of worlds, such as transfer or real")
    return validate(DomainRandomization, content, path)


#: World of a simulation that names none.
DEFAULT_WORLD = "flat"

#: A world at another time step, such as `flat@0.5ms`.
_STEPPED = re.compile(r"(?P<world>.+)@(?P<ms>\d+(\.\d+)?)ms")


def without_step(world: str) -> str:
    """Text of a world without its time step."""
    stepped = _STEPPED.fullmatch(world)
    return stepped["world"] if stepped else world


def with_step(world: str, step_s: float) -> str:
    """Text of a world with a time step, unless it has one."""
    return world if _STEPPED.fullmatch(world) else f"{world}@{1000 * step_s:g}ms"


def load_world(name_or_path: str | Path = DEFAULT_WORLD) -> World:
    """The world of a shipped name, of a YAML file, or a member of a family, such as `randomised:7`.

        world = hexctl.load_world("randomised:7")
        print(world.friction, world.slope_deg)

    `flat@0.5ms` is the world `flat` with another time step. Missing keys have the flat world's values. Raises
    InputError.
    """
    allowed = "a name, the path of a YAML file, or a member of a family, such as 'randomised:7'"
    check_type(name_or_path, (str, Path), "world", allowed)
    text = str(name_or_path)
    if (stepped := _STEPPED.fullmatch(text)) and not is_file(Path(text)):
        values = load_world(stepped["world"]).model_dump() | {"time_step_s": float(stepped["ms"]) / 1000}
        return validate(World, values, Path(text))
    family, colon, number = text.rpartition(":")
    if colon and not is_file(Path(text)):
        if not (number.isdecimal() and len(number) <= len(str(MAX_MEMBERS))):
            raise InputError(
                f"{argument('world')}: got {text!r}; allowed: the number of a member, 0..{MAX_MEMBERS - 1}, "
                f"as in {family}:7"
            )
        return load_randomization(family).members(int(number), 1)[0]
    path = find_config("worlds", text)
    content = read_mapping(path)
    if is_family(content):
        raise InputError(f"world {text!r} is a family; allowed: one of it, as --world {text}:7")
    return validate(World, content, path)


def as_world(world: World | str | Path | None) -> World:
    """The given world, the one of a name or path, or the flat world for None.

    Raises InputError for a world that cannot be loaded, WrongTypeError for any other type.
    """
    if world is None:
        return World()
    if isinstance(world, str | Path):
        return load_world(world)
    allowed = "a World, the name or path of a world file, or a member of a family, such as 'randomised:7'"
    check_type(world, World, "world", allowed)
    return world
