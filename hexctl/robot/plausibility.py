"""Whether a file counts in SI units, by density, span and period: robot files, descriptions and bench runs.

Bounds are far from any robot: a factor of 10 in lengths, or of 1000 in masses, leaves them.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hexctl.robot.units import LENGTHS, MASSES, RADIANS, in_likely_unit
from hexctl.types import FloatArray

#: Density above which no part is, with `MARGIN_M` added to each side: servos stick out of links.
MOST_KG_M3, MARGIN_M = 4000.0, 0.05

#: Mass of a robot per cube of its legs: shipped and published ones have 40 to 250 kg/m3, the lightest, with
#: legs of 2.4 m, 4, and one whose legs are shorter than its servos some thousands.
LEG_KG_M3 = (1.5, 2e4)

#: Usual mass per cube of the legs, and length of a leg.
USUAL_KG_M3, USUAL_LEG_M = 100.0, 0.25

#: Usual mass (of 20 g to 2 kg), length, largest angle (of 8 degrees to half a turn) and period on a bench.
BENCH_KG, BENCH_M, BENCH_RAD, BENCH_S = 0.2, 0.15, 0.66, 0.02
ANGLES = {"deg": 1 / RADIANS["rad"], "counts of 4096": math.tau / 4096}
TIMES = {"ms": 1e-3, "us": 1e-6}

#: A leg or a bar of a bench is no longer, a part no heavier.
MOST_LEG_M, MOST_MASS_KG, MOST_BAR_M, MOST_BENCH_KG = 10.0, 1000.0, 2.0, 50.0

#: Torques of servos, from the smallest hobby servo to the largest actuator of a leg.
TORQUES_NM = (0.03, 60.0)

#: A joint that turns further than two turns, or within less than 6.3 degrees, counts in the other unit.
MOST_RANGE_DEG, LEAST_RANGE_DEG = 720.0, math.tau

#: Largest angle of a servo on a bench, periods at which one is read, and the longest time without a reading.
MOST_BENCH_RAD, BENCH_PERIODS_S, MOST_GAP_S = 1.1 * math.pi, (2e-4, 0.5), 10.0

#: Sums of moments of inertia as multiples of those of the filled shape: trunks of published robots have
#: 0.5 to 2.1, links, which are less like capsules, 0.3 to 6.7; all mass in the middle 40 % of a trunk has a
#: sixth, at its corners three.
TRUNK_INERTIAS, LINK_INERTIAS = (1 / 6, 4.0), (1 / 8, 8.0)


def too_dense(mass_kg: float, size_m: Sequence[float]) -> bool:
    """Whether a part is heavier than any robot's of its length, width and height."""
    return mass_kg > MOST_KG_M3 * float(np.prod(np.array(size_m) + MARGIN_M))


