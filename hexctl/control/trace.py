"""The trace of a trial: where its base was at every tick, and the frame in which its walk is scored."""

from dataclasses import dataclass

import numpy as np

from hexctl.types import ArrayFields, FloatArray, RobotState

#: The phases of a trial, in their order.
PHASES = ("settle", "turn", "walk", "stop")

#: Rows of a new trace: 40 s of ticks. A full one doubles.
FIRST_ROWS = 2048


@dataclass(frozen=True, slots=True, eq=False)
class TrialFrame(ArrayFields):
    """Frame of a trial, fixed at the start of its walk: origin there, x along the commanded heading.

    Attributes:
        origin_world: start of the walk, (3,) in m; NaN where the robot knows no position.
        heading_rad: direction of travel in the world.
        yaw_rad: yaw of the body at the start; taken as 0 where the robot knows no yaw.
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
    """Base poses of a trial so far, tick by tick: all that the trial itself remembers of its ticks.

    Positions and orientations are NaN where the robot did not know them.

    Attributes:
        frame: the trial frame, from the start of the walk on.
    """

    def __init__(self) -> None:
        self.frame: TrialFrame | None = None
        self._length = 0
        self._times_s = np.empty(FIRST_ROWS)
        self._positions = np.empty((FIRST_ROWS, 3))
        self._quaternions = np.empty((FIRST_ROWS, 4))
        self._true_positions = np.empty((FIRST_ROWS, 3))
        self._starts: dict[str, int] = {}

    def __len__(self) -> int:
        return self._length

    def begin_phase(self, phase: str) -> None:
        """Count the next ticks to a phase of `PHASES`."""
        self._starts.setdefault(phase, self._length)

    def add(self, time_s: float, state: RobotState, true_position_world: FloatArray | None = None) -> None:
        """Append the tick at a time of the servos' clock, with the true position of a simulation."""
        if self._length == len(self._times_s):
            self._grow()
        row = self._length
        position, quaternion = state.base_position_world, state.base_quaternion_world
        self._times_s[row] = time_s
        self._positions[row] = np.nan if position is None else position
        self._quaternions[row] = np.nan if quaternion is None else quaternion
        self._true_positions[row] = np.nan if true_position_world is None else true_position_world
        self._length = row + 1

    def rows(self, phase: str) -> slice:
        """Rows of a phase; empty where it has not begun."""
        if phase not in self._starts:
            return slice(0, 0)
        start = self._starts[phase]
        later = [first for name, first in self._starts.items() if PHASES.index(name) > PHASES.index(phase)]
        return slice(start, min(later, default=self._length))

    @property
    def times_s(self) -> FloatArray:
        """Times of all ticks on the servos' clock, (T,)."""
        return self._times_s[: self._length]

    @property
    def positions_world(self) -> FloatArray:
        """Base positions of all ticks, (T, 3) in m."""
        return self._positions[: self._length]

    @property
    def quaternions_world(self) -> FloatArray:
        """Base orientations (w, x, y, z) of all ticks, (T, 4)."""
        return self._quaternions[: self._length]

    @property
    def true_positions_world(self) -> FloatArray:
        """True base positions of all ticks, (T, 3) in m; NaN where the robot is not simulated."""
        return self._true_positions[: self._length]

    @property
    def path_m(self) -> FloatArray:
        """Progress and deviation at each tick of the walk so far, (T, 2); (0, 2) without a frame."""
        if self.frame is None:
            return np.zeros((0, 2))
        return self.frame.path(self.positions_world[self.rows("walk")])

    def _grow(self) -> None:
        for name in ("_times_s", "_positions", "_quaternions", "_true_positions"):
            rows = getattr(self, name)
            setattr(self, name, np.concatenate([rows, np.empty_like(rows)]))
