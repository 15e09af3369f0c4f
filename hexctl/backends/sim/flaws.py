"""Flaws of a simulated robot's sensors: noise, drift, and what they show wrongly for a time."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from hexctl.robot.configs import Number

Finite = Annotated[Number, Field(allow_inf_nan=False)]
NotNegative = Annotated[Number, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """A part of a world file: frozen, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SensorNoise(Section):
    """Standard deviations of the measurement errors, which are drawn every tick."""

    joint_deg: NotNegative = 0.0
    position_m: NotNegative = 0.0
    yaw_deg: NotNegative = 0.0


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    first_s, last_s = interval
    if not first_s < last_s:
        raise ValueError(f"got {first_s:g} to {last_s:g} s; allowed: an interval that ends after it begins")
    return interval


Interval = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_ordered)]


class SensorFaults(Section):
    """What the sensors of position and yaw show wrongly, in times of the simulation's clock.

    Attributes:
        yaw_drift_deg_per_min: drift of the yaw, counter-clockwise from the start on.
        pose_frozen_s: intervals in which position and orientation stay what they were when each began; where
            intervals overlap, the one that began last counts.
        position_jump_s: intervals in which the position is off.
        position_jump_m: by how much, along the axes of the world.
    """

    yaw_drift_deg_per_min: Annotated[Number, Field(ge=-3600, le=3600, allow_inf_nan=False)] = 0.0
    pose_frozen_s: tuple[Interval, ...] = ()
    position_jump_s: tuple[Interval, ...] = ()
    position_jump_m: tuple[Finite, Finite, Finite] = (0.0, 1.0, 0.0)
