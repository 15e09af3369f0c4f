"""Bounds of plausible numbers of an import, and usual values for the others."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from hexctl.robot.plausibility import TORQUES_NM, inertia_problem
from hexctl.types import JOINT_KINDS, N_LEGS, FloatArray

# Used for missing or implausible numbers, and listed as unknown: a typical robot of this kind, with legs of
# this length. Lengths and masses of smaller and larger robots follow from it.
USUAL_LEG_M = 0.25
USUAL_MASS_KG = {"body": 1.0, "coxa": 0.03, "femur": 0.07, "tibia": 0.08}
USUAL_TORQUE_NM, USUAL_SPEED_DEG_S, USUAL_RANGE_DEG = 1.5, 200.0, 90.0
USUAL_RADIUS_M, USUAL_FOOT_M, USUAL_HEIGHT_M = 0.010, 0.008, 0.05
#: Torque of a femur joint per mass of the robot and length of femur and tibia: twice what carries it on three
#: legs that reach out by half their length.
NM_PER_KG_M = 2 * 9.81 / 3 / 2
#: A torque that carries less than this share of a usual robot is doubted: the lightest shipped one has 0.54.
LEAST_CARRIED = 0.5
#: Speeds of servos, from the smallest hobby servo to the largest actuator of a leg.
SPEEDS_DEG_S = (math.degrees(0.2), math.degrees(60.0))
#: A lighter part of a usual robot is a placeholder.
LEAST_MASS_KG = 0.001
#: Minimum density of a trunk's box; a lighter one is a placeholder. The lightest shipped robot has 165.
LEAST_TRUNK_KG_M3 = 20.0
#: A wider range is that of a motor, and a narrower one of no joint of a leg.
RANGES_DEG = (5.0, 340.0)


@dataclass(frozen=True, slots=True)
class Findings:
    """Reasons of unknown keys, and notes on omissions and changes, collected during an import."""

    reasons: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def plausible(
        self,
        key: str,
        values: Sequence[float | None],
        bounds: tuple[float, float],
        unit: str,
        usual: float,
        why: str = "",
    ) -> float:
        """Smallest plausible value of six joints, else a usual one; unknown if one is not plausible."""
        low, high = bounds
        good = [value for value in values if value is not None and low <= value <= high]
        found = min(good, default=usual)
        if len(good) < len(values):
            bad = next(value for value in values if value is None or not low <= value <= high)
            got = "is missing" if bad is None else f"got {bad:.4g}; plausible: {low:.4g} to {high:.4g} {unit}"
            self.reasons[key] = f"{got}; {found:.4g} {unit}{'' if good else why} were assumed"
        return found


def rounded(value: float) -> float:
    """A number with nine significant digits, without a negative zero."""
    return float(f"{float(value):.9g}") + 0.0 if abs(value) > 1e-12 else 0.0


def least_mass_kg(leg_m: float) -> float:
    """Mass below which a part is a placeholder."""
    return LEAST_MASS_KG * min(1.0, leg_m / USUAL_LEG_M) ** 3


@dataclass(frozen=True, slots=True)
class UsualMasses:
    """Assumed masses of trunk (`body`), coxa, femur and tibia, and what they follow from."""

    parts_kg: dict[str, float]
    basis: str

    @classmethod
    def of(cls, leg_m: float, moving_m: float, torques_nm: Sequence[float | None]) -> Self:
        """Masses by size, and at most what the femur joints carry.

        A leg is `leg_m` long from coxa to foot, femur and tibia `moving_m`. Torques that are not plausible,
        or carry no robot of this size, do not count.
        """
        whole_kg = USUAL_MASS_KG["body"] + N_LEGS * sum(USUAL_MASS_KG[kind] for kind in JOINT_KINDS)
        share, basis = (leg_m / USUAL_LEG_M) ** 3, "size"
        torque_nm, most_nm = (pick(one or 0.0 for one in torques_nm) for pick in (min, max))
        carried = torque_nm / (NM_PER_KG_M * moving_m) / whole_kg
        plausible = TORQUES_NM[0] <= torque_nm and most_nm <= TORQUES_NM[1]
        if plausible and LEAST_CARRIED * share <= carried < share:
            share, basis = carried, f"torque of {torque_nm:g} N m"
        return cls({part: float(f"{share * mass_kg:.3g}") for part, mass_kg in USUAL_MASS_KG.items()}, basis)

    def reason(self, got_kg: float, part: str) -> str:
        """Reason of a replaced mass."""
        got = f"got {got_kg:g} kg, which is a placeholder" if got_kg > 0 else "it is missing"
        return f"{got}; {self.parts_kg[part]:g} kg, for its {self.basis}, were assumed"


def possible_tensor(
    tensor: FloatArray, even: Sequence[float], bounds: tuple[float, float]
) -> tuple[FloatArray, str]:
    """A tensor of inertia, (3, 3), and a problem with it or an empty text.

    Of a flat part, whose largest principal moment is the sum of the others, it is reduced by a millionth.

    Args:
        even: moments about three axes of the evenly filled part.
        bounds: of the sum of the moments, as multiples of these.
    """
    moments, axes = np.linalg.eigh(tensor)
    if problem := inertia_problem(moments, even, bounds):
        return tensor, problem
    others = moments[0] + moments[1]
    if moments[0] <= 0 or moments[2] > 1.001 * others:
        return tensor, "got moments of inertia that no body has"
    excess = max(0.0, moments[2] - others * (1 - 1e-6))
    return tensor - excess * np.outer(axes[:, 2], axes[:, 2]), ""
