"""The raw map: conversion between joint angles and raw positions of servos, pulses or counts.

    raw = centre + per_deg * (sign * angle_deg + offset_deg)

`ServoMap`, `PwmMap` and `BusMap` add the addresses of the servos.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.model import PerJoint, Robot, check_arrays
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import (
    JOINT_KINDS,
    JOINT_NAMES,
    JOINTS_PER_LEG,
    N_JOINTS,
    ArrayFields,
    BoolArray,
    FloatArray,
)

IntPerJoint = Annotated[NDArray[np.int64], (N_JOINTS,)]

#: Minimum distance of a reference angle from both ends of a joint's range, for trimming both ways.
ROOM_DEG = 20.0

#: Minimum travel between the two limits of a servo.
LEAST_TRAVEL_DEG = 4.5

#: Keys of the lowest and the highest raw position in a robot file, by unit.
LIMIT_KEYS = {"us": ("min_us", "max_us"), "counts": ("min_count", "max_count")}


@dataclass(frozen=True, eq=False, kw_only=True)
class RawMap(ArrayFields, ABC):
    """Conversion between joint angles and raw positions of servos; arrays are by joint, (18,), read-only.

    Attributes:
        unit: of raw positions, `us` or `counts`.
        signs: direction of each servo, 1 or -1.
        offsets_deg: mounting error of each servo's horn.
        least: lowest raw position, as is `most` the highest.
        per_deg: raw units per degree.
        centre: raw position at the middle of the travel.
    """

    unit: ClassVar[str]
    signs: PerJoint
    offsets_deg: PerJoint
    least: PerJoint
    most: PerJoint
    per_deg: PerJoint
    centre: PerJoint

    def __post_init__(self) -> None:
        check_arrays(self, "servos")

    @abstractmethod
    def servo_name(self, joint: int) -> str:
        """The servo of a joint, 0..17, such as `id 7`."""

    @property
    def travel(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest raw position that each servo can reach."""
        return self.least, self.most

    def raw(self, joint_positions_rad: FloatArray) -> FloatArray:
        """Raw positions of angles (18,) in rad, without limits and not rounded."""
        degrees = self.signs * np.degrees(joint_positions_rad) + self.offsets_deg
        return np.asarray(self.centre + self.per_deg * degrees)

    def angles_rad(self, raw: FloatArray) -> FloatArray:
        """Angles in rad of raw positions (18,)."""
        degrees = (raw - self.centre) / self.per_deg - self.offsets_deg
        return np.asarray(np.radians(self.signs * degrees))

    def outside(self, joint_positions_rad: FloatArray) -> BoolArray:
        """Joints whose angles (18,) in rad need a raw position beyond the limits, (18,)."""
        raw = self.raw(joint_positions_rad)
        # Tolerance for an angle at the limit, rounded past it.
        return np.asarray((raw < self.least - 1e-3) | (raw > self.most + 1e-3))

    def limited_raw(self, joint_positions_rad: FloatArray) -> FloatArray:
        """Raw positions of angles (18,) in rad, clipped to the limits."""
        return np.clip(self.raw(joint_positions_rad), self.least, self.most)

    def limited_rad(self, joint_positions_rad: FloatArray) -> FloatArray:
        """Angles (18,) in rad, clipped to the limits."""
        return self.angles_rad(self.limited_raw(joint_positions_rad))

    def flipped(self, joint: int, at_deg: float) -> Self:
        """Map with the opposite sign for a joint, which does not move if it is at this angle."""
        sign = self.signs[joint]
        offset = self.offsets_deg[joint] + 2 * sign * at_deg
        return replace(
            self,
            signs=_with(self.signs, joint, -sign),
            offsets_deg=_with(self.offsets_deg, joint, offset),
        )

    def referenced(self, joint: int, assumed_deg: float, true_deg: float) -> Self:
        """Map in which the raw position of a joint's assumed angle means its true angle."""
        shift = self.signs[joint] * (assumed_deg - true_deg)
        offset = round(float(self.offsets_deg[joint] + shift), 3)
        return replace(self, offsets_deg=_with(self.offsets_deg, joint, offset))

    def limited(self, joint: int, ends: tuple[float, float]) -> Self:
        """Map with other limits for a joint; raises InputError for less than `LEAST_TRAVEL_DEG`."""
        least, most = (float(round(end)) for end in sorted(ends))
        if most - least < (travel := LEAST_TRAVEL_DEG * self.per_deg[joint]):
            raise InputError(
                f"limits: got {least:g} and {most:g} {self.unit}; allowed: {travel:.0f} {self.unit} apart "
                "or more"
            )
        return replace(self, least=_with(self.least, joint, least), most=_with(self.most, joint, most))

    def calibrated_as(self, other: "RawMap") -> Self:
        """Map with the signs, offsets and limits of another one; raises InputError for another unit."""
        if other.unit != self.unit:
            raise InputError(f"servo map: got one in {other.unit}; allowed: in {self.unit}")
        return replace(
            self, signs=other.signs, offsets_deg=other.offsets_deg, least=other.least, most=other.most
        )


