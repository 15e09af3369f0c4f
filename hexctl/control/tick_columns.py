"""Ticks of a trial as columns of a table, with a value per tick each: the names of files and data frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.control.trace import PHASES
from hexctl.types import JOINT_NAMES, N_LEGS, BoolArray, FloatArray

LEG_NAMES = tuple(f"leg{leg}" for leg in range(1, N_LEGS + 1))


def tick_columns(
    *,
    time_s: FloatArray,
    walk_s: FloatArray,
    phases: NDArray[np.int64],
    commanded_rad: FloatArray,
    measured_rad: FloatArray,
    base_position_world: FloatArray,
    base_quaternion_world: FloatArray,
    foot_contacts: BoolArray | None,
    torques_nm: FloatArray,
    velocity_body: FloatArray,
    leg_suspicion: FloatArray,
) -> dict[str, Any]:
    """Columns (T,) by name, in the order of a table; NaN where a value is not known.

    Args:
        time_s: since the first tick.
        walk_s: since the walk began; 0 before it.
        phases: indices in `hexctl.control.trace.PHASES`.
        commanded_rad: joint angles that were sent, (T, 18).
        measured_rad: joint angles that came back, (T, 18).
        base_position_world: (T, 3) in m.
        base_quaternion_world: (T, 4) as w, x, y, z.
        foot_contacts: which feet touch the floor, (T, 6); None if it is not measured.
        torques_nm: of the joints, (T, 18).
        velocity_body: commanded, forward and left in m/s, turn in rad/s, (T, 3).
        leg_suspicion: evidence against each leg, (T, 6).
    """
    contacts = np.full((len(time_s), N_LEGS), np.nan) if foot_contacts is None else foot_contacts
    columns: dict[str, Any] = {"time_s": time_s, "walk_s": walk_s, "phase": np.array(PHASES)[phases]}
    columns |= joint_columns("commanded", "rad", commanded_rad)
    columns |= joint_columns("measured", "rad", measured_rad)
    columns |= {f"base_{axis}_m": base_position_world[:, place] for place, axis in enumerate("xyz")}
    columns |= {f"base_q{axis}": base_quaternion_world[:, place] for place, axis in enumerate("wxyz")}
    columns |= _named("contact", LEG_NAMES, "", contacts)
    columns |= joint_columns("torque", "nm", torques_nm)
    columns |= _named("commanded", ("forward_m_s", "left_m_s", "turn_rad_s"), "", velocity_body)
    return columns | _named("suspicion", LEG_NAMES, "", leg_suspicion)


def joint_columns(what: str, unit: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Columns of the 18 joints, such as `measured_leg1_coxa_rad`, of values (T, 18)."""
    return _named(what, JOINT_NAMES, unit, values)


def _named(what: str, names: Sequence[str], unit: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {"_".join(filter(None, (what, name, unit))): values[:, place] for place, name in enumerate(names)}
