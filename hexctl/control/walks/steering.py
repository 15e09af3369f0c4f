"""Steering: the velocity that keeps a walk on its line, from measured position and yaw.

The law is integral line of sight of ship control (Børhaug, Pavlov & Pettersen, CDC 2008), for a robot that
can walk sideways. With the cycle T, the distance of a cycle at full stride L = (3/2) A and the control period
dt:

    e', psi'  deviation from the line, positive to the left, and yaw error, smoothed over a tenth of a cycle
    z     = e' + sigma I              dI = dt / T  D^2 e' / (D^2 + z^2)           D = 1.5 L
    chi   = -atan2(z, D)              course relative to the line
    theta = line - yaw' + chi         direction of travel in the body: right in the world without delay
    omega = -clip(K psi' + K_i J, +-most) / T     dJ = dt / T  psi', not while omega is at its limit

The integral compensates constant drift; the turn restores the yaw. One set of gains serves all robots.
"""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.dead_reckoning import DeadReckoning
from hexctl.control.walks.sensor_loss import JUMP_M, JUMP_RAD, ZERO, FrozenSensor, Measured
from hexctl.errors import InputError
from hexctl.robot.rotations import components, yaw_of
from hexctl.types import ArrayFields, BoolArray, FloatArray, RobotState, any_of, chosen, within

#: D, as a multiple of L, and sigma.
LOOK_AHEAD, INTEGRAL = 1.5, 0.15

#: K, the corrected share of a yaw error per cycle, and K_i, per cycle.
TURN, TURN_INTEGRAL = 0.4, 0.02

#: Time constant that smooths deviation and yaw error, in cycles.
MEAN_CYCLES = 0.1


class CourseOverGround:
    """Yaw of robots that measure only their position: from the direction of travel.

    The lag of a position with a time constant of a cycle points along the path, the mean commanded velocity
    is in the body frame. Their angle, yaw plus drift, corrects the course for both.
    """

    def __init__(self, cycle_s: FloatArray) -> None:
        self._cycle_s = cycle_s
        self._behind_world: FloatArray = np.full((*np.shape(cycle_s), 2), np.nan)
        self._velocity_body: FloatArray = np.zeros((*np.shape(cycle_s), 2))
        self._time_s: FloatArray = np.zeros(np.shape(cycle_s))

    def retune(self, cycle_s: FloatArray, which: BoolArray) -> None:
        """Continue with other gaits, and restart some robots; leading shape each."""
        self._cycle_s = cycle_s
        self.forget(which)

    def forget(self, which: BoolArray) -> None:
        """Restart some robots, leading shape."""
        self._time_s = np.where(which, 0.0, self._time_s)

    def yaw_rad(self, dt_s: float, position_world: FloatArray, velocity_body: FloatArray) -> FloatArray:
        """Yaw in the world, leading shape, from position and commanded velocity; NaN at first."""
        position, share = position_world[..., :2], (1 - np.exp(-dt_s / self._cycle_s))[..., np.newaxis]
        seen = np.isfinite(position[..., 0])
        first = (self._time_s == 0)[..., np.newaxis]
        behind = np.where(first, position, self._behind_world)
        mean = np.where(first, 0.0, self._velocity_body)
        behind = behind + share * (position - behind)
        mean = mean + share * (velocity_body[..., :2] - mean)
        self._behind_world = np.where(seen[..., np.newaxis], behind, self._behind_world)
        self._velocity_body = np.where(seen[..., np.newaxis], mean, self._velocity_body)
        self._time_s = self._time_s + dt_s * seen
        way = position - behind
        angle_rad = np.arctan2(way[..., 1], way[..., 0]) - np.arctan2(mean[..., 1], mean[..., 0])
        return np.asarray(np.where(seen & (self._time_s > 2 * self._cycle_s), angle_rad, np.nan))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Course(ArrayFields):
    """A line to walk along, (2,) in m and rad in the world, with the yaw to keep; in a batch (n,) leading."""

    origin_world: FloatArray
    heading_rad: float
    yaw_rad: float


def possible_hold(plan: TrialPlan, frame: TrialFrame | None) -> str:
    """What a walk can hold: `line`, only `heading` without a position, `none` in turns and arcs."""
    if plan.hold == "none" or not plan.straight or frame is None:
        return "none"
    position_known = bool(np.isfinite(frame.origin_world).all())
    return "line" if plan.hold != "heading" and position_known else "heading"