def mass_problem(
    parts: Mapping[str, tuple[float, Sequence[float]]], robot_kg: float | None, leg_m: float
) -> str:
    """Why masses and lengths do not fit together, or an empty text.

    Args:
        parts: mass in kg, and length, width and height in m, of trunk, coxa, femur and tibia.
        robot_kg: mass of the robot; None if parts have placeholders.
        leg_m: length of a leg.
    """
    usual_kg = USUAL_KG_M3 * leg_m**3
    if leg_m > MOST_LEG_M:
        likely = in_likely_unit([leg_m], "m", USUAL_LEG_M, LENGTHS)
        return f"got legs of {leg_m:.4g} m; allowed: up to {MOST_LEG_M:g} m; {likely}"
    kind, (mass_kg, _) = max(parts.items(), key=lambda part: part[1][0])
    if mass_kg > MOST_MASS_KG:
        likely = in_likely_unit([mass_kg], "kg", usual_kg, MASSES)
        return f"got a {kind} of {mass_kg:.4g} kg; allowed: up to {MOST_MASS_KG:g} kg; {likely}"
    dense = [name for name, (part_kg, size_m) in parts.items() if too_dense(part_kg, size_m)]
    if len(dense) > len(parts) / 2:
        masses_kg = [part_kg for part_kg, _ in parts.values()]
        masses = ", ".join(f"{name} {part_kg:.4g} kg" for name, (part_kg, _) in parts.items())
        return (
            f"got masses of {masses} with legs of {leg_m:.3g} m; allowed: parts of up to "
            f"{MOST_KG_M3:g} kg/m3; {in_likely_unit(masses_kg, 'kg', usual_kg / 10, MASSES)}"
        )
    low_kg, high_kg = (density * leg_m**3 for density in LEG_KG_M3)
    if robot_kg is not None and not low_kg <= robot_kg <= high_kg:
        likely = f"legs {in_likely_unit([leg_m], 'm', (robot_kg / USUAL_KG_M3) ** (1 / 3), LENGTHS)}"
        if robot_kg > high_kg:
            likely += f"; masses {in_likely_unit([robot_kg], 'kg', usual_kg, MASSES)}"
        return (
            f"got a robot of {robot_kg:.3g} kg with legs of {leg_m:.3g} m; "
            f"allowed: {low_kg:.2g} to {high_kg:.2g} kg; {likely}"
        )
    return ""


def inertia_problem(moments: FloatArray, even: Sequence[float], bounds: tuple[float, float]) -> str:
    """Why moments of inertia are of another mass than those of the evenly filled shape, or an empty text.

    Moments are about three axes each, in any order.
    """
    share = float(np.sum(moments)) / sum(even)
    if bounds[0] <= share <= bounds[1]:
        return ""
    return f"got moments of inertia {share:.2g} times those of the filled shape; is the mass another?"


def bench_problem(mass_kg: float, length_m: float, angles_rad: FloatArray, time_s: FloatArray) -> str:
    """Why a run of a servo on a bench is not in kg, m, rad and s, or an empty text; angles are (N, 2)."""
    load_nm, most_rad = 9.81 * mass_kg * length_m, float(np.abs(angles_rad).max())
    period_s, gap_s = float(np.median(np.diff(time_s))), float(np.diff(time_s).max())
    likely_mass = in_likely_unit([mass_kg], "kg", BENCH_KG, MASSES)
    likely_length = in_likely_unit([length_m], "m", BENCH_M, LENGTHS)
    if mass_kg > MOST_BENCH_KG:
        return f"mass: got {mass_kg:g} kg; allowed: up to {MOST_BENCH_KG:g} kg; {likely_mass}"
    if length_m > MOST_BAR_M:
        return f"length: got {length_m:g} m; allowed: up to {MOST_BAR_M:g} m; {likely_length}"
    if load_nm > TORQUES_NM[1]:
        likely = likely_mass if mass_kg / BENCH_KG > length_m / BENCH_M else likely_length
        return f"mass and length: got a load of {load_nm:.3g} N m; allowed: up to {TORQUES_NM[1]:g}; {likely}"
    if most_rad > MOST_BENCH_RAD:
        likely = in_likely_unit([most_rad], "rad", BENCH_RAD, ANGLES)
        return (
            f"position, goal_position: got {most_rad:.4g} rad; allowed: up to {MOST_BENCH_RAD:.3g}; {likely}"
        )
    if not BENCH_PERIODS_S[0] <= period_s <= BENCH_PERIODS_S[1]:
        likely = in_likely_unit([period_s], "s", BENCH_S, TIMES)
        return (
            f"timestamp: got a period of {period_s:.3g} s; allowed: {BENCH_PERIODS_S[0]:g} to "
            f"{BENCH_PERIODS_S[1]:g}; {likely}"
        )
    if gap_s > MOST_GAP_S:
        return f"timestamp: got a gap of {gap_s:.4g} s; allowed: up to {MOST_GAP_S:g} s; cut the run there"
    return ""
