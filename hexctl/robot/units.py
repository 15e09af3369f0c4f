"""Quantities of a robot file, and the likely units of values that no robot has.

Each quantity has bounds far from those of walking robots, and a usual value. A value outside its bounds is
converted from the units of data sheets and drawings; those that bring it near the usual value are likely.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from hexctl.types import JOINT_KINDS

#: Factors from other units to those of a robot file.
LENGTHS = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}
MASSES = {"g": 1e-3, "oz": 0.02835, "lb": 0.4536}
TORQUES = {"kg cm": 0.0981, "oz in": 0.00706, "N cm": 1e-2, "mN m": 1e-3, "g cm": 9.81e-5}
SPEEDS = {"rpm": 6.0, "rad/s": math.degrees(1)}
INERTIAS = {"g cm2": 1e-7, "kg cm2": 1e-4, "kg mm2": 1e-6, "g mm2": 1e-9}
RADIANS = {"rad": math.degrees(1)}

#: Units of speeds that are a time, and the number that is divided by it.
TIMES = {"s/60 deg": 60.0}

#: A converted value is possible up to the first factor from the usual one, and likely up to the second.
NEAR, LIKELY = 5.0, 2.5

#: Slowest servo of a leg without load, 0.6 s for 60 degrees, and fastest actuator, 60 rad/s, in deg/s.
SPEEDS_DEG_S = (100.0, math.degrees(60.0))

#: Commands to joints are no slower than this, in deg/s, however slow the servos are.
LEAST_SPEED_DEG_S = 10.0


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of a robot file: its unit, bounds, usual value, and factors from other units."""

    unit: str
    least: float
    most: float
    usual: float
    factors: Mapping[str, float]
    dividends: Mapping[str, float] = field(default_factory=dict)

    def outside(self, value: float) -> bool:
        """Whether no robot has this value; 0 is none."""
        return value != 0 and not self.least <= abs(value) <= self.most

    def likely(self, values: Sequence[float]) -> str:
        """Likely units of values in their place, the nearest first, with the converted values."""
        ways = {f"in {unit}": [value * factor for value in values] for unit, factor in self.factors.items()}
        ways |= {f"in {unit}": [given / value for value in values] for unit, given in self.dividends.items()}
        if min(map(self._distance, ways.values())) > LIKELY:
            places = round(math.log10(self.usual / _typical(values)))
            ways["with the decimal point moved"] = [value * 10.0**places for value in values]
        near = {way: values for way, values in ways.items() if self._distance(values) <= NEAR}
        found = sorted(near, key=lambda way: self._distance(near[way]))
        return " or ".join(f"{way} that is {numbers(near[way])} {self.unit}" for way in found)

    def _distance(self, values: Sequence[float]) -> float:
        """Factor between values and the usual one, 1 or more."""
        return math.exp(abs(math.log(_typical(values) / self.usual)))


def _length(usual_m: float, most_m: float = 1.0) -> Quantity:
    return Quantity("m", 0.0, most_m, usual_m, LENGTHS)


#: Quantities by key, without the kind of joint or link.
QUANTITIES = {
    "size_m": _length(0.5, 10.0),
    "body.size_m": _length(0.2),
    "body.com_m": _length(0.02),
    "body.mass_kg": Quantity("kg", 0.02, 20.0, 1.2, MASSES),
    "mounts.position_m": _length(0.1),
    "mounts.radius_m": _length(0.1),
    "links.end_m": _length(0.08),
    "links.mass_kg": Quantity("kg", 0.0005, 2.0, 0.08, MASSES),
    "links.radius_m": _length(0.012, 0.1),
    "links.com_m": _length(0.03),
    "foot_radius_m": _length(0.01, 0.1),
    "joints.max_speed_deg_s": Quantity("deg/s", LEAST_SPEED_DEG_S, SPEEDS_DEG_S[1], 300.0, SPEEDS, TIMES),
    "joints.max_torque_nm": Quantity("N m", 0.01, 60.0, 1.5, TORQUES),
    "joints.no_load_speed_deg_s": Quantity("deg/s", *SPEEDS_DEG_S, 360.0, SPEEDS, TIMES),
    "stance.outward_m": _length(0.13),
    "stance.up_m": _length(0.1),
    "servo.stiffness_nm_per_rad": Quantity("N m/rad", 0.5, 1000.0, 15.0, {"N m/deg": math.degrees(1)}),
    "servo.rotor_inertia_kg_m2": Quantity("kg m2", 1e-6, 0.3, 0.004, INERTIAS),
    "servo.dead_time_s": Quantity("s", 0.0, 0.1, 0.02, {"ms": 1e-3}),
    "servos.low_battery_v": Quantity("V", 3.0, 60.0, 10.0, {"mV": 1e-3}),
}


def likely_unit(location: Iterable[int | str], value: object) -> str:
    """Likely units of a value at a location such as `("links", "tibia", "end_m", 0)`; empty if not known."""
    keys = (part for part in location if isinstance(part, str) and part not in JOINT_KINDS)
    quantity = QUANTITIES.get(".".join(keys))
    if quantity is None or not isinstance(value, int | float) or not math.isfinite(value):
        return ""
    return quantity.likely([value]) if quantity.outside(value) else ""


def in_likely_unit(values: Sequence[float], unit: str, usual: float, factors: Mapping[str, float]) -> str:
    """Likely units of values that no robot has, with the converted values, by their usual value."""
    return Quantity(unit, 0.0, 0.0, usual, factors).likely(values)


def doubt(key: str, values: Sequence[float], usual: str, quantity: Quantity) -> str:
    """One line about values of a key: what was got, what is usual, and the likely units."""
    likely = quantity.likely(values)
    return f"{key}: got {numbers(values)} {quantity.unit}; usual: {usual}" + (f"; {likely}" if likely else "")


def numbers(values: Iterable[float]) -> str:
    """Different values with three digits, separated by commas."""
    return ", ".join(dict.fromkeys(f"{value:.3g}" for value in values))


def _typical(values: Sequence[float]) -> float:
    """Geometric mean of the magnitudes of values that are not all 0."""
    logarithms = [math.log(abs(value)) for value in values if value]
    return math.exp(sum(logarithms) / len(logarithms))
