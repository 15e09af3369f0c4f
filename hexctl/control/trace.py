"""The trace of a trial: base poses at every tick, and the frame in which the walk is scored."""

from dataclasses import dataclass

import numpy as np

from hexctl.columns import Column
from hexctl.control.table import Table
from hexctl.control.telemetry_watch import SeenWarnings
from hexctl.types import ArrayFields, FloatArray, RobotState

#: The phases of a trial, in order.
PHASES = ("settle", "turn", "walk", "stop")

#: Time on the servos' clock, and base poses: positions in m, the true one of a simulation, and (w, x, y, z).
COLUMNS = (
    Column("time_s"),
    Column("position_world", (3,)),
    Column("quaternion_world", (4,)),
    Column("true_position_world", (3,)),
)


@dataclass(frozen=True, slots=True, eq=False)
class TrialFrame(ArrayFields):
    """Frame of a trial, fixed at the start of its walk: origin there, x along the commanded heading.

    Attributes:
        origin_world: (3,) in m; NaN if the robot knows no position.
        yaw_rad: yaw of the body at the start; 0 if unknown.
    """

    origin_world: FloatArray
    heading_rad: float
    yaw_rad: float

    def path(self, positions_world: FloatArray) -> FloatArray:
        """World positions (T, 3) as (T, 2): progress along the heading, deviation to its left, in m."""
        moved = positions_world - self.origin_world
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.stack(
            [cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0]], axis=-1
        )


class Trace:
    """Base poses of a trial so far, NaN if unknown, and warnings; the frame is known from the walk on.

    Attributes:
        reports_load: whether the last tick had measured angles and loads of the joints.
    """

    def __init__(self) -> None:
        self.frame: TrialFrame | None = None
        self.reports_load = True
        self.warnings = SeenWarnings()
        self._rows = Table(COLUMNS)
        self._starts: dict[str, int] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def begin_phase(self, phase: str) -> None:
        """Assign the next ticks to a phase of `PHASES`."""
        self._starts.setdefault(phase, len(self))

    def add(self, time_s: float, state: RobotState, true_position_world: FloatArray | None = None) -> None:
        """Append the tick at a time of the servos' clock, with the true position of a simulation."""
        columns, row, _ = self._rows.append()
        columns["time_s"][row] = time_s
        if state.base_position_world is not None:
            columns["position_world"][row] = state.base_position_world
        if state.base_quaternion_world is not None:
            columns["quaternion_world"][row] = state.base_quaternion_world
        if true_position_world is not None:
            columns["true_position_world"][row] = true_position_world
        self.warnings.take(state.warnings)
        self.reports_load = state.measured and state.joint_torques_nm is not None

    def rows(self, phase: str) -> slice:
        """Rows of a phase, or none."""
        if phase not in self._starts:
            return slice(0, 0)
        start = self._starts[phase]
        later = [first for name, first in self._starts.items() if PHASES.index(name) > PHASES.index(phase)]
        return slice(start, min(later, default=len(self)))

    @property
    def times_s(self) -> FloatArray:
        """Times of all ticks on the servos' clock, (T,)."""
        return self._all("time_s")

    @property
    def positions_world(self) -> FloatArray:
        """Base positions of all ticks, (T, 3) in m."""
        return self._all("position_world")

    @property
    def quaternions_world(self) -> FloatArray:
        """Base orientations (w, x, y, z) of all ticks, (T, 4)."""
        return self._all("quaternion_world")

    @property
    def true_positions_world(self) -> FloatArray:
        """True base positions of all ticks, (T, 3) in m; NaN if not simulated."""
        return self._all("true_position_world")

    @property
    def path_m(self) -> FloatArray:
        """Progress and deviation at each tick of the walk so far, (T, 2); (0, 2) without a frame."""
        if self.frame is None:
            return np.zeros((0, 2))
        return self.frame.path(self.positions_world[self.rows("walk")])

    def _all(self, name: str) -> FloatArray:
        return np.asarray(self._rows.rows(name, 0, len(self)))
