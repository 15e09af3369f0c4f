"""Step responses of a walk that holds its line: the line moved to the side, and line and body turned."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.planning.crawl import auto_gait
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import Course
from hexctl.gait.gait import make_gait
from hexctl.palette import LINE_COLOR, hex_color
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray, RobotState
from pictures.picture import READABLE, save_svg

#: The steps: to the left, and counter-clockwise.
SHIFT_M, TURN_RAD = 0.2, math.radians(30.0)

#: The step comes after the soft start and some cycles, at the end of a cycle; the walk goes on for more, of
#: which some are drawn.
STEP_AT_CYCLES, AFTER_CYCLES, SHOWN_CYCLES = 12, 45, 30

#: A response has settled where it stays within this share of its step.
SETTLED = 0.05

#: Who walks: robot, failed leg, and the curve's style.
WALKERS: tuple[tuple[str, int | None, str, str], ...] = (
    ("ant", None, "-", "C0"),
    ("ant", 3, "--", "C0"),
    ("phantomx", None, "-", "C1"),
    ("pexod", None, "-", "C2"),
)


@dataclass(frozen=True, slots=True)
class Response:
    """How a walk follows a step of its course.

    Attributes:
        name: of the walker.
        strides: way since the step, in ways of a cycle at full stride, (T,).
        deviation_m: to the left of the new line, (T,).
        yaw_off_rad: yaw minus the one to keep, mean over a cycle, (T,).
    """

    name: str
    strides: FloatArray
    deviation_m: FloatArray
    yaw_off_rad: FloatArray

    def settled_at(self, values: FloatArray, step: float) -> float:
        """Way in strides after which values stay within `SETTLED` of a step; NaN where they do not."""
        outside = abs(values) > SETTLED * abs(step)
        return math.nan if outside[-1] else float(self.strides[np.flatnonzero(outside)[-1]])

    def reached_at(self, values: FloatArray) -> float:
        """Way in strides after which values are above 0 for the first time."""
        return float(self.strides[np.argmax(values > 0)])


class SteppedWalk(SteeredWalk):
    """A walk whose course is moved and turned on its way.

    Args:
        start: the robot, ready to walk.
        at_step: when.
        shift_m: how far the line moves to its left.
        turn_rad: by how much the line and the yaw turn there.

    Attributes:
        course: the new one, from that step on.
    """

    def __init__(self, start: WalkStart, *, at_step: int, shift_m: float, turn_rad: float) -> None:
        super().__init__(start)
        assert start.frame is not None  # noqa: S101  or there were no line to hold
        self._frame, self._at_step = start.frame, at_step
        self._shift_m, self._turn_rad = shift_m, turn_rad
        self.course: Course | None = None

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the walk is over; changes the course when it is time."""
        if step == self._at_step and state.base_position_world is not None:
            self.course = self._stepped(state.base_position_world)
            self.follow(self.course)
        return super().done(step, state)

    def _stepped(self, position_world: FloatArray) -> Course:
        """The course that begins beside a position."""
        frame = self._frame
        (way_m, _), along = frame.path(position_world[np.newaxis])[0], _along(frame.heading_rad)
        return Course(
            origin_world=frame.origin_world[:2] + way_m * along + self._shift_m * _left_of(along),
            heading_rad=frame.heading_rad + self._turn_rad,
            yaw_rad=frame.yaw_rad + self._turn_rad,
        )


def _along(heading_rad: float) -> FloatArray:
    """Direction of a heading, (2,)."""
    return np.array([math.cos(heading_rad), math.sin(heading_rad)])


def _left_of(along: FloatArray) -> FloatArray:
    return np.array([-along[1], along[0]])


def respond(robot_name: str, failed_leg: int | None, *, shift_m: float, turn_rad: float) -> Response:
    """Walk on the flat floor with the stable gait and exact sensors, and step the course on the way."""
    robot = load_robot(robot_name)
    failures = () if failed_leg is None else (Failure(leg=failed_leg),)
    cycle_ticks = round(1 / robot.gait.pace_hz / PERIOD_S)
    plan = TrialPlan(
        gait=make_gait(robot, "demo"),
        failures=failures,
        self_rotation="none",
        hold="line",
        duration_s=(STEP_AT_CYCLES + AFTER_CYCLES) * cycle_ticks * PERIOD_S,
    )
    plan, log = replace(plan, gait=auto_gait(robot, plan)), TickLog()
    at_step, walks = STEP_AT_CYCLES * cycle_ticks, list[SteppedWalk]()

    def made(start: WalkStart) -> SteppedWalk:
        walks.append(SteppedWalk(start, at_step=at_step, shift_m=shift_m, turn_rad=turn_rad))
        return walks[0]

    with Guard(SimServos(robot, failures=failures)) as guard:
        run_trial(guard, plan, made, (log,), soft_stop=False)
    name = ", ".join([robot_name, *(f"leg {failure.leg} {failure.kind}" for failure in failures)])
    stride_m = plan.gait.strokes_per_cycle * plan.gait.amplitude * robot.size_m
    return _response(name, log, walks[0].course, cycle_ticks=cycle_ticks, stride_m=stride_m)


def _response(
    name: str, log: TickLog, course: Course | None, *, cycle_ticks: int, stride_m: float
) -> Response:
    """What a log has of the way after the step."""
    if course is None:
        raise RuntimeError(f"{name}: the walk has ended before its course changed")
    rows, first = log.rows_of("walk"), STEP_AT_CYCLES * cycle_ticks
    moved = log["base_position_world"][rows][first:, :2] - course.origin_world
    along = _along(course.heading_rad)
    off_rad = np.unwrap(yaw_rad(log["base_quaternion_world"][rows])) - course.yaw_rad
    mean_rad = np.convolve(off_rad, np.ones(cycle_ticks) / cycle_ticks)[first : len(off_rad)]
    return Response(name, (moved - moved[0]) @ along / stride_m, moved @ _left_of(along), mean_rad)


def responses(*, shift_m: float = 0.0, turn_rad: float = 0.0) -> Iterator[Response]:
    """The responses of all walkers to a step."""
    for robot_name, failed_leg, _, _ in WALKERS:
        yield respond(robot_name, failed_leg, shift_m=shift_m, turn_rad=turn_rad)


def draw_step_response(folder: Path) -> Path:
    """Draw the distance from the line after it moved to the side."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(READABLE):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        ax = figure.subplots()
        ax.axhline(0.0, color=hex_color(LINE_COLOR), linewidth=1.0)
        for response, (_, _, style, color) in zip(responses(shift_m=SHIFT_M), WALKERS, strict=True):
            values = 100 * response.deviation_m
            ax.plot(response.strides, values, style, color=color, label=response.name, linewidth=2)
        ax.set_xlabel("distance travelled since the line moved, stride lengths")
        ax.set_ylabel("left of the new line, cm")
        ax.set_xlim(0, SHOWN_CYCLES)
        ax.legend(loc="lower right")
        return save_svg(figure, folder / "step_response.svg")
