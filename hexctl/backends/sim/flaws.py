"""Flaws of a simulated robot's sensors: noise, drift, and temporary faults."""

from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from hexctl.robot.configs import Number

Finite = Annotated[Number, Field(allow_inf_nan=False)]
Jump = Annotated[Number, Field(ge=-100, le=100, allow_inf_nan=False)]
NotNegative = Annotated[Number, Field(ge=0, allow_inf_nan=False)]


class Section(BaseModel):
    """A part of a world file: frozen, unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SensorNoise(Section):
    """Standard deviations of the measurement errors, which are drawn every tick; velocities have none."""

    joint_deg: Annotated[Number, Field(ge=0, le=10, allow_inf_nan=False)] = 0.0
    position_m: Annotated[Number, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    yaw_deg: Annotated[Number, Field(ge=0, le=45, allow_inf_nan=False)] = 0.0


def _ordered(interval: tuple[float, float]) -> tuple[float, float]:
    first_s, last_s = interval
    if not first_s < last_s:
        raise ValueError(f"got {first_s:g} to {last_s:g} s; allowed: an interval that ends after it begins")
    return interval


Interval = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_ordered)]


#: By how much a position jumps unless something else is asked for.
JUMP_M = (0.0, 1.0, 0.0)


class SensorFaults(Section):
    """Temporary faults of position and yaw, in times of the simulation's clock.

    Attributes:
        yaw_drift_deg_per_min: drift of the yaw, counter-clockwise from the start.
        pose_frozen_s: intervals in which the pose keeps its value from their beginning; the last one begun
            counts.
        position_jump_s: intervals in which the position is off.
        position_jump_m: offset along the axes of the world; a metre to the left unless given.
    """

    yaw_drift_deg_per_min: Annotated[Number, Field(ge=-3600, le=3600, allow_inf_nan=False)] = 0.0
    pose_frozen_s: tuple[Interval, ...] = ()
    position_jump_s: tuple[Interval, ...] = ()
    position_jump_m: tuple[Jump, Jump, Jump] = JUMP_M

    @model_validator(mode="after")
    def _jumps(self) -> Self:
        jump_m = ", ".join(f"{part:g}" for part in self.position_jump_m)
        if self.position_jump_m != JUMP_M and not self.position_jump_s:
            raise ValueError(
                f"got position_jump_m [{jump_m}] without position_jump_s; allowed: with its intervals"
            )
        if self.position_jump_s and not any(self.position_jump_m):
            raise ValueError(
                f"got position_jump_s with position_jump_m [{jump_m}]; allowed: a jump that is not zero"
            )
        return self
