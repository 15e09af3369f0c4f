"""A world: the floor, the load and the servos' condition that a simulation puts a robot in."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from hexctl.backends.clock import PERIOD_S
from hexctl.errors import InputError
from hexctl.robot.configs import Number, find_config, read_mapping, shown, validate
from hexctl.types import N_JOINTS

#: A calibration error greater than this is no error of calibration.
MAX_JOINT_OFFSET_DEG = 45.0

NotNegative = Annotated[Number, Field(ge=0, allow_inf_nan=False)]
Offset = Annotated[Number, Field(ge=-1, le=1, allow_inf_nan=False)]


class _Section(BaseModel):
    """Frozen, and without keys that are not known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SensorNoise(_Section):
    """Standard deviations of what the robot measures, drawn anew every tick."""

    joint_deg: NotNegative = 0.0
    position_m: NotNegative = 0.0
    yaw_deg: NotNegative = 0.0


class World(_Section):
    """Everything about a simulation that is not the robot; the defaults are the flat world.

    Attributes:
        friction: sliding friction between feet and floor.
        slope_deg: inclination of the floor.
        slope_direction_deg: where uphill is, counter-clockwise from the x axis.
        roughness_m: standard deviation of the floor's height; 0 is an even floor.
        roughness_length_m: typical width of a bump.
        payload_kg: mass carried on the body.
        payload_position_m: where it sits in the body frame.
        added_mass_share: mass added to the trunk, as a share of the whole robot's; negative takes away.
        body_mass_shift_m: how far the trunk's centre of mass lies from where the robot file has it, in the
            body frame.
        contact_time_s: time constant in which a contact gives way; longer is a softer floor.
        friction_cone: how the solver bounds friction; `pyramidal` is quicker and a little weaker diagonally.
        time_step_s: step of the physics, a whole part of the 20 ms tick.
        servo_delay_s: time from a target to the servo that follows it, in whole ticks.
        servo_backlash_deg: play between a servo and its joint, from stop to stop.
        servo_strength: the servos' torque limit as a fraction of the robot file's.
        servo_stiffness: the servos' stiffness as a multiple of the robot file's.
        joint_offset_deg: calibration error; one number is the standard deviation of errors drawn with the
            seed, a list of 18 gives each joint its own.
        sensor_noise: noise of what is measured.
    """

    friction: Annotated[Number, Field(gt=0, le=5, allow_inf_nan=False)] = 0.8
    slope_deg: Annotated[Number, Field(ge=0, le=40, allow_inf_nan=False)] = 0.0
    slope_direction_deg: Annotated[Number, Field(ge=-360, le=360, allow_inf_nan=False)] = 0.0
    roughness_m: Annotated[Number, Field(ge=0, le=0.2, allow_inf_nan=False)] = 0.0
    roughness_length_m: Annotated[Number, Field(ge=0.02, le=2, allow_inf_nan=False)] = 0.1
    payload_kg: Annotated[Number, Field(ge=0, le=1000, allow_inf_nan=False)] = 0.0
    payload_position_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    added_mass_share: Annotated[Number, Field(ge=-0.5, le=5, allow_inf_nan=False)] = 0.0
    body_mass_shift_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    contact_time_s: Annotated[Number, Field(ge=0.005, le=0.2, allow_inf_nan=False)] = 0.02
    friction_cone: Literal["pyramidal", "elliptic"] = "pyramidal"
    time_step_s: Annotated[Number, Field(ge=0.0005, le=0.005, allow_inf_nan=False)] = 0.002
    servo_delay_s: Annotated[Number, Field(ge=0, le=0.5, allow_inf_nan=False)] = 0.0
    servo_backlash_deg: Annotated[Number, Field(ge=0, le=20, allow_inf_nan=False)] = 0.0
    servo_strength: Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    servo_stiffness: Annotated[Number, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    joint_offset_deg: float | tuple[float, ...] = 0.0
    sensor_noise: SensorNoise = SensorNoise()

    @property
    def steps_per_tick(self) -> int:
        """Return how many steps of the physics a control period takes."""
        return round(PERIOD_S / self.time_step_s)

    @property
    def delay_ticks(self) -> int:
        """Return how many control periods a target is late."""
        return round(self.servo_delay_s / PERIOD_S)

    @field_validator("time_step_s")
    @classmethod
    def _divides_the_tick(cls, step_s: float) -> float:
        if abs(round(PERIOD_S / step_s) * step_s - PERIOD_S) > 1e-9:
            raise ValueError(f"got {step_s:g}; allowed: {PERIOD_S:g} s divided by a whole number")
        return step_s

    @field_validator("servo_delay_s")
    @classmethod
    def _whole_ticks(cls, delay_s: float) -> float:
        if abs(round(delay_s / PERIOD_S) * PERIOD_S - delay_s) > 1e-9:
            raise ValueError(f"got {delay_s:g}; allowed: multiples of {PERIOD_S:g} s")
        return delay_s

    @field_validator("joint_offset_deg", mode="before")
    @classmethod
    def _one_or_each(cls, given: Any) -> Any:
        each = isinstance(given, list | tuple)
        numbers, least, count = (given, -MAX_JOINT_OFFSET_DEG, N_JOINTS) if each else ([given], 0.0, 1)
        plain = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
        within = plain and all(least <= number <= MAX_JOINT_OFFSET_DEG for number in numbers)
        if not within or len(numbers) != count:
            most = f"{MAX_JOINT_OFFSET_DEG:g}"
            raise ValueError(
                f"got {shown(given)}; allowed: 0 to {most}, or a list of {N_JOINTS}, each -{most} to {most}"
            )
        return given


def load_world(name_or_path: str | Path = "flat") -> World:
    """Return the world of a shipped name (`flat`, `slippery`, `slope`, `rough`) or of a YAML file.

    A file may set one key only; the rest is the flat world's. Raises InputError in one line.
    """
    path = find_config("worlds", name_or_path)
    content = read_mapping(path)
    if "ranges" in content:
        raise InputError(
            f"world {str(name_or_path)!r} is a family; allowed: one of it, as --world {name_or_path}:7"
        )
    return validate(World, content, path)
