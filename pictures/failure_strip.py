"""A leg fails in mid-walk: speed and robot afterwards, walking on and recovering."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.monitor.monitored_walk import MonitoredWalk, watched_walk
from hexctl.control.monitor.recovery import GlideToStableGait, Recovery, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import link_points_body
from hexctl.palette import BODY_COLOR, FAILED_COLORS, VERDICT_COLORS, hex_color
from hexctl.robot.failure_grammar import parse_failure_event
from hexctl.robot.loader import load_robot
from hexctl.types import FloatArray
from pictures.picture import INK, READABLE, save_svg

#: What fails, when, and the length of the walks.
EVENT, FAILS_S, DURATION_S = "5:limp@6", 6.0, 16.0

#: When the robots are drawn, from the failure on.
MOMENT_S = 6.0

#: The walks: name and recovery.
WALKS: tuple[tuple[str, type[Recovery]], ...] = (("walks on", WalkOn), ("recovers", GlideToStableGait))

FAILED_COLOR = hex_color(FAILED_COLORS["femur"])


@dataclass(frozen=True, slots=True)
class FailedWalk:
    """A walk in which a leg fails.

    Attributes:
        name: what the robot does about it.
        log: of its ticks.
        alarm_s: when it noticed, from the failure on.
        leg: which one.
    """

    name: str
    log: TickLog
    alarm_s: float
    leg: int

    def points_world(self, moment_s: float) -> FloatArray:
        """Joints and foot of each leg at a moment from the failure on, (6, 4, 3)."""
        row = self._row(moment_s)
        turned: FloatArray = np.zeros(9)
        mujoco.mju_quat2Mat(turned, self.log["base_quaternion_world"][row])
        points = link_points_body(load_robot("ant"), self.log["measured_rad"][row])
        placed: FloatArray = points @ turned.reshape(3, 3).T + self.log["base_position_world"][row]
        return placed

    def way_m(self) -> tuple[FloatArray, FloatArray]:
        """Times from the failure on, and the way along the line and to its left, (T,) and (T, 2)."""
        rows = self.log.rows_of("walk")
        position = self.log["base_position_world"][rows][:, :2]
        times_s = self.log["time_s"][rows]
        return times_s - times_s[0] - FAILS_S, position - position[0]

    def _row(self, moment_s: float) -> int:
        rows = self.log.rows_of("walk")
        return int(np.arange(len(self.log["time_s"]))[rows][round((FAILS_S + moment_s) / PERIOD_S)])


def walk(name: str, recovery: type[Recovery]) -> FailedWalk:
    """Walk straight ahead on the flat floor until a leg fails, and beyond."""
    robot, log, walks = load_robot("ant"), TickLog(), list[MonitoredWalk]()
    plan = TrialPlan(gait=make_gait(robot, "tripod"), hold="line", duration_s=DURATION_S)

    def made(start: WalkStart) -> MonitoredWalk:
        walks.append(watched_walk(recovery())(start))
        return walks[0]

    with Guard(SimServos(robot, events=[parse_failure_event(EVENT)])) as guard:
        run_trial(guard, plan, made, (log,), soft_stop=False)
    noticed = walks[0].noticed_failures()[0]
    return FailedWalk(name, log, noticed.at_s - FAILS_S, noticed.failure.leg)


def draw_failure_strip(folder: Path) -> Path:
    """Draw the speed of both walks over time, and both robots at its end."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    walks = [walk(*one) for one in WALKS]
    with mpl.rc_context(READABLE):
        figure = Figure(figsize=(9.0, 4.6), layout="constrained")
        speeds, robots = figure.subplots(1, 2, width_ratios=(2.4, 1.0))
        _draw_speeds(speeds, walks)
        robots.axis("off")
        for one, up in zip(walks, (0.02, 0.53), strict=True):
            inset = robots.inset_axes((0.0, up, 1.0, 0.45))
            _draw_moment(inset, one, MOMENT_S)
            inset.set_title(f"{one.name}, after {MOMENT_S:g} s", fontsize=12)
        return save_svg(figure, folder / "failure.svg")


def _draw_speeds(ax: Axes, walks: Sequence[FailedWalk]) -> None:
    """Speed over a gait cycle, before and after the failure."""
    cycle = round(1 / load_robot("ant").gait.pace_hz / PERIOD_S)
    for one, color in zip(walks, (FAILED_COLOR, hex_color(VERDICT_COLORS["holds"])), strict=True):
        times_s, way_m = one.way_m()
        speed = 100 * (way_m[cycle:, 0] - way_m[:-cycle, 0]) / (cycle * PERIOD_S)
        ax.plot(times_s[cycle:], speed, color=color)
        ax.annotate(one.name, (MOMENT_S + 1.0, speed[-1] - 1.2), color=color, fontsize=14)
    ax.axvline(0.0, color=INK, linewidth=1.2)
    ax.annotate(f"leg {walks[0].leg} goes limp", (-0.1, 1.0), rotation=90, ha="right")
    ax.axvline(walks[-1].alarm_s, color=INK, linewidth=1.2, linestyle=":")
    ax.annotate("detected", (walks[-1].alarm_s + 0.1, 1.0), rotation=90)
    ax.set_xlabel("time since the failure, s")
    ax.set_ylabel("speed, cm/s")
    ax.set_xlim(-2.0, DURATION_S - FAILS_S)
    ax.set_ylim(bottom=0.0)


def _draw_moment(ax: Axes, one: FailedWalk, moment_s: float) -> None:
    """The robot at a moment, walking to the right; `VIEW` looks at it from the right and from above."""
    points = one.points_world(moment_s)
    centre = points[:, 0].mean(axis=0)
    flat = (points - [centre[0], centre[1], 0.0]) @ VIEW.T
    body = flat[[0, 1, 2, 3, 4, 5, 0], 0]
    ax.fill(*body.T, color=hex_color(BODY_COLOR), zorder=2)
    for leg, chain in enumerate(flat, 1):
        color, width = (FAILED_COLOR, 4.0) if leg == one.leg else (INK, 2.5)
        ax.plot(*chain.T, color=color, linewidth=width, solid_capstyle="round", zorder=3)
    ax.set_aspect("equal")
    ax.set_xlim(-0.33, 0.33)
    ax.set_ylim(-0.13, 0.26)
    ax.axis("off")


#: Where a point of the world is in the picture: x to the right, and y and height upward.
VIEW: FloatArray = np.array([[1.0, 0.25, 0.0], [0.0, 0.45, 0.9]])