def joints_beyond(raw_map: RawMap, robot: Robot) -> tuple[str, ...]:
    """Names of the joints whose range in the robot file exceeds the limits of their servo."""
    outside = raw_map.outside(robot.joint_lower_rad) | raw_map.outside(robot.joint_upper_rad)
    return tuple(name for name, beyond in zip(JOINT_NAMES, outside, strict=True) if beyond)


def joints_without_stance(raw_map: RawMap, robot: Robot) -> dict[str, tuple[float, float, float]]:
    """Joints whose servo limits exclude the stance: lower limit, upper limit and stance in deg, by name."""
    ends_rad = np.sort([raw_map.angles_rad(raw_map.least), raw_map.angles_rad(raw_map.most)], axis=0)
    angles_deg = np.degrees([*ends_rad, robot.stance_angles_rad]).round(1) + 0.0  # no -0
    joints = np.flatnonzero(raw_map.outside(robot.stance_angles_rad)).tolist()
    return {JOINT_NAMES[joint]: tuple(angles_deg[:, joint].tolist()) for joint in joints}


def stance_problems(joints: Mapping[str, tuple[float, float, float]]) -> list[str]:
    """Why joints of `joints_without_stance` cannot stand, a text for each."""
    return [
        f"{name}: got servo limits {low:g} to {high:g} deg; allowed: limits with its stance, {at:g} deg"
        for name, (low, high, at) in joints.items()
    ]


def joints_beyond_travel(raw_map: RawMap, robot: Robot) -> tuple[str, ...]:
    """Names of the joints whose range exceeds the travel of their servo's model."""
    least, most = raw_map.travel
    return joints_beyond(replace(raw_map, least=least, most=most), robot)


def reference_deg(lower_deg: float, upper_deg: float) -> float:
    """Angle easily judged by eye: 0, a right angle, or the middle of the joint's range."""
    for angle in (0.0, -90.0, 90.0):
        if lower_deg + ROOM_DEG <= angle <= upper_deg - ROOM_DEG:
            return angle
    return round((lower_deg + upper_deg) / 2)


def joint_value(section: ServosSection, joint: int, key: str, default: Any) -> Any:
    """Value of a key for a joint, 0..17: its own, else its kind's, else the section's, else a default."""
    for place in (JOINT_NAMES[joint], JOINT_KINDS[joint % JOINTS_PER_LEG], None):
        value = getattr(section if place is None else getattr(section, place), key, None)
        if value is not None:
            return value
    return default


def calibration_of(
    section: ServosSection, unit: str, least: Sequence[float], most: Sequence[float]
) -> dict[str, FloatArray]:
    """Signs, offsets and limits in `us` or `counts`, by field of `RawMap`.

    `least` and `most` are the raw ranges, (18,), where the section has no limits. Raises InputError for
    limits that leave no travel.
    """
    keys = LIMIT_KEYS[unit]
    columns = {"signs": ("sign", [1.0] * N_JOINTS), "offsets_deg": ("offset_deg", [0.0] * N_JOINTS)} | {
        "least": (keys[0], least),
        "most": (keys[1], most),
    }
    read = {
        field: np.array([float(joint_value(section, joint, key, given[joint])) for joint in range(N_JOINTS)])
        for field, (key, given) in columns.items()
    }
    for name, low, high in zip(JOINT_NAMES, read["least"], read["most"], strict=True):
        if low >= high:
            raise InputError(
                f"servos.{name}: got {keys[0]} {low:g} and {keys[1]} {high:g}; allowed: {keys[0]} below "
                f"{keys[1]}"
            )
    return read


def check_driver(section: ServosSection, driver: str, *, has_keys: bool = False) -> None:
    """Raise InputError for a section of another driver, and for keys in `board` if the driver has none."""
    if section.board and not has_keys:
        raise InputError(f"servos.board: got {', '.join(section.board)}; allowed: no keys with {driver}")
    if section.driver not in (None, driver):
        raise InputError(f"servos.driver: got {section.driver}; allowed: {driver}, with the backend {driver}")


def check_once(key: str, names: Sequence[str], values: NDArray[np.int64]) -> None:
    """Raise InputError unless each value, one for each name, is unique."""
    for value in values.tolist():
        sharing = [name for name, own in zip(names, values.tolist(), strict=True) if own == value]
        if len(sharing) > 1:
            raise InputError(
                f"servos: got {key} {value} for {' and '.join(sharing)}; allowed: each {key} once"
            )


def _with(values: FloatArray, joint: int, value: float) -> FloatArray:
    changed = np.array(values, dtype=float)
    changed[joint] = value
    return changed
