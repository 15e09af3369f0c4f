"""The series of a recording: stored, plotted and read back, each declared once."""

from itertools import cycle, islice
from typing import NamedTuple

import numpy as np

from hexctl.columns import COARSE_BITS, FINE_BITS, READINGS, RECORDED, Column
from hexctl.palette import ALARM_COLOR, JOINT_COLORS, LEG_COLORS, MARGIN_COLOR
from hexctl.recording import paths, style
from hexctl.types import JOINT_KINDS, JOINT_NAMES, N_JOINTS, N_LEGS, FloatArray

#: Binary places of joint angles: steps of 0.014 degrees, a sixth of what servos resolve.
ANGLE_BITS = 12


def rounded(values: FloatArray, bits: int) -> FloatArray:
    """Values rounded to a number of binary places: trailing zeros compress well."""
    return np.asarray(np.round(values * 2.0**bits) / 2.0**bits)


class Series(NamedTuple):
    """Numbers of one entity, with a line each in a plot; `bits` are stored binary places.

    Attributes:
        source: column of the log, or attribute of `ServoReadings`; empty if a track calculates the numbers.
    """

    path: str
    title: str
    names: tuple[str, ...]
    colors: tuple[style.Color, ...]
    bits: int = FINE_BITS
    widths: tuple[float, ...] | None = None
    source: str = ""


_JOINT_COLORS = tuple(JOINT_COLORS[kind][1] for kind in JOINT_KINDS) * N_LEGS


def series_of(column: Column) -> Series:
    """Series of a column of the log."""
    entity, count = column.entity or column.name, len(column.parts)
    colors = tuple(islice(cycle(_JOINT_COLORS if count == N_JOINTS else LEG_COLORS), count))
    return Series(entity, column.title, column.parts, colors, column.bits, source=column.name)


DEVIATION = Series(
    "deviation",
    "deviation from the line (m), left +",
    ("left of the line (m)",),
    (style.DEVIATION_COLOR,),
    widths=(2.0,),
)
MARGIN = Series(
    "stability_margin",
    "stability margin (m), unstable below 0",
    ("inside the feet (m)",),
    (MARGIN_COLOR,),
    widths=(2.0,),
)
ORIENTATION = Series("orientation", "orientation", ("w", "x", "y", "z"), LEG_COLORS[:4])
SUSPICION = Series(
    "leg_suspicion",
    "evidence, alarm at 1",
    (*(f"leg {leg}" for leg in paths.LEGS), "alarm"),
    (*LEG_COLORS, ALARM_COLOR),
    COARSE_BITS,
    widths=(1.5,) * (N_LEGS + 1),
)


def _angles(path: str, source: str, which: int, width: float) -> Series:
    """Angles of all joints; the first colour of a joint is for its commanded angle."""
    names = tuple(f"{name} {source.removesuffix('_rad')}" for name in JOINT_NAMES)
    colors = tuple(JOINT_COLORS[kind][which] for kind in JOINT_KINDS) * N_LEGS
    widths = (width,) * len(names)
    return Series(path, "joint angles (rad)", names, colors, ANGLE_BITS, widths, source)


#: Series at every tick: the vectors that converters to LeRobot look for.
ACTION = _angles("action", "commanded_rad", 0, 3.0)
OBSERVATION = _angles("observation/state", "measured_rad", 1, 1.2)
VECTORS = (ACTION, OBSERVATION)

#: Columns of the log that are stored as they are, and reports of single servos, at 1 Hz.
SENSORS = tuple(map(series_of, RECORDED))
SERVOS = tuple(series_of(column) for column in READINGS if column.entity is not None)

#: Series of each walk, if known.
WALK = (DEVIATION, MARGIN, SUSPICION, *SENSORS, *VECTORS)
