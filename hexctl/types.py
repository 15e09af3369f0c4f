"""Common types: arrays, legs and joints (leg-major order), joint targets and robot state."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError, WrongTypeError, check_type, shown

N_LEGS = 6
JOINTS_PER_LEG = 3
N_JOINTS = N_LEGS * JOINTS_PER_LEG

#: Joints of one leg, from the body outward.
JOINT_KINDS = ("coxa", "femur", "tibia")

#: All 18 joints in the order of every joint array: leg 1 coxa, femur, tibia, leg 2 ...
JOINT_NAMES = tuple(f"leg{leg}_{kind}" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS)


def joint_in_words(joint: int) -> str:
    """Name of joint 0..17 in messages: `leg 2 femur`."""
    return f"leg {joint // JOINTS_PER_LEG + 1} {JOINT_KINDS[joint % JOINTS_PER_LEG]}"


def leg_slice(leg: int) -> slice:
    """Indices of the three joints of leg 1..6 in an array of 18."""
    return slice(JOINTS_PER_LEG * (leg - 1), JOINTS_PER_LEG * leg)


FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def by_leg(joints: NDArray[Any]) -> NDArray[Any]:
    """Values of all joints, (..., 18), as those of each leg, (..., 6, 3)."""
    return joints.reshape(*joints.shape[:-1], N_LEGS, JOINTS_PER_LEG)


def chosen(condition: BoolArray | np.bool_, yes: FloatArray | float, no: FloatArray | float) -> FloatArray:
    """`np.where`, ten times as fast for the scalars of a single robot."""
    if isinstance(condition, np.bool_):
        return yes if condition else no  # type: ignore[return-value]
    return np.where(condition, yes, no)


def within(value: FloatArray, most: FloatArray) -> FloatArray:
    """Value clipped to -most .. most, or NaN; faster than NumPy for the scalars of a single robot."""
    if isinstance(value, np.floating):
        return most if value > most else -most if value < -most else value
    return np.minimum(np.maximum(value, -most), most)


def any_of(condition: BoolArray | np.bool_) -> bool:
    """`condition.any()`, faster for a scalar."""
    return bool(condition) if isinstance(condition, np.bool_) else bool(condition.any())


def all_finite(values: FloatArray) -> bool:
    """Whether a few numbers, (n,), are all finite: so is their sum, the fastest test."""
    return math.isfinite(sum(values.tolist()))


class ArrayFields:
    """Equality of dataclasses with array fields.

    Two values are equal if their classes and all their fields are: arrays by shape and elements, also within
    tuples, lists and mappings; NaN equals NaN. Fields with `compare=False` are ignored. The dataclass's own
    equality must be off, because it raises for arrays:

        @dataclass(frozen=True, slots=True, eq=False)
        class Walk(ArrayFields):
            path_m: FloatArray

    Such a class has no hash unless it defines one.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        names = (field.name for field in fields(self) if field.compare)  # type: ignore[arg-type]
        return all(same_value(getattr(self, name), getattr(other, name)) for name in names)

    def copy(self) -> Self:
        """The same value, with copies of its arrays."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        arrays = {
            name: value.copy()
            for name, value in values.items()
            if isinstance(value, np.ndarray | ArrayFields)
        }
        return replace(self, **arrays)  # type: ignore[type-var]


def same_value(one: Any, other: Any) -> bool:
    """Whether two values are equal: arrays by shape and elements, containers by contents, NaN to NaN."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        both = isinstance(one, np.ndarray) and isinstance(other, np.ndarray)
        return both and bool(_same_array(one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same_value(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and type(one) is type(other):
        return len(one) == len(other) and all(map(same_value, one, other))
    return bool(one == other) or bool(one != one and other != other)


def _same_array(one: NDArray[Any], other: NDArray[Any]) -> bool:
    inexact = np.issubdtype(one.dtype, np.inexact) and np.issubdtype(other.dtype, np.inexact)
    return np.array_equal(one, other, equal_nan=inexact)


def check_shape(value: object, shape: tuple[int, ...], what: str) -> None:
    """Raise WrongTypeError unless a value is an array, and InputError unless it has the given shape."""
    check_type(value, np.ndarray, what, f"an array of shape {shape}")
    if isinstance(value, np.ndarray) and value.shape != shape:
        raise InputError(f"{what}: got an array of shape {value.shape}; allowed: shape {shape}")


def check_finite(value: object, shape: tuple[int, ...], what: str) -> None:
    """Raise what `check_shape` raises, and InputError for non-finite elements."""
    check_shape(value, shape, what)
    numbers = np.asarray(value)
    if not np.issubdtype(numbers.dtype, np.number):
        raise InputError(f"{what}: got an array of {numbers.dtype}; allowed: numbers")
    if not np.isfinite(numbers).all():
        bad = numbers[~np.isfinite(numbers)][0]
        raise InputError(f"{what}: got {bad}; allowed: finite numbers")


def as_numbers(value: object, ending: tuple[int, ...], what: str) -> FloatArray:
    """Finite numbers as an array with a given end of its shape; raises WrongTypeError or InputError."""
    numbers = _numbers_of(value, what, f"numbers of a shape that ends in {ending}")
    if numbers.shape[max(0, numbers.ndim - len(ending)) :] != ending:
        raise InputError(f"{what}: got shape {numbers.shape}; allowed: a shape that ends in {ending}")
    check_finite(numbers, numbers.shape, what)
    return numbers


def as_joint_angles(value: object, what: str, *, leading_shape: tuple[int, ...] | None = None) -> FloatArray:
    """Joint angles as an array, leading shape (None: any) + (18,); raises WrongTypeError or InputError."""
    angles_rad = _numbers_of(value, what, f"{N_JOINTS} joint angles in rad")
    shape = angles_rad.shape
    if leading_shape is None or shape[:-1] == leading_shape:
        if shape[-1:] != (N_JOINTS,):
            got = shape[-1] if shape else "one number"
            raise InputError(
                f"{what}: expected {N_JOINTS} joint angles, got {got}; "
                f"allowed: coxa, femur and tibia of legs 1 to {N_LEGS}, in rad"
            )
        return angles_rad
    raise InputError(
        f"{what}: expected {N_JOINTS} joint angles, got shape {shape}; "
        f"allowed: shape {(*leading_shape, N_JOINTS)}"
    )


def _numbers_of(value: object, what: str, allowed: str) -> FloatArray:
    """An array of floats is returned itself."""
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return value
    try:
        numbers = np.asarray(value)
    except ValueError:  # rows of different lengths
        numbers = np.asarray(None)
    if numbers.dtype.kind not in "fiu":
        raise WrongTypeError(f"{what}: got {shown(value)} ({type(value).__name__}); allowed: {allowed}")
    return numbers.astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class JointTargets(ArrayFields):
    """Target angles of the 18 joints.

    Attributes:
        joint_positions_rad: joint angles, shape (18,), leg-major order.
        stamp_s: time of the command, on the clock of its servos.
    """

    joint_positions_rad: FloatArray
    stamp_s: float


GRAVITY_M_S2 = 9.81

#: A servo this hot stops the robot (most switch off at 70 to 80 C), and one this warm slows it.
TOO_HOT_C, WARM_C = 68.0, 60.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ServoReadings(ArrayFields):
    """Readings of single servos; each (18,), leg-major, NaN if unknown.

    Attributes:
        ages_s: since the measurement of each joint's position; infinite without one.
        efforts: share of the maximum torque or power of each servo, -1 to 1.
        currents_a: through the motors.
        voltages_v: at the servos.
        temperatures_c: of the servos.
        errors: short fault description of each servo; empty without.
    """

    ages_s: FloatArray
    efforts: FloatArray
    currents_a: FloatArray
    voltages_v: FloatArray
    temperatures_c: FloatArray
    errors: tuple[str, ...] = ("",) * N_JOINTS

    @property
    def hottest_joint(self) -> int | None:
        """Index of the joint with the hottest servo, or None if no temperature is known."""
        known = np.isfinite(self.temperatures_c)
        return int(np.nanargmax(self.temperatures_c)) if known.any() else None

    def to_json(self) -> dict[str, Any]:
        """JSON values by attribute, numbers to three decimals; None if unknown."""
        numbers = {
            field.name: [round(one, 3) if math.isfinite(one) else None for one in value.tolist()]
            for field in fields(self)
            if isinstance(value := getattr(self, field.name), np.ndarray)
        }
        return {**numbers, "errors": list(self.errors)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "ServoReadings":
        """Inverse of `to_json`; raises KeyError, TypeError or ValueError for anything else."""
        numbers = {
            field.name: np.array([np.nan if one is None else one for one in data[field.name]], dtype=float)
            for field in fields(cls)
            if field.name != "errors"
        }
        errors = tuple(str(each) for each in data["errors"])
        if any(value.shape != (N_JOINTS,) for value in numbers.values()) or len(errors) != N_JOINTS:
            raise ValueError(f"got readings of another number of servos; allowed: {N_JOINTS}")
        ages_s = numbers.pop("ages_s")
        return cls(ages_s=np.where(np.isnan(ages_s), np.inf, ages_s), **numbers, errors=errors)


@dataclass(frozen=True, slots=True, eq=False)
class RobotState(ArrayFields):
    """State of a robot at one moment, as reported by its servos.

    Attributes:
        joint_positions_rad: shape (18,), leg-major order.
        stamp_s: time of the measurement, on the clock of the servos.
        measured: True for positions from sensors, False for an echo of the targets.
        base_position_world: body frame origin in the world, (3,) in m, or None if unknown.
        base_quaternion_world: body frame orientation (w, x, y, z), (4,), or None if unknown.
        foot_contacts: which feet touch the floor, (6,), or None if unknown.
        age_s: age of the measurement when it was read.
        healthy: False when the robot reports a fault.
        fault: short description, or None; of a healthy robot, why there was no new measurement for a while.
        stopped: reason of the stop of the robot's own guard, or None.
        battery_v: None if unknown.
        battery_share: remaining charge, 0 to 1, or None if unknown.
        low_battery_v: voltage of the battery below which the robot should sit down, or None.
        joint_torques_nm: torques of the actuators on the joints, (18,), positive with growing angle, mean of
            the control period up to the stamp if possible, else momentary; None if unknown.
        servos: readings of single servos, or None.
        warnings: short descriptions of conditions other than faults.
        current_a: of all servos together, or None if unknown.
        stale_joints: joints whose servos have been silent for longer than usual, (18,): their positions and
            torques are older than the stamp; None if there are none.
        joint_velocities_rad_s: (18,), momentary at the stamp, or None if unknown; simulated without noise.
        angular_velocity_body_rad_s: of the body, about its own axes, (3,), momentary at the stamp, or None if
            unknown; simulated without noise.
    """

    joint_positions_rad: FloatArray
    stamp_s: float
    measured: bool
    base_position_world: FloatArray | None = None
    base_quaternion_world: FloatArray | None = None
    foot_contacts: BoolArray | None = None
    age_s: float = 0.0
    healthy: bool = True
    fault: str | None = None
    stopped: str | None = None
    battery_v: float | None = None
    battery_share: float | None = None
    joint_torques_nm: FloatArray | None = None
    servos: ServoReadings | None = None
    warnings: tuple[str, ...] = ()
    current_a: float | None = None
    low_battery_v: float | None = None
    stale_joints: BoolArray | None = None
    joint_velocities_rad_s: FloatArray | None = None
    angular_velocity_body_rad_s: FloatArray | None = None