def why_less(plan: TrialPlan, frame: TrialFrame | None) -> str | None:
    """Why a walk holds less than its plan asks for, in words, or None."""
    if plan.hold == "none":
        return None
    if not plan.straight:
        return "a turn and an arc have no line"
    if possible_hold(plan, frame) == "line" or (frame is not None and plan.hold == "heading"):
        return None
    missing = "no position" if frame is not None else "neither position nor yaw"
    return f"{'no yaw' if plan.hold == 'heading' else missing} was measured at rest before the walk"


def plane(position_world: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coordinates x and y of positions, leading shape each."""
    return position_world[..., 0][()], position_world[..., 1][()]


def _line(course: Course) -> tuple[FloatArray, ...]:
    """Origin and direction to the left of a line: x and y of both, leading shape each."""
    return *plane(course.origin_world), -np.sin(course.heading_rad), np.cos(course.heading_rad)


class CourseHold:
    """The steering law, for one robot or a batch of n; arrays have the leading shape () or (n,).

    Args:
        cycle_s: T.
        stride_m: L, distance of a cycle at full stride.
        hold: `line`, or `heading`, which ignores positions, and adds the trim.
        dead_reckoning: of the deviation under `heading`, or None to hold only the yaw.

    Attributes:
        velocity_body: forward and left in m/s and turn in rad/s, leading shape + (3,).
    """

    def __init__(
        self,
        course: Course,
        *,
        speed_m_s: FloatArray,
        cycle_s: FloatArray,
        stride_m: FloatArray,
        most_turn_rad_s: FloatArray,
        hold: str = "line",
        trim_rad: FloatArray | float = 0.0,
        dead_reckoning: DeadReckoning | None = None,
    ) -> None:
        if hold not in ("line", "heading"):
            raise InputError(f"hold: got {hold}; allowed: line, heading")
        self._shape = np.shape(speed_m_s)
        self._trim_rad = trim_rad if hold == "heading" else 0.0
        self._dead_reckoning = dead_reckoning
        self._all: BoolArray = np.ones(self._shape, dtype=bool)[()]
        self._over_ground: CourseOverGround | None = None
        self._course, self._hold = course, hold
        self.retune(speed_m_s=speed_m_s, cycle_s=cycle_s, stride_m=stride_m, most_turn_rad_s=most_turn_rad_s)
        self._frozen_position, self._frozen_yaw = FrozenSensor(), FrozenSensor()
        zero, self._unknown = np.zeros(self._shape)[()], np.full(self._shape, math.nan)[()]
        self._turned_rad, self._walked_cycles, self._turn_rad = zero, zero, zero
        self._line = _line(course)
        self._begin(zero, zero)
        self.velocity_body = self._velocity()

    def follow(self, course: Course) -> None:
        """Follow another line from now on; the deviation and the learned drift start again."""
        error_rad = self._error_rad + self._course.yaw_rad - course.yaw_rad
        self._course, self._line = course, _line(course)
        deviation_m = np.zeros(self._shape)[()]
        if self._dead_reckoning is not None:
            self._dead_reckoning.restart()
        if self._frozen_position.last:
            deviation_m = self._left_of_line_m(*self._frozen_position.last)
        self._begin(deviation_m, error_rad - math.tau * np.rint(error_rad / math.tau))

    def _begin(self, deviation_m: FloatArray, error_rad: FloatArray) -> None:
        self._aside, self._yaw = Measured(deviation_m, JUMP_M), Measured(error_rad, JUMP_RAD)
        # The mean deviation begins at 0: the course then turns to the line smoothly.
        self._deviation_m, self._error_rad = np.zeros(self._shape)[()], error_rad
        self._pull_m: FloatArray = np.zeros(self._shape)[()]

    def retune(
        self,
        *,
        speed_m_s: FloatArray,
        cycle_s: FloatArray,
        stride_m: FloatArray,
        most_turn_rad_s: FloatArray,
        which: BoolArray | None = None,
    ) -> None:
        """Continue with another gait of robots `which` (None: all); the learned drift stays."""
        if self._over_ground is not None:
            self._over_ground.retune(np.asarray(cycle_s)[()], self._all if which is None else which)
        self._speed_m_s, self._cycle_s = np.asarray(speed_m_s)[()], np.asarray(cycle_s)[()]
        self._ahead_m = LOOK_AHEAD * np.asarray(stride_m)[()]
        self._most_turn_rad = most_turn_rad_s * self._cycle_s
        self._dt_s = math.nan

    def update(self, dt_s: float, state: RobotState) -> FloatArray:
        """Velocity for the next control period, from the state and the time since the last one."""
        if dt_s != self._dt_s:
            self._dt_s, self._cycles = dt_s, dt_s / self._cycle_s
            self._share = 1 - np.exp(-self._cycles / MEAN_CYCLES)
        self._walked_cycles = self._walked_cycles + self._cycles
        self._yaw.update(self._measured_error_rad(dt_s, state), dt_s)
        self._aside.update(self._measured_deviation_m(dt_s, state), dt_s)
        self._average()
        self._integrate()
        self.velocity_body = self._velocity()
        return self.velocity_body

    def _average(self) -> None:
        aside, yaw, share = self._aside, self._yaw, self._share
        off_m, off_rad = aside.value - self._deviation_m, yaw.value - self._error_rad
        self._deviation_m = self._deviation_m + chosen(aside.fresh, share, ZERO) * off_m
        self._error_rad = self._error_rad + chosen(yaw.fresh, share, ZERO) * off_rad
        # Of lost measurements only the learned drift remains. The yaw error stays while there is a position,
        # from which a yaw follows after some cycles.
        if any_of(lost := aside.lost):
            self._deviation_m = self._deviation_m * (1 - share * lost)
            self._error_rad = self._error_rad * (1 - share * (lost & yaw.lost))

    def _measured_deviation_m(self, dt_s: float, state: RobotState) -> FloatArray:
        if self._dead_reckoning is not None:
            line_rad = self._course.heading_rad + self._trim_rad
            return self._dead_reckoning.update(state, self._course.yaw_rad + self._yaw.value - line_rad)
        position = state.base_position_world
        if position is None or self._hold != "line":
            return self._unknown
        x_m, y_m = plane(position)
        unseen = self._frozen_position.update(dt_s, x_m, y_m)
        return chosen(unseen, math.nan, self._left_of_line_m(x_m, y_m))

    def _left_of_line_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        origin_x, origin_y, left_x, left_y = self._line
        away_m: FloatArray = (x_m - origin_x) * left_x + (y_m - origin_y) * left_y
        return away_m

    def _measured_error_rad(self, dt_s: float, state: RobotState) -> FloatArray:
        off_rad = self._yaw_rad(dt_s, state) - self._course.yaw_rad
        return off_rad - math.tau * np.rint((off_rad - self._yaw.value) / math.tau)

    def _yaw_rad(self, dt_s: float, state: RobotState) -> FloatArray:
        """Measured yaw, or by the course over ground if there are only positions; NaN for neither."""
        quaternion, position = state.base_quaternion_world, state.base_position_world
        unseen, measured = self._all, self._unknown
        if quaternion is not None:
            numbers = components(quaternion)
            measured, unseen = yaw_of(*numbers), self._frozen_yaw.update(dt_s, *numbers)
        if not any_of(unseen):
            self._over_ground = None
            return measured
        if self._hold != "line" or position is None:
            return chosen(unseen, math.nan, measured)
        if self._over_ground is None:
            self._over_ground = CourseOverGround(self._cycle_s)
        self._over_ground.forget(~unseen)
        position = np.where(unseen[..., np.newaxis], position, np.nan)
        over_ground = self._over_ground.yaw_rad(dt_s, position, self.velocity_body)
        return chosen(unseen, over_ground, measured)

    def _integrate(self) -> None:
        """Update the two integrals and the turn; the first cycle, with its soft start, is excluded."""
        deviation_m, error_rad = self._deviation_m, self._error_rad
        cycles = chosen(self._walked_cycles > 1, self._cycles, ZERO)
        aside_m = deviation_m + INTEGRAL * self._pull_m
        square = self._ahead_m * self._ahead_m
        self._pull_m = self._pull_m + cycles * square * deviation_m / (square + aside_m * aside_m)
        turn_rad = TURN * error_rad + TURN_INTEGRAL * self._turned_rad
        outward = (abs(turn_rad) >= self._most_turn_rad) & (turn_rad * error_rad > 0)
        turned_rad = self._turned_rad + cycles * error_rad
        self._turned_rad = chosen(self._yaw.lost | outward, self._turned_rad, turned_rad)
        self._turn_rad = -within(turn_rad, self._most_turn_rad)

    def _velocity(self) -> FloatArray:
        aside_m = self._deviation_m + INTEGRAL * self._pull_m
        course_rad = self._trim_rad - np.arctan2(aside_m, self._ahead_m)
        toward_rad = self._course.heading_rad - self._course.yaw_rad - self._error_rad + course_rad
        velocity = np.empty((*self._shape, 3))
        velocity[..., 0] = self._speed_m_s * np.cos(toward_rad)
        velocity[..., 1] = self._speed_m_s * np.sin(toward_rad)
        velocity[..., 2] = self._turn_rad / self._cycle_s
        return velocity
