"""A world: the floor, the load and the servos' condition that a simulation puts a robot in."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from hexctl.robot.configs import find_config, read_mapping, validate
from hexctl.robot.joints import N_JOINTS

NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Offset = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]


class SensorNoise(BaseModel):
    """Standard deviations of what the robot measures, drawn anew every tick."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joint_deg: NotNegative = 0.0
    position_m: NotNegative = 0.0
    yaw_deg: NotNegative = 0.0


class World(BaseModel):
    """Everything about a simulation that is not the robot; the defaults are the flat world.

    Attributes:
        friction: sliding friction between feet and floor.
        slope_deg: inclination of the floor.
        slope_direction_deg: where uphill is, counter-clockwise from the x axis.
        roughness_m: standard deviation of the floor's height; 0 is an even floor.
        roughness_length_m: typical width of a bump.
        payload_kg: mass carried on the body.
        payload_position_m: where it sits in the body frame.
        servo_strength: the servos' torque limit as a fraction of the robot file's.
        servo_stiffness: the servos' stiffness as a multiple of the robot file's.
        joint_offset_deg: calibration error; one number is the standard deviation of errors drawn with the
            seed, a list of 18 gives each joint its own.
        sensor_noise: noise of what is measured.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    friction: Annotated[float, Field(gt=0, le=5, allow_inf_nan=False)] = 0.8
    slope_deg: Annotated[float, Field(ge=0, le=40, allow_inf_nan=False)] = 0.0
    slope_direction_deg: Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)] = 0.0
    roughness_m: Annotated[float, Field(ge=0, le=0.2, allow_inf_nan=False)] = 0.0
    roughness_length_m: Annotated[float, Field(ge=0.02, le=2, allow_inf_nan=False)] = 0.1
    payload_kg: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)] = 0.0
    payload_position_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    servo_strength: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    servo_stiffness: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = 1.0
    joint_offset_deg: (
        Annotated[float, Field(ge=0, le=45, allow_inf_nan=False)]
        | Annotated[
            tuple[Annotated[float, Field(ge=-45, le=45, allow_inf_nan=False)], ...],
            Field(min_length=N_JOINTS, max_length=N_JOINTS),
        ]
    ) = 0.0
    sensor_noise: SensorNoise = SensorNoise()


def load_world(name_or_path: str | Path = "flat") -> World:
    """Return the world of a shipped name (`flat`, `slippery`, `slope`, `rough`) or of a YAML file.

    A file may set one key only; the rest is the flat world's. Raises InputError in one line.
    """
    path = find_config("worlds", name_or_path)
    return validate(World, read_mapping(path), path)
